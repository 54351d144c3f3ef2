//! Layers that several stages share.

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::Conv2d;
use crate::engine::shape::Shape;
use crate::error::Result;
use crate::smr::weights::{Folded, Weights};

/// Appends a convolution with its batch norm folded in. `inputs` is the map and, where `op` adds
/// one, the residual; the result is called after the convolution.
pub(super) fn conv_bn(
    graph: &mut Graph,
    weights: &mut Weights,
    (conv, bn): (&str, &str),
    op: Conv2d,
    shape: impl Into<Shape>,
    inputs: &[TensorId],
) -> Result<TensorId> {
    let folded = weights.take_folded(conv, bn, shape)?;
    convolve(graph, conv, op, folded, inputs)
}

/// Appends a convolution with a bias of its own.
pub(super) fn conv(
    graph: &mut Graph,
    weights: &mut Weights,
    name: &str,
    op: Conv2d,
    shape: impl Into<Shape>,
    input: TensorId,
) -> Result<TensorId> {
    let biased = weights.take_biased(name, shape)?;
    convolve(graph, name, op, biased, &[input])
}

/// Appends a convolution with the given weight and bias.
pub(super) fn convolve(
    graph: &mut Graph,
    name: &str,
    op: Conv2d,
    Folded { weight, bias }: Folded,
    inputs: &[TensorId],
) -> Result<TensorId> {
    let weight = graph.constant(format!("{name}.weight"), weight);
    let bias = graph.constant(format!("{name}.bias"), bias);
    let all: Vec<_> = [inputs[0], weight, bias].into_iter().chain(inputs.get(1).copied()).collect();
    graph.apply1(name, op, &all)
}
