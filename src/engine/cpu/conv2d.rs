//! 2-D convolution on channels-last maps: Winograd where it pays, else im2col, both over a matrix
//! product.

use std::sync::Arc;

use super::epilogue::{Epilogue, MapShape};
use super::gemm::{Panels, Part, order, order_of_pairs, pairs, vectorised};
use super::kernel::{Data, Kernel};
use super::packs::Pack;
use super::scratch::Scratch;
use super::winograd::Winograd;
use crate::engine::cores::{each, each_with};
use crate::engine::ops::Conv2d;
use crate::engine::ops::bounds::magnitude;
use crate::engine::precision::Precision;
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// Floats of an im2col tile: half of a common second-level cache.
const TILE: usize = 128 * 1024;
/// Pieces at least in which the pixels are shared, so that threads end together.
const PIECES: usize = 16;
/// Output pixels from which threads share the pixels; below it they share the channels.
const MANY_PIXELS: usize = 512;

/// A convolution with its weights packed.
#[derive(Debug)]
pub(super) struct Convolution {
    op: Conv2d,
    shape: MapShape,
    algorithm: Algorithm,
    epilogue: Epilogue,
}

#[derive(Debug)]
enum Algorithm {
    /// Weights in [`Panels`], their inputs in the order `[kh, kw, I]`.
    Im2col(Arc<Vec<f32>>),
    /// The same in pairs of bf16.
    Pairs(Arc<Vec<f32>>),
    Winograd(Winograd),
}

impl Convolution {
    /// Packs the weights of `op` for an input of this shape, where no plan has.
    ///
    /// # Errors
    /// As [`Pack::get`].
    pub fn new(
        op: Conv2d,
        input: &TensorSpec,
        output: &TensorSpec,
        bias: Option<&Tensor>,
        pack: Pack,
    ) -> Result<Self> {
        let [out_c, in_c, kh, kw] = [0, 1, 2, 3].map(|i| pack.dims()[i]);
        let [in_h, in_w] = [1, 2].map(|i| input.shape.0[i]);
        let [out_h, out_w] = [1, 2].map(|i| output.shape.0[i]);
        let shape = MapShape { in_c, in_h, in_w, out_c, out_h, out_w, kh, kw };
        let bias = bias.map_or_else(|| vec![0.0; out_c], |b| b.data().to_vec());
        // Winograd's quarter of the products in f32 takes no longer than all in bf16.
        let algorithm = if Winograd::fits(&op, &shape) && !pack.all.lean {
            Algorithm::Winograd(Winograd::new(shape, pack)?)
        } else if pack.pairs && in_c.is_multiple_of(2) {
            Algorithm::Pairs(pack.get("im2col in bf16", |w| channels_last(w, true))?)
        } else {
            Algorithm::Im2col(pack.get("im2col", |w| channels_last(w, false))?)
        };
        Ok(Self { op, shape, algorithm, epilogue: Epilogue { bias, relu: op.relu } })
    }

    /// Whether the input itself is the matrix of im2col.
    fn is_pointwise(&self) -> bool {
        let Conv2d { stride, padding, .. } = self.op;
        self.shape.kh * self.shape.kw == 1 && stride == 1 && padding == 0
    }

    /// `input` and `weight` are numbers, or pairs of them as `shape` says.
    fn im2col(
        &self,
        shape: MapShape,
        weight: Panels,
        input: &[f32],
        residual: Option<&[f32]>,
        output: &mut [f32],
    ) {
        let MapShape { out_c, .. } = shape;
        let (pixels, terms) = (shape.pixels(), shape.terms());
        let residual = |first: usize, count: usize| {
            residual.map(|r| &r[first * out_c..(first + count) * out_c])
        };
        if pixels >= MANY_PIXELS {
            let tile = (TILE / terms).min(pixels / PIECES).clamp(16, 512);
            let scratch = || [terms, out_c].map(|width| Scratch::new(tile * width));
            each_with(
                output.chunks_mut(tile * out_c).enumerate(),
                scratch,
                |[columns, sums], (index, output)| {
                    let (first, count) = (index * tile, output.len() / out_c);
                    let rows = if self.is_pointwise() {
                        &input[first * terms..(first + count) * terms]
                    } else {
                        self.gather(shape, input, first, &mut columns[..count * terms]);
                        &columns[..count * terms]
                    };
                    weight.multiply(sums, rows, count);
                    vectorised(
                        #[inline(always)]
                        || {
                            self.epilogue_of(output, sums, 0, out_c, residual(first, count));
                        },
                    );
                },
            );
            return;
        }
        let columns = if self.is_pointwise() {
            Scratch::new(0)
        } else {
            let mut columns = Scratch::new(pixels * terms);
            let tile = pixels.div_ceil(PIECES).max(1);
            let parts = columns.chunks_mut(tile * terms).enumerate();
            each(parts, |(i, part)| self.gather(shape, input, i * tile, part));
            columns
        };
        let rows = if self.is_pointwise() { input } else { &columns };
        let parts = weight.shared(rows, pixels);
        vectorised(
            #[inline(always)]
            || {
                for Part { first, outputs, rows, sums } in &parts {
                    let output = &mut output[rows.start * out_c..rows.end * out_c];
                    let residual = residual(rows.start, rows.len());
                    self.epilogue_of(output, sums, *first, *outputs, residual);
                }
            },
        );
    }

