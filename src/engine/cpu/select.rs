//! Which kernel computes an operation.

use std::any::Any;

use super::kernel::Kernel;
use super::words::Numbers;
use super::{conv2d, crop_resize, linear, maps, packs, pooling, proposals, roi_align};
use crate::engine::ops::{
    ApplyGates, ChannelPool, Conv2d, CropResize, DecodeProposals, GlobalAvgPool, Linear, MaxPool2d,
    Op, RoiAlign, SpatialPool, TopK, UpsampleBilinear, WeightedSum,
};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Constant;
use crate::error::Result;

/// The kernel for an operation on inputs of these shapes. `constants` holds those inputs that are known
/// now; weights, by their `name`, that `packs` has got already are shared. Products are of `numbers` where the
/// kernel knows how.
pub(super) fn kernel(
    op: &dyn Op,
    inputs: &[TensorSpec],
    outputs: &[TensorSpec],
    constants: &[Option<&Constant>],
    (packs, numbers): (&packs::Packs, Numbers),
    name: &str,
) -> Result<Option<Box<dyn Kernel>>> {
    let any: &dyn Any = op;
    let constant = |index: usize| constants.get(index).copied().flatten();
    let pack = constant(1).map(|weight| packs::Pack { all: packs, name, weight, numbers });
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
    if any.is::<ApplyGates>() {
        let (Some(weight), Some(bias)) = (constant(3), constant(4)) else { return Ok(None) };
        let (weight, bias) = (weight.get()?, bias.get()?);
        let gates = maps::Gates::new(&inputs[0], weight.f32()?.data(), bias.f32()?.data()[0]);
        return Ok(Some(Box::new(gates)));
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
    if let Some(op) = any.downcast_ref::<TopK>() {
        return Ok(Some(Box::new(proposals::Highest { op: *op })));
    }
    if let Some(op) = any.downcast_ref::<DecodeProposals>() {
        let columns = inputs[0].shape.0[2];
        return Ok(Some(Box::new(proposals::Decoded { op: op.clone(), columns })));
    }
    Ok(None)
}
