use crate::support::recording_error;
use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::ChannelGate;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("channel_gate");
}

fn specs(channels: usize, hidden: usize) -> Vec<TensorSpec> {
    vec![
        TensorSpec::f32([2, channels]),
        TensorSpec::f32([hidden, channels]),
        TensorSpec::f32([hidden]),
        TensorSpec::f32([channels, hidden]),
        TensorSpec::f32([channels]),
    ]
}

#[test]
fn refuses_what_does_not_fit() {
    let with = |i: usize, spec: TensorSpec| {
        let mut specs = specs(32, 2);
        specs[i] = spec;
        refusal(&ChannelGate, &specs)
    };
    let message = with(0, TensorSpec::f32([3, 32]));
    assert!(message.contains("`pooled`: expected [2, C]"), "{message}");
    let message = with(1, TensorSpec::f32([2, 31]));
    assert!(message.contains("`fc1_weight`: expected [R, 32]"), "{message}");
    let message = with(2, TensorSpec::f32([3]));
    assert!(message.contains("`fc1_bias`: expected f32[2]"), "{message}");
    let message = with(3, TensorSpec::f32([2, 32]));
    assert!(message.contains("`fc2_weight`: expected f32[32, 2]"), "{message}");
    let message = with(4, TensorSpec::u32([32]));
    assert!(message.contains("`fc2_bias`: expected f32[32], got u32[32]"), "{message}");
}

#[test]
fn too_many_hidden_units_name_the_capacity() {
    let message = recording_error(ChannelGate, &specs(3, 1025));
    assert!(message.contains("needs 1025, but only 1024"), "{message}");
}
