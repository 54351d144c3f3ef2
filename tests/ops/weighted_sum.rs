use crate::support::{check_op, refusal};
use smr_gpu::engine::ops::WeightedSum;
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("weighted_sum");
}

#[test]
fn refuses_what_does_not_fit() {
    let map = || TensorSpec::f32([4, 3, 5]);
    let three = WeightedSum { maps: 3 };
    let message = refusal(&three, &[TensorSpec::f32([2]), map(), map(), map()]);
    assert!(message.contains("`weights`: expected f32[3], got f32[2]"), "{message}");
    let other = TensorSpec::f32([4, 5, 3]);
    let message = refusal(&three, &[TensorSpec::f32([3]), map(), map(), other]);
    assert!(message.contains("`map2`: expected f32[4, 3, 5]"), "{message}");
    let message = refusal(&three, &[TensorSpec::f32([3]), map(), map()]);
    assert!(message.contains("`weights, map0, map1, map2`: expected 4, got 3"), "{message}");
    for maps in [0, 6] {
        let message = refusal(&WeightedSum { maps }, &[]);
        assert!(message.contains("`maps`: expected 1 to 5"), "{message}");
    }
}