    /// The epilogue for the channels from `first`, `count` of each pixel in `sums`.
    #[inline(always)]
    fn epilogue_of(
        &self,
        output: &mut [f32],
        sums: &[f32],
        first: usize,
        count: usize,
        residual: Option<&[f32]>,
    ) {
        let out_c = self.shape.out_c;
        for (pixel, sums) in sums.chunks_exact(count).enumerate().take(output.len() / out_c) {
            let at = pixel * out_c + first;
            let residual = residual.map(|r| &r[at..at + count]);
            self.epilogue.apply(&mut output[at..at + count], sums, first, residual);
        }
    }

    /// The inputs of each output pixel from `first` side by side, `[pixels][kh, kw, I]`.
    fn gather(&self, shape: MapShape, input: &[f32], first: usize, columns: &mut [f32]) {
        let MapShape { in_c, in_h, in_w, out_w, kh, kw, .. } = shape;
        let Conv2d { stride, padding, dilation, .. } = self.op;
        for (i, column) in columns.chunks_exact_mut(shape.terms()).enumerate() {
            let (oy, ox) = ((first + i) / out_w, (first + i) % out_w);
            for (ky, row) in column.chunks_exact_mut(kw * in_c).enumerate() {
                // Wraps below zero to a large number, so that one comparison finds both sides.
                let y = (oy * stride + ky * dilation).wrapping_sub(padding);
                let x = |kx: usize| (ox * stride + kx * dilation).wrapping_sub(padding);
                if y >= in_h {
                    row.fill(0.0);
                    continue;
                }
                let line = &input[y * in_w * in_c..][..in_w * in_c];
                if dilation == 1 && x(0) < in_w && x(0) + kw <= in_w {
                    row.copy_from_slice(&line[x(0) * in_c..][..kw * in_c]);
                    continue;
                }
                for (kx, to) in row.chunks_exact_mut(in_c).enumerate() {
                    match x(kx) < in_w {
                        true => to.copy_from_slice(&line[x(kx) * in_c..][..in_c]),
                        false => to.fill(0.0),
                    }
                }
            }
            debug_assert_eq!(column.len(), kh * kw * in_c);
        }
    }
}

/// Packs `[O, I, kh, kw]`, with the inputs of an output in the order `[kh, kw, I]`, or pairs of them.
fn channels_last(weight: &Tensor, pairs: bool) -> Vec<f32> {
    let [out_c, in_c, kh, kw] = [0, 1, 2, 3].map(|i| weight.dims()[i]);
    let taps = kh * kw;
    Panels::packed((out_c, in_c * taps), pairs, |o, k| {
        let (tap, i) = (k / in_c, k % in_c);
        weight.data()[(o * in_c + i) * taps + tap]
    })
}

impl Kernel for Convolution {
    fn packed(&self) -> &'static [usize] {
        if self.op.bias { &[1, 2] } else { &[1] }
    }

    fn precision(&self) -> Precision {
        match self.algorithm {
            Algorithm::Pairs(_) => Precision::Bf16,
            _ => Precision::F32,
        }
    }

    fn tolerance(&self, inputs: &[&Value]) -> crate::error::Result<Option<Vec<f64>>> {
        let (input, weight) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let added: Vec<_> = inputs[2..].iter().map(|v| magnitude(v)).collect::<Result<_, _>>()?;
        let bias = if self.op.bias { added.first() } else { None };
        let residual = if self.op.residual { added.last() } else { None };
        if let Algorithm::Winograd(kernel) = &self.algorithm {
            return Ok(Some(kernel.tolerance(&input, bias, residual)));
        }
        let sums = reference::conv2d(&input, &weight, bias, residual, self.op.shape(), false);
        let order = match self.algorithm {
            Algorithm::Pairs(_) => order_of_pairs(self.shape.terms()),
            _ => order(self.shape.terms()),
        };
        let order = order.and(2);
        Ok(Some(sums.data().iter().map(|sum| order.error(f64::from(*sum))).collect()))
    }

    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let input = inputs[0].f32()?;
        let residual = match self.op.residual {
            true => Some(inputs[2 + usize::from(self.op.bias)].f32()?),
            false => None,
        };
        match &self.algorithm {
            Algorithm::Im2col(weight) => {
                let weight = Panels::of(weight, self.shape.out_c, self.shape.terms());
                self.im2col(self.shape, weight, input, residual, outputs[0]);
            }
            Algorithm::Pairs(weight) => {
                let shape = MapShape { in_c: self.shape.in_c / 2, ..self.shape };
                let weight = Panels::of_pairs(weight, shape.out_c, shape.terms());
                self.im2col(shape, weight, &pairs(input), residual, outputs[0]);
            }
            Algorithm::Winograd(kernel) => {
                kernel.run(input, residual, &self.epilogue, outputs[0]);
            }
        }
        Ok(())
    }
}
