use crate::support::check_op;
use smr_gpu::engine::ops::{Op, Softmax};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("softmax");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = Softmax { count: true, ..Softmax::default() };
    let text = |specs: &[TensorSpec]| op.infer(specs).expect_err("an error").to_string();
    let message = text(&[TensorSpec::f32([3, 2, 1]), TensorSpec::u32([1])]);
    assert!(message.contains("`input`") && message.contains("[R, N] or [N]"), "{message}");
    let message = text(&[TensorSpec::f32([3, 0]), TensorSpec::u32([1])]);
    assert!(message.contains("without a zero"), "{message}");
    let message = text(&[TensorSpec::f32([3, 2]), TensorSpec::f32([1])]);
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
}
