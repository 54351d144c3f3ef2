//! CBAM's spatial gate.

use crate::engine::reference::shared::sigmoid;
use crate::engine::tensor::Tensor;

/// `sigmoid` of a 7×7 convolution with padding 3: `pooled` `[2, H, W]`, `weight` `[1, 2, 7, 7]`,
/// `bias` `[1]`, result `[1, H, W]`. Woo et al., "CBAM", equation 3; the bias is what batch norm
/// leaves when it is folded into the convolution.
pub fn spatial_gate(pooled: &Tensor, weight: &Tensor, bias: &Tensor) -> Tensor {
    let [height, width] = [1, 2].map(|i| pooled.dims()[i]);
    Tensor::from_fn([1, height, width], |pixel| {
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
        sigmoid(logit) as f32
    })
}
