//! A fully connected layer.

use crate::engine::cores::each;
use crate::engine::reference::shared;
use crate::engine::tensor::Tensor;

/// `output[r, o] = Σ weight[o, k] · input[r, k] + bias[o]`, then ReLU if `relu`, for the first
/// `rows` rows of `input`, whose dimensions behind the first are taken as one; PyTorch's `linear`.
pub fn linear(input: &Tensor, weight: &Tensor, bias: &Tensor, rows: usize, relu: bool) -> Tensor {
    let [outputs, inner] = [0, 1].map(|i| weight.dims()[i]);
    let mut output = Tensor::zeros([rows, outputs]);
    let row = |(out, row): (&mut [f32], &[f32])| {
        let weights = weight.data().chunks_exact(inner);
        for ((out, weights), bias) in out.iter_mut().zip(weights).zip(bias.data()) {
            let value = f64::from(*bias) + shared::dot(weights, row);
            *out = if relu { shared::relu(value) } else { value } as f32;
        }
    };
    let rows = output.data_mut().chunks_mut(outputs).zip(input.data().chunks(inner));
    each(rows, |part| {
        shared::vectorised(
            #[inline(always)]
            || row(part),
        )
    });
    output
}
