//! 2-D convolution on channels-last maps: Winograd where it pays, else products of the rows where they lie.

use std::sync::Arc;

use super::epilogue::{Epilogue, MapShape};
use super::gemm::{Inputs, Panels, Part, order, vectorised};
use super::kernel::{Data, Kernel};
use super::packs::Pack;
use super::scratch::Scratch;
use super::tiles::Rows;
use super::winograd::Winograd;
use super::words::{self, Numbers};
use crate::engine::cores::each_with;
use crate::engine::ops::Conv2d;
use crate::engine::ops::bounds::magnitude;
use crate::engine::precision::Precision;
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// Inputs of the pixels that a thread takes: half of a common second-level cache.
const TILE: usize = 128 * 1024;
/// Pieces at least in which the pixels are shared, so that threads end together.
const PIECES: usize = 16;

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
    /// Weights in [`Panels`], their inputs in the order `[kh, kw, I]`; these lie in a map that is rounded and has zeros
    /// round it.
    Direct(Numbers, Arc<Vec<f32>>),
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
        let numbers = pack.numbers_of(out_c, shape.padded_terms(Numbers::Int8), kh * kw > 1);
        // Winograd's quarter of the products in f32 takes no longer than all in bf16, but longer than all of 8 bits.
        let pays = numbers != Numbers::Int8 && !pack.all.lean;
        let algorithm = if Winograd::fits(&op, &shape) && pays {
            Algorithm::Winograd(Winograd::new(shape, pack)?)
        } else {
            let packed = pack.get("direct", numbers, |weight| channels_last(weight, numbers))?;
            Algorithm::Direct(numbers, packed)
        };
        Ok(Self { op, shape, algorithm, epilogue: Epilogue { bias, relu: op.relu } })
    }

    /// Multiplies the rows of all pixels.
    fn multiply(
        &self,
        weight: Panels,
        rows: &Inputs,
        residual: Option<&[f32]>,
        output: &mut [f32],
    ) {
        let out_c = self.shape.out_c;
        let (pixels, terms) = (self.shape.pixels(), self.shape.terms());
        let residual = |first: usize, count: usize| {
            residual.map(|r| &r[first * out_c..(first + count) * out_c])
        };
        // Where there are fewer pixels than weights to each of their inputs, threads share the weights.
        if pixels >= out_c {
            let tile = (TILE / terms).min(pixels / PIECES).clamp(16, 512).next_multiple_of(12);
            let stride = weight.stride();
            each_with(
                output.chunks_mut(tile * out_c).enumerate(),
                || Scratch::new(tile * stride),
                |sums, (index, output)| {
                    let (first, count) = (index * tile, output.len() / out_c);
                    weight.multiply(sums, rows, first..first + count);
                    vectorised(
                        #[inline(always)]
                        || {
                            let residual = residual(first, count);
                            self.epilogue_of(output, (sums, stride), 0, out_c, residual);
                        },
                    );
                },
            );
            return;
        }
        let parts = weight.shared(rows, pixels);
        vectorised(
            #[inline(always)]
            || {
                for Part { first, outputs, stride, rows, sums } in &parts {
                    let output = &mut output[rows.start * out_c..rows.end * out_c];
                    let residual = residual(rows.start, rows.len());
                    self.epilogue_of(output, (sums, *stride), *first, *outputs, residual);
                }
            },
        );
    }

    /// The epilogue for the channels from `first`, `count` of each pixel in `sums`.
    #[inline(always)]
    fn epilogue_of(
        &self,
        output: &mut [f32],
        (sums, stride): (&[f32], usize),
        first: usize,
        count: usize,
        residual: Option<&[f32]>,
    ) {
        let out_c = self.shape.out_c;
        for (pixel, sums) in sums.chunks_exact(stride).enumerate().take(output.len() / out_c) {
            let at = pixel * out_c + first;
            let residual = residual.map(|r| &r[at..at + count]);
            self.epilogue.apply(&mut output[at..at + count], sums, first, residual);
        }
    }

    /// Rounds the map, and multiplies its rows where they lie.
    fn direct(
        &self,
        numbers: Numbers,
        weight: &[f32],
        input: &[f32],
        residual: Option<&[f32]>,
        output: &mut [f32],
    ) {
        let MapShape { in_c, in_h, in_w, out_c, out_w, kh, kw, .. } = self.shape;
        let Conv2d { stride, padding, dilation, .. } = self.op;
        let rounded = words::map(numbers, input, [in_h, in_w, in_c], padding);
        let pixel = in_c.div_ceil(numbers.a_word());
        let line = (in_w + 2 * padding) * pixel;
        // The taps of a row are one piece where they are side by side.
        let (taps, length) = if dilation == 1 { (1, kw * pixel) } else { (kw, pixel) };
        let pieces: Vec<usize> = (0..kh)
            .flat_map(|ky| (0..taps).map(move |kx| dilation * (ky * line + kx * pixel)))
            .collect();
        let rows = Rows {
            words: &rounded.words,
            line: out_w,
            pitch: stride * pixel,
            line_pitch: stride * line,
            pieces: &pieces,
            length,
        };
        let inputs = Inputs { rows, scales: &rounded.scales };
        let inner = self.shape.padded_terms(numbers);
        let weight = Panels::of(weight, (out_c, inner), numbers);
        self.multiply(weight, &inputs, residual, output);
    }
}

