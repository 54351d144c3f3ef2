use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::SpatialGate;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("spatial_gate");
}

#[test]
fn refuses_what_does_not_fit() {
    let specs = |maps: usize, kernel: usize| {
        let weight = TensorSpec::f32([1, 2, kernel, kernel]);
        [TensorSpec::f32([maps, 4, 4]), weight, TensorSpec::f32([1])]
    };
    let message = refusal(&SpatialGate, &specs(3, 7));
    assert!(message.contains("`pooled`: expected [2, H, W], got f32[3, 4, 4]"), "{message}");
    let message = refusal(&SpatialGate, &specs(2, 3));
    assert!(message.contains("`weight`: expected f32[1, 2, 7, 7]"), "{message}");
}
