use crate::support::check_op;
use smr_gpu::engine::ops::{Conv2d, Op};
use smr_gpu::engine::shape::TensorSpec;
use smr_gpu::engine::tensor::Tensor;

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

/// 1024 channels of 8193 × 8193 pixels of which one is no padding: 550 GB for an output of 268 MB.
#[test]
fn the_reference_refuses_padding_past_all_memory() {
    let op = Conv2d { padding: 4096, bias: false, ..Conv2d::default() };
    let input = Tensor::<f32>::zeros([1024, 1, 1]).into();
    let weight = Tensor::<f32>::zeros([1, 1024, 1, 1]).into();
    let message = op.reference(&[&input, &weight]).expect_err("an error").to_string();
    assert!(message.contains("bytes of the padded input: needs 549890"), "{message}");
    assert!(message.contains("only 4294967296"), "{message}");
}
