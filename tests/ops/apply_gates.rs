use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::ApplyGates;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("apply_gates");
}

#[test]
fn refuses_what_does_not_fit() {
    let specs = |channel: usize, spatial: [usize; 3]| {
        [TensorSpec::f32([4, 3, 5]), TensorSpec::f32([channel]), TensorSpec::f32(spatial)]
    };
    let message = refusal(&ApplyGates, &specs(5, [1, 3, 5]));
    assert!(message.contains("`channel_gate`: expected f32[4], got f32[5]"), "{message}");
    let message = refusal(&ApplyGates, &specs(4, [1, 5, 3]));
    assert!(message.contains("`spatial_gate`: expected f32[1, 3, 5]"), "{message}");
}
