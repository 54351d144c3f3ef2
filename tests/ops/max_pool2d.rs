use crate::support::{check_op, refusal};
use smr_gpu::ops::MaxPool2d;
use smr_gpu::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("max_pool2d");
}

#[test]
fn refuses_what_does_not_fit() {
    let with = |kernel, stride, padding| {
        let op = MaxPool2d { kernel, stride, padding };
        refusal(&op, &[TensorSpec::f32([1, 4, 9])])
    };
    let message = with(0, 1, 0);
    assert!(message.contains("`kernel`: expected 1 to 4096, got 0"), "{message}");
    let message = with(2, 0, 0);
    assert!(message.contains("`stride`: expected 1 to 4096, got 0"), "{message}");
    // Such a window could lie in the padding alone.
    let message = with(3, 2, 2);
    assert!(message.contains("`padding`: expected at most half the kernel (1)"), "{message}");
    let message = with(5, 1, 0);
    assert!(message.contains("`input`: expected at least the kernel (5)"), "{message}");
}
