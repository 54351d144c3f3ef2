//! 2-D convolution.

use crate::engine::cores::each;
use crate::engine::reference::shared;
use crate::engine::tensor::Tensor;

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

    /// Elements of a row and of a channel of the copy that [`conv2d`] makes of an input for a kernel of so many
    /// columns: its rows with their padding, and zeros behind them as far as a tap reaches.
    fn copied(&self, [height, width]: [usize; 2], columns: usize) -> [usize; 2] {
        let [high, wide] =
            [height, width].map(|n| n.saturating_add(self.padding.saturating_mul(2)));
        let behind = columns.saturating_mul(self.dilation);
        [wide, high.saturating_mul(wide).saturating_add(behind)]
    }

    /// Bytes of that copy, of an input `[I, H, W]`.
    pub fn copied_bytes(&self, [channels, height, width]: [usize; 3], columns: usize) -> u64 {
        let [_, plane] = self.copied([height, width], columns);
        (plane as u64).saturating_mul(channels as u64).saturating_mul(8)
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
    let padded = Padded::new(input, shape, [kh, kw]);
    each(output.data_mut().chunks_mut(area).enumerate(), |(o, out)| {
        let taps = &weight.data()[o * in_c * kh * kw..][..in_c * kh * kw];
        let first = bias.map_or(0.0, |b| f64::from(b.data()[o]));
        let sums = shared::vectorised(
            #[inline(always)]
            || padded.sums(taps, first, [out_h, out_w]),
        );
        let rest = residual.map(|r| &r.data()[o * area..][..area]);
        for (at, (out, sum)) in out.iter_mut().zip(&sums).enumerate() {
            let value = sum + rest.map_or(0.0, |r| f64::from(r[at]));
            *out = if relu { shared::relu(value) } else { value } as f32;
        }
    });
    output
}

/// An input with its zeros on each side, in f64.
struct Padded {
    shape: ConvShape,
    kernel: [usize; 2],
    /// Length of a row.
    width: usize,
    /// Elements of a channel, see [`ConvShape::copied`].
    plane: usize,
    values: Vec<f64>,
}

impl Padded {
    fn new(input: &Tensor, shape: ConvShape, kernel: [usize; 2]) -> Self {
        let [channels, height, width] = [0, 1, 2].map(|i| input.dims()[i]);
        let [wide, plane] = shape.copied([height, width], kernel[1]);
        let mut values = vec![0.0; channels * plane];
        // An input without columns has none, and its padding may make outputs.
        for (row, from) in input.data().chunks_exact(width.max(1)).enumerate() {
            let (channel, y) = (row / height, row % height);
            let at = channel * plane + (y + shape.padding) * wide + shape.padding;
            for (to, from) in values[at..at + width].iter_mut().zip(from) {
                *to = f64::from(*from);
            }
        }
        Self { shape, kernel, width: wide, plane, values }
    }

    /// `first + Σ taps · input` of one output channel: channel by channel, tap by tap.
    #[inline(always)]
    fn sums(&self, taps: &[f32], first: f64, [out_h, out_w]: [usize; 2]) -> Vec<f64> {
        let ConvShape { stride, dilation, .. } = self.shape;
        let [kh, kw] = self.kernel;
        let mut sums = Vec::with_capacity(out_h * out_w);
        // Rows whose sums stay in the first-level cache.
        let rows = (ROW_BLOCK / self.width).max(1);
        let mut block = vec![0.0; rows * self.width];
        for top in (0..out_h).step_by(rows) {
            let rows = rows.min(out_h - top);
            block.fill(first);
            for (row, weights) in taps.chunks_exact(kw).enumerate() {
                let (channel, ky) = (row / kh, row % kh);
                let at = (top * stride + ky * dilation) * self.width;
                let from = &self.values[channel * self.plane + at..(channel + 1) * self.plane];
                if stride == 1 {
                    // All rows in one go; the sums behind each row's outputs are not used.
                    let wanted = (rows - 1) * self.width + out_w;
                    add_taps(&mut block[..wanted], from, dilation, weights);
                    continue;
                }
                for (row, sums) in block.chunks_exact_mut(self.width).take(rows).enumerate() {
                    for (kx, weight) in weights.iter().enumerate() {
                        let from = &from[row * stride * self.width + kx * dilation..];
                        let weight = f64::from(*weight);
                        for (sum, x) in sums[..out_w].iter_mut().zip(from.iter().step_by(stride)) {
                            *sum += weight * x;
                        }
                    }
                }
            }
            for row in block.chunks_exact(self.width).take(rows) {
                sums.extend_from_slice(&row[..out_w]);
            }
        }
        sums
    }
}

/// Sums that are kept at a time: 16 KiB.
const ROW_BLOCK: usize = 2048;

/// `sums[i] += Σ weights[k] · from[i + k · dilation]`, tap by tap; three taps share a pass over the
/// sums.
#[inline(always)]
fn add_taps(sums: &mut [f64], from: &[f64], dilation: usize, weights: &[f32]) {
    let (threes, rest) = weights.as_chunks::<3>();
    let wanted = sums.len();
    let shifted = |k: usize| &from[k * dilation..][..wanted];
    for (three, weights) in threes.iter().enumerate() {
        let [a, b, c] = [0, 1, 2].map(|k| shifted(3 * three + k));
        let [u, v, w] = weights.map(f64::from);
        for (i, sum) in sums.iter_mut().enumerate() {
            *sum = *sum + u * a[i] + v * b[i] + w * c[i];
        }
    }
    for (k, weight) in rest.iter().enumerate() {
        let weight = f64::from(*weight);
        for (sum, x) in sums.iter_mut().zip(&from[(3 * threes.len() + k) * dilation..]) {
            *sum += weight * x;
        }
    }
}
