//! CBAM's pooling over channels.

use crate::engine::tensor::Tensor;

/// Maximum (row 0) and mean (row 1) over the channels of `input · channel_gate`: `[C, H, W]` and
/// `[C]` to `[2, H, W]`.
pub fn spatial_pool(input: &Tensor, channel_gate: &Tensor) -> Tensor {
    let [channels, height, width] = [0, 1, 2].map(|i| input.dims()[i]);
    let area = height * width;
    let mut largest = vec![f64::NEG_INFINITY; area];
    let mut sums = vec![0.0; area];
    for (plane, gate) in input.data().chunks_exact(area).zip(channel_gate.data()) {
        for (pixel, x) in plane.iter().enumerate() {
            let gated = f64::from(*x) * f64::from(*gate);
            largest[pixel] = gated.max(largest[pixel]);
            sums[pixel] += gated;
        }
    }
    let means = sums.into_iter().map(|sum| sum / channels as f64);
    let both: Vec<f64> = largest.into_iter().chain(means).collect();
    Tensor::from_fn([2, height, width], |i| both[i] as f32)
}
