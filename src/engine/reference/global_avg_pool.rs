//! Average pooling over all of space.

use crate::engine::tensor::Tensor;

/// Average of each channel over space: `[C, H, W]` to `[C]`.
pub fn global_avg_pool(input: &Tensor) -> Tensor {
    let area = input.dims()[1] * input.dims()[2];
    Tensor::from_fn([input.dims()[0]], |c| {
        let plane = &input.data()[c * area..][..area];
        (plane.iter().map(|x| f64::from(*x)).sum::<f64>() / area as f64) as f32
    })
}
