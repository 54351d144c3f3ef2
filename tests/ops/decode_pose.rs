use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::DecodePose;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("decode_pose");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = DecodePose {};
    let count = TensorSpec::u32([1]);
    let message = refusal(&op, &[TensorSpec::f32([3, 5]), count.clone()]);
    assert!(message.contains("`rows`: expected f32 [K, 6], got f32[3, 5]"), "{message}");
    let message = refusal(&op, &[TensorSpec::u32([3, 6]), count]);
    assert!(message.contains("`rows`") && message.contains("f32 of rank 2"), "{message}");
    let message = refusal(&op, &[TensorSpec::f32([3, 6]), TensorSpec::f32([1])]);
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
}
