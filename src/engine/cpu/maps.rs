//! Gates, weighted sums and interpolation on channels-last maps.

use super::gemm::vectorised;
use super::kernel::{Data, Kernel, Layout};
use super::words::WHOLE;
use crate::engine::cores::each;
use crate::engine::reference;
use crate::engine::shape::TensorSpec;

/// `Σ weights[k] · maps[k]`.
#[derive(Debug)]
pub(super) struct Sum;

impl Kernel for Sum {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let weights = inputs[0].f32()?;
        let maps: Vec<&[f32]> =
            inputs[1..].iter().map(|map| map.f32()).collect::<Result<_, _>>()?;
        const PART: usize = 16 * 1024;
        each(outputs[0].chunks_mut(PART).enumerate(), |(i, out)| {
            vectorised(
                #[inline(always)]
                || {
                    for (k, (weight, map)) in weights.iter().zip(&maps).enumerate() {
                        for (out, x) in out.iter_mut().zip(&map[i * PART..]) {
                            *out = if k == 0 { weight * x } else { *out + weight * x };
                        }
                    }
                },
            );
        });
        Ok(())
    }
}

/// Bilinear interpolation to another size, PyTorch's with `align_corners=False`.
#[derive(Debug)]
pub(super) struct Bilinear {
    channels: usize,
    width: usize,
    rows: Vec<Between>,
    columns: Vec<Between>,
}

/// The two inputs that an output lies between, and its distance from the first.
#[derive(Clone, Copy, Debug)]
struct Between {
    low: usize,
    high: usize,
    along: f32,
}

impl Bilinear {
    pub fn new(input: &TensorSpec, output: &TensorSpec) -> Self {
        let axis = |dim: usize| {
            let (from, to) = (input.shape.0[dim], output.shape.0[dim]);
            let between = |i: usize| {
                let (low, high, along) = reference::between(i, from, to);
                Between { low, high, along: along as f32 }
            };
            (0..to).map(between).collect()
        };
        let [channels, _, width] = [0, 1, 2].map(|i| input.shape.0[i]);
        Self { channels, width, rows: axis(1), columns: axis(2) }
    }
}

impl Kernel for Bilinear {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let input = inputs[0].f32()?;
        let pixel =
            |y: usize, x: usize| &input[(y * self.width + x) * self.channels..][..self.channels];
        let row = self.columns.len() * self.channels;
        each(outputs[0].chunks_mut(row).zip(&self.rows), |(out, y)| {
            vectorised(
                #[inline(always)]
                || {
                    for (out, x) in out.chunks_exact_mut(self.channels).zip(&self.columns) {
                        let [a, b] = [pixel(y.low, x.low), pixel(y.low, x.high)];
                        let [c, d] = [pixel(y.high, x.low), pixel(y.high, x.high)];
                        for (i, out) in out.iter_mut().enumerate() {
                            let top = a[i] * (1.0 - x.along) + b[i] * x.along;
                            let bottom = c[i] * (1.0 - x.along) + d[i] * x.along;
                            *out = top * (1.0 - y.along) + bottom * y.along;
                        }
                    }
                },
            );
        });
        Ok(())
    }
}

/// `input · channel gate · spatial gate`, which is the `sigmoid` of a 7×7 convolution of a map of two planes.
#[derive(Debug)]
pub(super) struct Gates {
    channels: usize,
    height: usize,
    width: usize,
    weight: Vec<f32>,
    bias: f32,
}

impl Gates {
    pub fn new(input: &TensorSpec, weight: &[f32], bias: f32) -> Self {
        let [channels, height, width] = [0, 1, 2].map(|i| input.shape.0[i]);
        Self { channels, height, width, weight: weight.to_vec(), bias }
    }
}

/// Outputs that are added up side by side.
const BLOCK: usize = 64;
/// 1 / (1 + e⁻ˣ), without calls, so that many are computed side by side.
#[inline(always)]
fn sigmoid(x: f32) -> f32 {
    /// ln 2, and what f32 leaves of it.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    // e⁻ˣ = 2ⁿ · eʳ with |r| ≤ ln 2 / 2. Past 88 the result is 0 or 1 to f32's last bit.
    let y = -x;
    let y = if y > 88.0 { 88.0 } else { y };
    let y = if y < -88.0 { -88.0 } else { y };
    let shifted = y * std::f32::consts::LOG2_E + WHOLE;
    let n = shifted - WHOLE;
    let r = y - n * LN_2[0] - n * LN_2[1];
    // Taylor's series; what it leaves out is below 2⁻²⁵ of the sum.
    let mut e = 1.0 / 5040.0;
    for term in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        e = e * r + term;
    }
    let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(1f32.to_bits()));
    1.0 / (1.0 + e * power)
}

/// Taps on each side of the middle one.
const REACH: usize = 3;

impl Kernel for Gates {
    fn input_layout(&self, index: usize) -> Layout {
        // What was pooled are two planes.
        if index == 2 { Layout::Planar } else { Layout::ChannelsLast }
    }

    fn packed(&self) -> &'static [usize] {
        &[3, 4]
    }

    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let (input, gate, pooled) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?);
        let (height, width) = (self.height, self.width);
        let wide = width + 2 * REACH;
        // Rows with zeros on both sides, so that each tap is a shifted row.
        let mut padded = vec![0.0; 2 * height * wide + BLOCK];
        for (to, from) in padded.chunks_exact_mut(wide).zip(pooled.chunks_exact(width)) {
            to[REACH..REACH + width].copy_from_slice(from);
        }
        let row = width * self.channels;
        each(outputs[0].chunks_mut(row).zip(input.chunks(row)).enumerate(), |(y, (out, input))| {
            vectorised(
                #[inline(always)]
                || {
                    // So many pixels that their sums stay in registers.
                    let block = BLOCK * self.channels;
                    let blocks = out.chunks_mut(block).zip(input.chunks(block));
                    for (i, (out, input)) in blocks.enumerate() {
                        let mut sums = [self.bias; BLOCK];
                        for (tap, weight) in self.weight.iter().enumerate() {
                            let (plane, ky, kx) = (tap / 49, tap / 7 % 7, tap % 7);
                            let iy = (y + ky).wrapping_sub(REACH);
                            if iy < height {
                                let first = (plane * height + iy) * wide + kx + i * BLOCK;
                                let row = &padded[first..][..BLOCK];
                                for (sum, x) in sums.iter_mut().zip(row) {
                                    *sum += weight * x;
                                }
                            }
                        }
                        let pixels = out.chunks_exact_mut(self.channels);
                        let pixels = pixels.zip(input.chunks_exact(self.channels));
                        for ((out, input), s) in pixels.zip(sums.map(sigmoid)) {
                            for ((out, x), gate) in out.iter_mut().zip(input).zip(gate) {
                                *out = x * (gate * s);
                            }
                        }
                    }
                },
            );
        });
        Ok(())
    }
}
