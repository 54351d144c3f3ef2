//! CBAM's channel gate.

use crate::engine::reference::shared::{relu, sigmoid};
use crate::engine::tensor::Tensor;

/// `sigmoid(f(average) + f(maximum))` with `f(x) = fc2(relu(fc1(x)))`, one gate a channel.
///
/// `pooled` is `[2, C]`, average first; `fc1_weight` `[R, C]`, `fc1_bias` `[R]`, `fc2_weight`
/// `[C, R]`, `fc2_bias` and the result `[C]`. Woo et al., "CBAM", equation 2, with biases.
pub fn channel_gate(
    pooled: &Tensor,
    fc1_weight: &Tensor,
    fc1_bias: &Tensor,
    fc2_weight: &Tensor,
    fc2_bias: &Tensor,
) -> Tensor {
    let channels = pooled.dims()[1];
    let logits = |row: usize| {
        let x: Vec<f64> = pooled.data()[row * channels..][..channels].iter().map(widen).collect();
        let mut hidden = linear(&x, fc1_weight, fc1_bias);
        hidden.iter_mut().for_each(|h| *h = relu(*h));
        linear(&hidden, fc2_weight, fc2_bias)
    };
    let (average, maximum) = (logits(0), logits(1));
    Tensor::from_fn([channels], |c| sigmoid(average[c] + maximum[c]) as f32)
}

fn widen(x: &f32) -> f64 {
    f64::from(*x)
}

/// `weight · x + bias`, unrounded.
fn linear(x: &[f64], weight: &Tensor, bias: &Tensor) -> Vec<f64> {
    let rows = weight.data().chunks_exact(x.len());
    let dot = |row: &[f32]| row.iter().zip(x).map(|(w, x)| f64::from(*w) * x).sum::<f64>();
    rows.zip(bias.data()).map(|(row, b)| dot(row) + f64::from(*b)).collect()
}
