use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::UpsampleBilinear;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("upsample_bilinear");
}

#[test]
fn refuses_what_does_not_fit() {
    let with = |out_height, out_width, input: [usize; 3]| {
        refusal(&UpsampleBilinear { out_height, out_width }, &[TensorSpec::f32(input)])
    };
    let message = with(0, 4, [1, 2, 2]);
    assert!(message.contains("`out_height`: expected 1 to 32768, got 0"), "{message}");
    let message = with(4, 32_769, [1, 2, 2]);
    assert!(message.contains("`out_width`: expected 1 to 32768"), "{message}");
    let message = with(4, 4, [1, 2, 40_000]);
    assert!(message.contains("`input`: expected edges of at most 32768"), "{message}");
}
