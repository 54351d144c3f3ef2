use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::ChannelPool;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("channel_pool");
}

#[test]
fn refuses_what_does_not_fit() {
    let message = refusal(&ChannelPool, &[TensorSpec::f32([4, 5])]);
    assert!(message.contains("`input`: expected f32 of rank 3, got f32[4, 5]"), "{message}");
    let message = refusal(&ChannelPool, &[TensorSpec::f32([4, 0, 5])]);
    assert!(message.contains("without a zero"), "{message}");
}
