//! CBAM's pooling over space.

use crate::engine::tensor::Tensor;

/// Average (row 0) and maximum (row 1) of each channel over space: `[C, H, W]` to `[2, C]`.
pub fn channel_pool(input: &Tensor) -> Tensor {
    let area = input.dims()[1] * input.dims()[2];
    let planes = || input.data().chunks_exact(area);
    let means =
        planes().map(|p| (p.iter().map(|x| f64::from(*x)).sum::<f64>() / area as f64) as f32);
    let maxima = planes().map(|p| p.iter().copied().fold(f32::NEG_INFINITY, f32::max));
    let both: Vec<f32> = means.chain(maxima).collect();
    Tensor::from_fn([2, input.dims()[0]], |i| both[i])
}
