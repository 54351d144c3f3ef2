use crate::support::{check_op, refusal};
use smr_gpu::ops::DecodePose;
use smr_gpu::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("decode_pose");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = DecodePose { classes: 2 };
    let (rows, keep, count) = (TensorSpec::f32([3, 6]), TensorSpec::u32([9]), TensorSpec::u32([1]));
    let message = refusal(&op, &[TensorSpec::f32([3, 5]), keep.clone(), count.clone()]);
    assert!(message.contains("`rows`: expected f32 [R, 6], got f32[3, 5]"), "{message}");
    let message = refusal(&op, &[rows.clone(), TensorSpec::f32([9]), count]);
    assert!(message.contains("`keep`") && message.contains("u32 of rank 1"), "{message}");
    let message = refusal(&op, &[rows.clone(), keep.clone(), TensorSpec::f32([1])]);
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
    let specs = [rows, keep, TensorSpec::u32([1])];
    let message = refusal(&DecodePose { classes: 0 }, &specs);
    assert!(message.contains("`classes`: expected 1 to 32, got 0"), "{message}");
}
