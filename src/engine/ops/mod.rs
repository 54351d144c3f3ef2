//! The operations: for each, its parameters, shape check, reference, error bound and cases.
//!
//! One operation is one stem in five places: `wgsl/` and `src/engine/kernels/`, a file or a folder for
//! several kernels, `src/engine/ops/<op>.rs`, `src/engine/reference/<op>.rs` and `tests/ops/<op>.rs`.

pub mod case;
pub mod op;
pub mod params;

mod apply_gates;
pub mod bounds;
mod box_voting;
mod boxes;
mod channel_gate;
mod channel_pool;
mod contact_map;
pub(crate) mod conv2d;
pub(crate) mod count;
mod crop_resize;
mod decode_detections;
mod decode_pose;
mod decode_proposals;
pub(crate) mod gather_rows;
pub(crate) mod global_avg_pool;
mod indirect_grid;
pub(crate) mod linear;
mod max_pool2d;
pub(crate) mod nms;
pub(crate) mod not_finite;
mod roi_align;
pub(crate) mod softmax;
mod spatial_pool;
pub(crate) mod top_k;
mod upsample_bilinear;
pub(crate) mod weighted_sum;
pub(crate) mod winograd;

pub use crate::engine::reference::Crop;
pub use apply_gates::ApplyGates;
pub use box_voting::BoxVoting;
pub use case::{Case, Expected, Report};
pub use channel_gate::ChannelGate;
pub use channel_pool::ChannelPool;
pub use contact_map::ContactMap;
pub use conv2d::Conv2d;
pub use crop_resize::CropResize;
pub(crate) use crop_resize::{MEAN, STD};
pub use decode_detections::DecodeDetections;
pub use decode_pose::DecodePose;
pub use decode_proposals::DecodeProposals;
pub use gather_rows::GatherRows;
pub use global_avg_pool::GlobalAvgPool;
pub use indirect_grid::IndirectGrid;
pub use linear::Linear;
pub use max_pool2d::MaxPool2d;
pub use nms::Nms;
pub use not_finite::NotFinite;
pub use op::{Entry, Op, Tolerance};
pub use params::{Param, Params, Range, Setting, Settings};
pub use roi_align::RoiAlign;
pub use softmax::Softmax;
pub use spatial_pool::SpatialPool;
pub use top_k::TopK;
pub use upsample_bilinear::UpsampleBilinear;
pub use weighted_sum::WeightedSum;

/// Every operation, by name.
pub static OPS: &[&Entry] = &[
    &apply_gates::ENTRY,
    &box_voting::ENTRY,
    &channel_gate::ENTRY,
    &channel_pool::ENTRY,
    &contact_map::ENTRY,
    &conv2d::ENTRY,
    &crop_resize::ENTRY,
    &decode_detections::ENTRY,
    &decode_pose::ENTRY,
    &decode_proposals::ENTRY,
    &gather_rows::ENTRY,
    &global_avg_pool::ENTRY,
    &indirect_grid::ENTRY,
    &linear::ENTRY,
    &max_pool2d::ENTRY,
    &nms::ENTRY,
    &not_finite::ENTRY,
    &roi_align::ENTRY,
    &softmax::ENTRY,
    &spatial_pool::ENTRY,
    &top_k::ENTRY,
    &upsample_bilinear::ENTRY,
    &weighted_sum::ENTRY,
];

/// The operation called `name`.
pub fn find(name: &str) -> Option<&'static Entry> {
    OPS.iter().copied().find(|e| e.name == name)
}
