//! 2-D convolution.

use rayon::prelude::*;

use crate::cpu::shared;
use crate::tensor::Tensor;

/// Geometry of a convolution, equal in both dimensions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvShape {
    /// Step between outputs, in input pixels.
    pub stride: usize,
    /// Rows and columns of zeros on each side.
    pub padding: usize,
    /// Step between the kernel's taps, in input pixels.
    pub dilation: usize,
}

impl ConvShape {
    /// Output length for `input` pixels and `kernel` taps; `None` if the kernel does not fit.
    pub fn output(&self, input: usize, kernel: usize) -> Option<usize> {
        let span = self.dilation.checked_mul(kernel.checked_sub(1)?)?.checked_add(1)?;
        let padded = self.padding.checked_mul(2)?.checked_add(input)?;
        Some(padded.checked_sub(span)? / self.stride + 1)
    }

    /// Outputs whose tap `k` lies inside `input` pixels.
    fn inside(&self, k: usize, input: usize, output: usize) -> std::ops::Range<usize> {
        let shift = k * self.dilation;
        let first = self.padding.saturating_sub(shift).div_ceil(self.stride);
        let end = (input + self.padding).saturating_sub(shift).div_ceil(self.stride);
        first.min(output)..end.min(output)
    }
}

/// `output[o] = Σ weight[o, i, ky, kx] · input[i, …] + bias[o] (+ residual[o])`, then ReLU.
///
/// `input` is `[I, H, W]`, `weight` `[O, I, kh, kw]`, `bias` `[O]`, `residual` and the result
/// `[O, H', W']`. The convention is PyTorch's `conv2d` (cross-correlation).
pub fn conv2d(
    input: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    residual: Option<&Tensor>,
    shape: ConvShape,
    relu: bool,
) -> Tensor {
    let [in_c, in_h, in_w] = [0, 1, 2].map(|i| input.dims()[i]);
    let [out_c, _, kh, kw] = [0, 1, 2, 3].map(|i| weight.dims()[i]);
    let out_h = shape.output(in_h, kh).unwrap_or(0);
    let out_w = shape.output(in_w, kw).unwrap_or(0);
    let mut output = Tensor::zeros([out_c, out_h, out_w]);
    let area = out_h * out_w;
    if area == 0 {
        return output;
    }
    let channel = |(o, out): (usize, &mut [f32])| {
        let mut sums = vec![bias.map_or(0.0, |b| f64::from(b.data()[o])); area];
        for i in 0..in_c {
            let plane = &input.data()[i * in_h * in_w..][..in_h * in_w];
            let taps = &weight.data()[(o * in_c + i) * kh * kw..][..kh * kw];
            for ky in 0..kh {
                for kx in 0..kw {
                    let w = f64::from(taps[ky * kw + kx]);
                    let columns = shape.inside(kx, in_w, out_w);
                    if columns.is_empty() {
                        continue;
                    }
                    for oy in shape.inside(ky, in_h, out_h) {
                        let iy = oy * shape.stride + ky * shape.dilation - shape.padding;
                        let ix = columns.start * shape.stride + kx * shape.dilation - shape.padding;
                        let row = &plane[iy * in_w + ix..(iy + 1) * in_w];
                        let sums = &mut sums[oy * out_w..][columns.clone()];
                        accumulate(sums, row, shape.stride, w);
                    }
                }
            }
        }
        let rest = residual.map(|r| &r.data()[o * area..][..area]);
        for (at, (out, sum)) in out.iter_mut().zip(&sums).enumerate() {
            let value = sum + rest.map_or(0.0, |r| f64::from(r[at]));
            *out = if relu { shared::relu(value) } else { value } as f32;
        }
    };
    let channels = output.data_mut().par_chunks_mut(area).enumerate();
    channels.for_each(|part| shared::vectorised(|| channel(part)));
    output
}

/// `sums[i] += w · row[i · stride]`, with stride 1 apart so that it becomes vector code.
#[inline(always)]
fn accumulate(sums: &mut [f64], row: &[f32], stride: usize, w: f64) {
    if stride == 1 {
        for (sum, x) in sums.iter_mut().zip(row) {
            *sum += w * f64::from(*x);
        }
    } else {
        for (sum, x) in sums.iter_mut().zip(row.iter().step_by(stride)) {
            *sum += w * f64::from(*x);
        }
    }
}