/// Packs `[O, I, kh, kw]`, with the inputs of an output in the order `[kh, kw, I]`, those of a tap in whole words.
fn channels_last(weight: &Tensor, numbers: Numbers) -> Vec<f32> {
    let [out_c, in_c, kh, kw] = [0, 1, 2, 3].map(|i| weight.dims()[i]);
    let (taps, padded) = (kh * kw, in_c.next_multiple_of(numbers.a_word()));
    Panels::packed((out_c, padded * taps), numbers, |o, k| {
        let (tap, i) = (k / padded, k % padded);
        if i < in_c { weight.data()[(o * in_c + i) * taps + tap] } else { 0.0 }
    })
}

impl Kernel for Convolution {
    fn packed(&self) -> &'static [usize] {
        if self.op.bias { &[1, 2] } else { &[1] }
    }

    fn precision(&self) -> Precision {
        match self.algorithm {
            Algorithm::Direct(numbers, _) => numbers.precision(),
            Algorithm::Winograd(_) => Precision::F32,
        }
    }

    fn tolerance(&self, inputs: &[&Value]) -> crate::error::Result<Option<Vec<f64>>> {
        let (input, weight) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let added: Vec<_> = inputs[2..].iter().map(|v| magnitude(v)).collect::<Result<_, _>>()?;
        let bias = if self.op.bias { added.first() } else { None };
        let residual = if self.op.residual { added.last() } else { None };
        let numbers = match &self.algorithm {
            Algorithm::Direct(numbers, _) => *numbers,
            Algorithm::Winograd(kernel) => {
                return Ok(Some(kernel.tolerance(&input, bias, residual)));
            }
        };
        let sums = reference::conv2d(&input, &weight, bias, residual, self.op.shape(), false);
        let order = order(numbers, self.shape.terms(), 2);
        Ok(Some(sums.data().iter().map(|sum| order.error(f64::from(*sum))).collect()))
    }

    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let input = inputs[0].f32()?;
        let residual = match self.op.residual {
            true => Some(inputs[2 + usize::from(self.op.bias)].f32()?),
            false => None,
        };
        match &self.algorithm {
            Algorithm::Direct(numbers, weight) => {
                self.direct(*numbers, weight, input, residual, outputs[0]);
            }
            Algorithm::Winograd(kernel) => {
                kernel.run(input, residual, &self.epilogue, outputs[0]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::packs::Packs;
    use super::*;
    use crate::engine::ops::Op;
    use crate::engine::shape::Shape;
    use crate::engine::tensor::Constant;

    /// Rows of all strides, paddings and dilations, of many pixels and of few.
    #[test]
    fn rows_lie_in_the_map() {
        let some = |i: usize, step: usize| ((i * step % 101) as f32 - 50.0) / 50.0;
        for (op, [in_c, out_c, side, kernel]) in [
            (Conv2d { stride: 2, padding: 3, ..Conv2d::default() }, [3, 5, 11, 7]),
            (Conv2d { padding: 2, dilation: 2, relu: true, ..Conv2d::default() }, [8, 70, 6, 3]),
            (Conv2d { residual: true, ..Conv2d::default() }, [4, 8, 12, 1]),
            (Conv2d { stride: 2, ..Conv2d::default() }, [4, 8, 12, 1]),
        ] {
            let op = Conv2d { bias: true, ..op };
            let tensor = |shape: &[usize], step| -> Value {
                Tensor::from_fn(Shape(shape.to_vec()), |i| some(i, step)).into()
            };
            let mut inputs = vec![tensor(&[in_c, side, side], 37)];
            inputs.push(tensor(&[out_c, in_c, kernel, kernel], 53));
            inputs.push(tensor(&[out_c], 29));
            let spec = |inputs: &[Value]| inputs.iter().map(Value::spec).collect::<Vec<_>>();
            if op.residual {
                inputs.push(tensor(&[out_c, side, side], 41));
            }
            let output = op.infer(&spec(&inputs)).expect("a shape").remove(0);
            let read: Vec<&Value> = inputs.iter().collect();
            let want = op.reference(&read).expect("a reference").remove(0);
            let last = |value: &Value| {
                let mut last = vec![f32::NAN; value.spec().shape.elements()];
                let floats = value.f32().expect("floats").data();
                super::super::kernel::convert(
                    &value.spec(),
                    super::super::kernel::Layout::Planar,
                    floats,
                    &mut last,
                );
                last
            };
            let (want, given) = (last(&want), inputs.iter().map(last).collect::<Vec<_>>());
            let weight = Constant::from(inputs[1].clone());
            let all = Packs::default();
            let pack = Pack { all: &all, name: "w", weight: &weight, numbers: Numbers::F32 };
            let bias = inputs[2].f32().expect("floats");
            let kernel = Convolution::new(op, &inputs[0].spec(), &output, Some(bias), pack);
            let kernel = kernel.expect("a kernel");
            assert!(!matches!(kernel.algorithm, Algorithm::Winograd(_)));
            let bounds = kernel.tolerance(&read).expect("bounds").expect("its own");
            let bounds: Value = Tensor::from_fn(output.shape.clone(), |i| bounds[i] as f32).into();
            let data: Vec<Data> = given.iter().map(|data| Data::F32(data)).collect();
            let mut got = vec![f32::NAN; want.len()];
            kernel.run(&data, &mut [&mut got]).expect("a run");
            for (i, bound) in last(&bounds).iter().enumerate() {
                assert!((got[i] - want[i]).abs() <= *bound, "{op:?}: {i}");
            }
        }
    }
}
