//! CBAM's gating.

use crate::engine::tensor::Tensor;

/// `input · channel_gate · spatial_gate`: `[C, H, W]`, `[C]` and `[1, H, W]` to `[C, H, W]`.
pub fn apply_gates(input: &Tensor, channel_gate: &Tensor, spatial_gate: &Tensor) -> Tensor {
    let area = input.dims()[1] * input.dims()[2];
    Tensor::from_fn(input.shape().clone(), |i| {
        let gates =
            f64::from(channel_gate.data()[i / area]) * f64::from(spatial_gate.data()[i % area]);
        (f64::from(input.data()[i]) * gates) as f32
    })
}
