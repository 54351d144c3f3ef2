use crate::support::{check_op, recording_error, refusal};
use smr_gpu::engine::ops::{Linear, Op};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("linear");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = Linear { relu: false, count: true };
    let specs = |input: &[usize], bias: usize, count: usize| {
        let input = smr_gpu::engine::shape::Shape(input.to_vec());
        let weight = TensorSpec::f32([2, 6]);
        [TensorSpec::f32(input), weight, TensorSpec::f32([bias]), TensorSpec::u32([count])]
    };
    let text = |specs: [TensorSpec; 4]| op.infer(&specs).expect_err("an error").to_string();
    let message = text(specs(&[4, 5], 2, 1));
    assert!(message.contains("`input`") && message.contains("6 elements a row"), "{message}");
    let message = text(specs(&[5], 2, 1));
    assert!(message.contains("`input`") && message.contains("f32 [6], or [R, …]"), "{message}");
    let scalar = [TensorSpec::f32([]), TensorSpec::f32([2, 1]), TensorSpec::f32([2])];
    let message = refusal(&Linear::default(), &scalar);
    assert!(message.contains("`input`") && message.contains("f32 [1], or [R, …]"), "{message}");
    let message = text(specs(&[4, 2, 3], 3, 1));
    assert!(message.contains("`bias`") && message.contains("f32[2]"), "{message}");
    let message = text(specs(&[4, 2, 3], 2, 3));
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");

    let message = recording_error(op, &specs(&[4, 6], 2, 1));
    assert!(message.contains("known when recording") && message.contains("an input"), "{message}");
}
