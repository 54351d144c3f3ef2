//! RW-Net's weight of each scale.

use super::channel_gate::linear;
use crate::cpu::shared::relu;
use crate::tensor::Tensor;

/// `softmax(fc2(relu(fc1(pooled))))`: `pooled` is `[N]`, `fc1_weight` `[M, N]`, `fc1_bias` `[M]`,
/// `fc2_weight` `[K, M]`, `fc2_bias` and the result `[K]`.
pub fn scale_weights(
    pooled: &Tensor,
    fc1_weight: &Tensor,
    fc1_bias: &Tensor,
    fc2_weight: &Tensor,
    fc2_bias: &Tensor,
) -> Tensor {
    let x: Vec<f64> = pooled.data().iter().map(|x| f64::from(*x)).collect();
    let mut hidden = linear(&x, fc1_weight, fc1_bias);
    hidden.iter_mut().for_each(|h| *h = relu(*h));
    let logits = linear(&hidden, fc2_weight, fc2_bias);
    let largest = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = logits.iter().map(|z| (z - largest).exp()).sum();
    Tensor::from_fn([logits.len()], |k| ((logits[k] - largest).exp() / total) as f32)
}
