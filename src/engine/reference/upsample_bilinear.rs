//! Bilinear interpolation to another size.

use crate::engine::cores::each;
use crate::engine::tensor::Tensor;

/// Bilinear interpolation of `[C, H, W]` to `[C, out_height, out_width]`, clamped at the edges. The
/// convention is PyTorch's `interpolate(mode="bilinear", align_corners=False)`.
pub fn upsample_bilinear(input: &Tensor, out_height: usize, out_width: usize) -> Tensor {
    let [channels, in_h, in_w] = [0, 1, 2].map(|i| input.dims()[i]);
    let mut output = Tensor::zeros([channels, out_height, out_width]);
    each(output.data_mut().chunks_mut(out_width).enumerate(), |(row, out)| {
        let (top, bottom, down) = between(row % out_height, in_h, out_height);
        let plane = &input.data()[row / out_height * in_h * in_w..][..in_h * in_w];
        for (ox, out) in out.iter_mut().enumerate() {
            let (left, right, along) = between(ox, in_w, out_width);
            let line = |y: usize| {
                let [a, b] = [left, right].map(|x| f64::from(plane[y * in_w + x]));
                a * (1.0 - along) + b * along
            };
            *out = (line(top) * (1.0 - down) + line(bottom) * down) as f32;
        }
    });
    output
}

/// The two input pixels that output `i` lies between, and its distance from the first.
pub fn between(i: usize, input: usize, output: usize) -> (usize, usize, f64) {
    let position = ((i as f64 + 0.5) * input as f64 / output as f64 - 0.5).max(0.0);
    let low = (position as usize).min(input - 1);
    (low, (low + 1).min(input - 1), position - low as f64)
}
