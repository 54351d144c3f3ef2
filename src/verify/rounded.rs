//! Tensors as a device stores or multiplies them.

#[cfg(feature = "cpu")]
use crate::engine::cpu::in_8_bits;
#[cfg(feature = "cpu")]
use crate::engine::ops::Op;
use crate::engine::precision::Precision;
use crate::engine::tensor::Tensor;

/// The tensor rounded to a precision of 16 bits; `None` if it overflows.
pub(super) fn in_half(tensor: &Tensor, precision: Precision) -> Option<Tensor> {
    let half = precision.rounded(tensor);
    let mut pairs = tensor.data().iter().zip(half.data());
    let overflows = pairs.any(|(x, half)| x.is_finite() && !half.is_finite());
    (!overflows).then_some(half)
}

/// Input `index` of an operation as cores multiply it in `precision`; `None` if it has a number that this does not
/// hold.
#[cfg(feature = "cpu")]
pub(super) fn multiplied(
    op: &dyn Op,
    index: usize,
    tensor: &Tensor,
    precision: Precision,
) -> Option<Tensor> {
    let is_weight = match op.inputs().get(index).copied() {
        Some("input") => false,
        Some("weight") => true,
        _ => return Some(tensor.clone()),
    };
    match precision {
        Precision::F32 => Some(tensor.clone()),
        Precision::F16 | Precision::Bf16 => in_half(tensor, precision),
        Precision::Int8 => {
            // By the scales of each output's weights, of each row of a layer's input or a convolution's whole map.
            let groups = match (is_weight, op.name()) {
                (true, _) => tensor.dims()[0],
                (false, "conv2d") => 1,
                (false, _) => crate::engine::ops::linear::rows(tensor.shape()),
            };
            in_8_bits(tensor, tensor.data().len() / groups.max(1), is_weight)
        }
    }
}
