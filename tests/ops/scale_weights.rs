use crate::support::recording_error;
use crate::support::{check_op, refusal};
use smr_gpu::ops::ScaleWeights;
use smr_gpu::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("scale_weights");
}

fn specs(length: usize, hidden: usize, scales: usize) -> Vec<TensorSpec> {
    vec![
        TensorSpec::f32([length]),
        TensorSpec::f32([hidden, length]),
        TensorSpec::f32([hidden]),
        TensorSpec::f32([scales, hidden]),
        TensorSpec::f32([scales]),
    ]
}

#[test]
fn refuses_what_does_not_fit() {
    let with = |i: usize, spec: TensorSpec| {
        let mut specs = specs(192, 64, 3);
        specs[i] = spec;
        refusal(&ScaleWeights, &specs)
    };
    let message = with(0, TensorSpec::f32([192, 1]));
    assert!(message.contains("`pooled`: expected f32 of rank 1"), "{message}");
    let message = with(0, TensorSpec::f32([128]));
    assert!(message.contains("`fc1_weight`: expected [M, 128]"), "{message}");
    let message = with(2, TensorSpec::f32([65]));
    assert!(message.contains("`fc1_bias`: expected f32[64]"), "{message}");
    let message = with(3, TensorSpec::f32([3, 63]));
    assert!(message.contains("`fc2_weight`: expected [K, 64]"), "{message}");
    let message = with(4, TensorSpec::f32([2]));
    assert!(message.contains("`fc2_bias`: expected f32[3]"), "{message}");
}

#[test]
fn too_many_units_name_the_capacity() {
    let message = recording_error(ScaleWeights, &specs(3, 1025, 3));
    assert!(message.contains("hidden units: needs 1025, but only 1024"), "{message}");
    let message = recording_error(ScaleWeights, &specs(3, 5, 257));
    assert!(message.contains("scales: needs 257, but only 256"), "{message}");
}
