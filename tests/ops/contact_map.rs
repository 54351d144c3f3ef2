use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::ContactMap;
use smr_gpu::engine::shape::TensorSpec;

const OWN: ContactMap = ContactMap {
    least: 0.0625,
    most: 0.25,
    clipped: 250.0,
    reach: 2,
    factor: 3.0,
    reference: false,
};

#[test]
fn shader_matches_reference_and_hand() {
    check_op("contact_map");
}

#[test]
fn refuses_what_does_not_fit() {
    let message = refusal(&OWN, &[TensorSpec::f32([4, 8, 8])]);
    assert!(message.contains("`cells`: expected three channels, got f32[4, 8, 8]"), "{message}");
    let against = ContactMap { reference: true, ..OWN };
    let specs = [TensorSpec::f32([3, 8, 8]), TensorSpec::f32([3, 8, 9])];
    let message = refusal(&against, &specs);
    assert!(message.contains("`reference`: expected f32[3, 8, 8], got f32[3, 8, 9]"), "{message}");
}
