//! 2-D maximum pooling.

use crate::engine::cores::each;
use crate::engine::tensor::Tensor;

/// The largest value in each window of `kernel` × `kernel` pixels, `stride` apart, on `[C, H, W]`
/// with `padding` pixels of minus infinity on each side. The convention is PyTorch's `max_pool2d`,
/// also that a NaN in a window is its maximum.
pub fn max_pool2d(input: &Tensor, kernel: usize, stride: usize, padding: usize) -> Tensor {
    let [channels, in_h, in_w] = [0, 1, 2].map(|i| input.dims()[i]);
    let [out_h, out_w] = [in_h, in_w].map(|n| (n + 2 * padding - kernel) / stride + 1);
    let mut output = Tensor::zeros([channels, out_h, out_w]);
    each(output.data_mut().chunks_mut(out_w).enumerate(), |(row, out)| {
        let plane = &input.data()[row / out_h * in_h * in_w..][..in_h * in_w];
        for (ox, out) in out.iter_mut().enumerate() {
            *out = f32::NEG_INFINITY;
            for ky in 0..kernel {
                for kx in 0..kernel {
                    let (y, x) = (row % out_h * stride + ky, ox * stride + kx);
                    if (padding..padding + in_h).contains(&y)
                        && (padding..padding + in_w).contains(&x)
                    {
                        let value = plane[(y - padding) * in_w + x - padding];
                        if value > *out || value.is_nan() {
                            *out = value;
                        }
                    }
                }
            }
        }
    });
    output
}
