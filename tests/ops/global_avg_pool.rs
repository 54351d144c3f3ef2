use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::GlobalAvgPool;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("global_avg_pool");
}

#[test]
fn refuses_what_does_not_fit() {
    let message = refusal(&GlobalAvgPool { maps: 1 }, &[TensorSpec::f32([4, 5])]);
    assert!(message.contains("`map0`: expected f32 of rank 3, got f32[4, 5]"), "{message}");
    let message = refusal(&GlobalAvgPool { maps: 1 }, &[TensorSpec::f32([4, 0, 5])]);
    assert!(message.contains("without a zero"), "{message}");
    let message = refusal(&GlobalAvgPool { maps: 4 }, &[]);
    assert!(message.contains("`maps`: expected 1 to 3, got 4"), "{message}");
}
