use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::NotFinite;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("not_finite");
}

#[test]
fn refuses_what_does_not_fit() {
    for values in [TensorSpec::u32([4]), TensorSpec::f32([]), TensorSpec::f32([4, 0])] {
        let message = refusal(&NotFinite::default(), &[values]);
        assert!(message.contains("`values0`: expected f32 [N, …] without a zero"), "{message}");
    }
    let specs = [TensorSpec::f32([4, 5]), TensorSpec::u32([4])];
    let message = refusal(&NotFinite { values: 1, count: true }, &specs);
    assert!(message.contains("`count`: expected u32[1], got u32[4]"), "{message}");
}
