//! The network in f32 on this machine's CPU, for machines without an adapter.
//!
//! A [`CpuPlan`] is a [`Graph`] made ready: each operation by a kernel with
//! its weights packed, each tensor in a buffer that is reused when it is dead. Maps lie with a
//! pixel's channels side by side, so that a convolution is a matrix product over them; where a
//! kernel wants the other order, the plan puts a conversion.
//!
//! | file | what it computes |
//! |---|---|
//! | `conv2d`, `winograd`, `linear`, `gemm` | convolutions and fully connected layers, as matrix products |
//! | `crop_resize` | the network's input |
//! | `pooling`, `maps` | CBAM's poolings and gates, the largest in windows, interpolation, weighted sums |
//! | `roi_align` | features of each box |
//! | `reference` | everything else, which is small: as [`crate::engine::reference`] does |
//!
//! It knows no GPU. Results are within the bounds to which a shader is held, but not bit for bit
//! those of another machine: the matrix product chooses its order by the CPU.

mod conv2d;
mod crop_resize;
mod gemm;
mod kernel;
mod linear;
mod maps;
mod packs;
mod plan;
mod pooling;
mod reference;
mod roi_align;
mod winograd;

use std::any::Any;

use crate::engine::graph::Graph;
use crate::engine::ops::case::{Expected, Report, WEIGHTS};
use crate::engine::ops::{
    ApplyGates, ChannelPool, Conv2d, CropResize, GlobalAvgPool, Linear, MaxPool2d, Op, RoiAlign,
    SpatialGate, SpatialPool, Tolerance, UpsampleBilinear, WeightedSum,
};
use crate::engine::shape::{Extent, TensorSpec};
use crate::engine::tensor::{Constant, Value};
use crate::error::Result;

use kernel::Kernel;
pub use plan::CpuPlan;
pub(crate) use plan::Given;

/// The kernel for an operation on inputs of these shapes. `constants` holds those inputs that are known
/// now; weights, by their `name`, that `packs` has got already are shared.
fn kernel(
    op: &dyn Op,
    inputs: &[TensorSpec],
    outputs: &[TensorSpec],
    constants: &[Option<&Constant>],
    packs: &packs::Packs,
    name: &str,
) -> Result<Option<Box<dyn Kernel>>> {
    let any: &dyn Any = op;
    let constant = |index: usize| constants.get(index).copied().flatten();
    let pack = constant(1).map(|weight| packs::Pack { all: packs, name, weight });
    if let Some(op) = any.downcast_ref::<Conv2d>() {
        let bias = if op.bias { constant(2) } else { None };
        let Some(pack) = pack.filter(|_| op.bias == bias.is_some()) else { return Ok(None) };
        let bias = bias.map(Constant::get).transpose()?;
        let bias = bias.as_ref().map(|bias| bias.f32()).transpose()?;
        let conv = conv2d::Convolution::new(*op, &inputs[0], &outputs[0], bias, pack)?;
        return Ok(Some(Box::new(conv)));
    }
    if let Some(op) = any.downcast_ref::<Linear>() {
        let (Some(pack), Some(bias)) = (pack, constant(2)) else { return Ok(None) };
        let layer = linear::FullyConnected::new(*op, &inputs[0], bias.get()?.f32()?, pack)?;
        return Ok(Some(Box::new(layer)));
    }
    if let Some(op) = any.downcast_ref::<CropResize>() {
        return Ok(Some(Box::new(crop_resize::Resize { op: *op })));
    }
    if let Some(op) = any.downcast_ref::<MaxPool2d>() {
        return Ok(Some(Box::new(pooling::Windows::new(*op, &inputs[0], &outputs[0]))));
    }
    if any.is::<ChannelPool>() {
        return Ok(Some(Box::new(pooling::OverSpace::new(inputs, true))));
    }
    if any.is::<GlobalAvgPool>() {
        return Ok(Some(Box::new(pooling::OverSpace::new(inputs, false))));
    }
    if any.is::<SpatialPool>() {
        return Ok(Some(Box::new(pooling::OverChannels::new(&inputs[0]))));
    }
    if any.is::<SpatialGate>() {
        let (Some(weight), Some(bias)) = (constant(1), constant(2)) else { return Ok(None) };
        let (weight, bias) = (weight.get()?, bias.get()?);
        let logits =
            maps::SpatialGates::new(&inputs[0], weight.f32()?.data(), bias.f32()?.data()[0]);
        return Ok(Some(Box::new(logits)));
    }
    if any.is::<ApplyGates>() {
        return Ok(Some(Box::new(maps::Gates { channels: inputs[0].shape.0[0] })));
    }
    if any.is::<UpsampleBilinear>() {
        return Ok(Some(Box::new(maps::Bilinear::new(&inputs[0], &outputs[0]))));
    }
    if any.is::<WeightedSum>() {
        return Ok(Some(Box::new(maps::Sum)));
    }
    if let Some(op) = any.downcast_ref::<RoiAlign>() {
        let rois = inputs[1].shape.0[0];
        let regions = roi_align::Regions::new(op.grid(), &inputs[0], rois, op.count);
        return Ok(Some(Box::new(regions)));
    }
    Ok(None)
}

/// Runs a case by this module's kernels and holds it to its reference.
///
/// # Errors
/// What the operation refuses. Wrong values are no error, but failures in the report.
pub fn check_expected(expected: &Expected) -> Result<Report> {
    let case = expected.case();
    let mut graph = Graph::default();
    let mut given = Vec::new();
    let mut inputs = Vec::new();
    for (value, name) in case.inputs.iter().zip(case.op.inputs()) {
        inputs.push(match WEIGHTS.contains(&name) {
            true => graph.constant(name, value.clone()),
            false => {
                let id = graph.input(name, value.spec(), Extent::Exact);
                given.push((id, value));
                id
            }
        });
    }
    let outputs = graph.apply_shared(&case.name, case.op.clone(), &inputs)?;
    outputs.iter().for_each(|id| graph.mark_output(*id));
    let plan = CpuPlan::new(&graph, &[], None)?;
    plan.poison();
    let (mut values, _) = plan.run(&graph, &given)?;
    let known: Vec<Value> = outputs.iter().filter_map(|id| values.remove(id)).collect();
    let inputs: Vec<&Value> = case.inputs.iter().collect();
    let own = plan.tolerance(&inputs)?.map(|bounds| vec![Tolerance::Each(bounds)]);
    Ok(expected.judge(&known, own.filter(|_| !case.exact)))
}

#[cfg(test)]
mod tests {
    use crate::engine::ops::OPS;
    use crate::verify::check::{Selection, Target, rows};

    #[test]
    fn every_case_is_within_its_bound() {
        let of = |entry| rows(&Target::Cpu, entry, &Selection::default()).expect("legal cases");
        let rows = OPS.iter().flat_map(|entry| of(entry));
        let failures: Vec<String> = rows.flat_map(|row| row.failures).collect();
        assert!(failures.is_empty(), "{}", failures.join("\n"));
    }
}
