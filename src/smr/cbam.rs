//! CBAM: channel attention, then spatial attention.
//!
//! The paper writes CABM in places; its text and figure describe CBAM (Woo et al. 2018), which is
//! what this is, with reduction 16 and the batch norm of CBAM's published code on the spatial gate.

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::{ApplyGates, ChannelGate, ChannelPool, SpatialPool};
use crate::error::Result;
use crate::smr::weights::Weights;

/// How the name ends of what an attention pools over space.
pub(super) const POOLED: &str = ".channel.pool";

/// Appends the attention called `name` to `input` `[C, H, W]`.
pub(super) fn cbam(
    graph: &mut Graph,
    weights: &mut Weights,
    name: &str,
    input: TensorId,
) -> Result<TensorId> {
    let channels = graph.spec(input).shape.0[0];
    let hidden = (channels / weights.config().reduction).max(1);
    let fc1 = weights.take_biased(&format!("{name}.channel.fc1"), [hidden, channels])?;
    let fc2 = weights.take_biased(&format!("{name}.channel.fc2"), [channels, hidden])?;
    let conv = weights.take_folded(
        &format!("{name}.spatial.conv"),
        &format!("{name}.spatial.bn"),
        [1, 2, 7, 7],
    )?;
    let of = |part: &str| format!("{name}.{part}");
    let mlp = [
        graph.constant(of("channel.fc1.weight"), fc1.weight),
        graph.constant(of("channel.fc1.bias"), fc1.bias),
        graph.constant(of("channel.fc2.weight"), fc2.weight),
        graph.constant(of("channel.fc2.bias"), fc2.bias),
    ];
    let pooled = graph.apply1(&format!("{name}{POOLED}"), ChannelPool, &[input])?;
    let channel_gate =
        graph.apply1(&of("channel"), ChannelGate, &[pooled, mlp[0], mlp[1], mlp[2], mlp[3]])?;
    let pooled = graph.apply1(&of("spatial.pool"), SpatialPool, &[input, channel_gate])?;
    let weight = graph.constant(of("spatial.conv.weight"), conv.weight);
    let bias = graph.constant(of("spatial.conv.bias"), conv.bias);
    graph.apply1(name, ApplyGates, &[input, channel_gate, pooled, weight, bias])
}
