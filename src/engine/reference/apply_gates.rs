//! CBAM's gating.

use crate::engine::reference::shared::sigmoid;
use crate::engine::tensor::Tensor;

/// `input · channel_gate · spatial gate`: `[C, H, W]` and `[C]` to `[C, H, W]`.
///
/// The spatial gate is the `sigmoid` of a 7×7 convolution with padding 3: `pooled` `[2, H, W]`, `weight`
/// `[1, 2, 7, 7]`, `bias` `[1]`. Woo et al., "CBAM", equations 1 and 3; the bias is what batch norm leaves when it is
/// folded into the convolution.
pub fn apply_gates(
    input: &Tensor,
    channel_gate: &Tensor,
    pooled: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
) -> Tensor {
    let [height, width] = [1, 2].map(|i| input.dims()[i]);
    let area = height * width;
    let spatial_gate = |pixel: usize| {
        let (y, x) = (pixel / width, pixel % width);
        let mut logit = f64::from(bias.data()[0]);
        for (tap, weight) in weight.data().iter().enumerate() {
            let (plane, ky, kx) = (tap / 49, tap / 7 % 7, tap % 7);
            let (iy, ix) = (y + ky, x + kx);
            if (3..3 + height).contains(&iy) && (3..3 + width).contains(&ix) {
                let at = (plane * height + iy - 3) * width + ix - 3;
                logit += f64::from(*weight) * f64::from(pooled.data()[at]);
            }
        }
        sigmoid(logit)
    };
    let spatial: Vec<f64> = (0..area).map(spatial_gate).collect();
    Tensor::from_fn(input.shape().clone(), |i| {
        let gates = f64::from(channel_gate.data()[i / area]) * spatial[i % area];
        (f64::from(input.data()[i]) * gates) as f32
    })
}
