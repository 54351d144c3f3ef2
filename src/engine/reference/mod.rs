//! The reference: each operation from its definition, with f64 sums and no GPU.
//!
//! The functions take tensors that `ops` has checked; a shape that does not fit is a bug here.

mod apply_gates;
mod box_voting;
mod channel_gate;
mod channel_pool;
mod contact_map;
mod conv2d;
mod crop_resize;
mod decode_detections;
mod decode_pose;
mod decode_proposals;
mod gather_rows;
mod global_avg_pool;
mod indirect_grid;
mod linear;
mod max_pool2d;
mod nms;
mod not_finite;
mod roi_align;
mod shared;
mod softmax;
mod spatial_pool;
mod top_k;
mod upsample_bilinear;
mod weighted_sum;

pub use apply_gates::apply_gates;
pub use box_voting::{Voters, box_voting};
pub use channel_gate::channel_gate;
pub use channel_pool::channel_pool;
pub use contact_map::{ContactRule, contact_map};
pub use conv2d::{ConvShape, conv2d};
pub use crop_resize::{Crop, crop_resize, triangle_filter};
pub use decode_detections::{Candidate, DetectionRule, decode_detections, margin};
pub use decode_pose::decode_pose;
pub use decode_proposals::{AnchorGrid, decode_proposals};
pub use gather_rows::gather_rows;
pub use global_avg_pool::global_avg_pool;
pub use indirect_grid::{MAX_WORKGROUPS, indirect_grid};
pub use linear::linear;
pub use max_pool2d::max_pool2d;
pub use nms::{NmsRule, nms};
pub use not_finite::not_finite;
pub use roi_align::{RoiGrid, neighbours, roi_align};
pub use shared::boxes::{MAX_LOG_SCALE, decode_box, iou_above};
pub use shared::{sigmoid, vectorised};
pub use softmax::softmax;
pub use spatial_pool::spatial_pool;
pub use top_k::top_k;
pub use upsample_bilinear::{between, upsample_bilinear};
pub use weighted_sum::weighted_sum;
