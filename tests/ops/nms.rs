use crate::support::{check_op, recording_error};
use smr_gpu::engine::ops::{Nms, Op};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("nms");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = Nms::default();
    let text = |op: Nms, specs: &[TensorSpec]| op.infer(specs).expect_err("an error").to_string();
    let (boxes, scores) = (TensorSpec::f32([5, 4]), TensorSpec::f32([5]));
    let message = text(op, &[TensorSpec::f32([5, 5]), scores.clone()]);
    assert!(message.contains("`boxes`") && message.contains("[N, 4]"), "{message}");
    let message = text(op, &[boxes.clone(), TensorSpec::f32([4])]);
    assert!(message.contains("`scores`") && message.contains("f32[5]"), "{message}");
    let both = Nms { classes: true, count: true, ..op };
    let specs = |classes, count| [boxes.clone(), scores.clone(), classes, count];
    let message = text(both, &specs(TensorSpec::f32([5]), TensorSpec::u32([1])));
    assert!(message.contains("`classes`") && message.contains("u32[5]"), "{message}");
    let message = text(both, &specs(TensorSpec::u32([5]), TensorSpec::u32([2])));
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
    let message = text(Nms { iou_threshold: 1.5, ..op }, &[boxes.clone(), scores.clone()]);
    assert!(message.contains("iou_threshold") && message.contains("0 to 1"), "{message}");
    let message = text(Nms { max_out: 0, ..op }, &[boxes.clone(), scores.clone()]);
    assert!(message.contains("max_out"), "{message}");

    let message = recording_error(op, &[TensorSpec::f32([1025, 4]), TensorSpec::f32([1025])]);
    assert!(message.contains("needs 1025, but only 1024"), "{message}");
}
