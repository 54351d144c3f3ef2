use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::ApplyGates;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("apply_gates");
}

#[test]
fn refuses_what_does_not_fit() {
    let refused = |channels: usize, pooled: [usize; 3], kernel: usize| {
        let weight = TensorSpec::f32([1, 2, kernel, kernel]);
        let (map, gates) = (TensorSpec::f32([4, 3, 5]), TensorSpec::f32([channels]));
        refusal(&ApplyGates, &[map, gates, TensorSpec::f32(pooled), weight, TensorSpec::f32([1])])
    };
    let message = refused(5, [2, 3, 5], 7);
    assert!(message.contains("`channel_gate`: expected f32[4], got f32[5]"), "{message}");
    let message = refused(4, [2, 5, 3], 7);
    assert!(message.contains("`pooled`: expected f32[2, 3, 5], got f32[2, 5, 3]"), "{message}");
    let message = refused(4, [2, 3, 5], 3);
    assert!(message.contains("`weight`: expected f32[1, 2, 7, 7]"), "{message}");
}
