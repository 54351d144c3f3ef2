use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::SpatialPool;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("spatial_pool");
}

#[test]
fn refuses_what_does_not_fit() {
    let message = refusal(&SpatialPool, &[TensorSpec::f32([4, 3, 5]), TensorSpec::f32([3])]);
    assert!(message.contains("`channel_gate`: expected f32[4], got f32[3]"), "{message}");
    let message = refusal(&SpatialPool, &[TensorSpec::f32([4, 3, 5])]);
    assert!(message.contains("`input, channel_gate`: expected 2, got 1"), "{message}");
}
