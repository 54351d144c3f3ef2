use crate::support::check_op;
use smr_gpu::ops::{Conv2d, Op};
use smr_gpu::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("conv2d");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = Conv2d { bias: false, ..Conv2d::default() };
    let infer = |input: TensorSpec, weight: TensorSpec| op.infer(&[input, weight]);
    let input = TensorSpec::f32([3, 8, 8]);
    let text = |r: smr_gpu::Result<Vec<TensorSpec>>| r.expect_err("an error").to_string();
    let message = text(infer(input.clone(), TensorSpec::f32([4, 2, 3, 3])));
    assert!(message.contains("weight") && message.contains("[O, 3, kh, kw]"), "{message}");
    let message = text(infer(input.clone(), TensorSpec::f32([4, 3, 9, 9])));
    assert!(message.contains("padded input"), "{message}");
    let message = text(infer(input, TensorSpec::u32([4, 3, 3, 3])));
    assert!(message.contains("f32 of rank 4"), "{message}");
    let zero = Conv2d { stride: 0, ..op };
    let specs = [TensorSpec::f32([1, 4, 4]), TensorSpec::f32([1, 1, 1, 1])];
    assert!(text(zero.infer(&specs)).contains("stride"));
}
