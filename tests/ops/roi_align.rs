use crate::support::check_op;
use smr_gpu::engine::ops::{Op, RoiAlign};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("roi_align");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = RoiAlign { spatial_scale: 0.125, output_size: 7, sampling_ratio: 2, count: true };
    let features = TensorSpec::f32([3, 8, 8]);
    let text = |op: RoiAlign, features: &TensorSpec, boxes: &[usize; 2], count: usize| {
        let specs = [features.clone(), TensorSpec::f32(*boxes), TensorSpec::u32([count])];
        op.infer(&specs).expect_err("an error").to_string()
    };
    let message = text(op, &TensorSpec::u32([3, 8, 8]), &[5, 4], 1);
    assert!(message.contains("`features`") && message.contains("f32 of rank 3"), "{message}");
    let message = text(op, &TensorSpec::f32([3, 0, 8]), &[5, 4], 1);
    assert!(message.contains("`features`") && message.contains("without a zero"), "{message}");
    let message = text(op, &features, &[5, 5], 1);
    assert!(message.contains("`boxes`") && message.contains("[R, 4]"), "{message}");
    let message = text(op, &features, &[5, 4], 2);
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
    let message = text(RoiAlign { sampling_ratio: 0, ..op }, &features, &[5, 4], 1);
    assert!(message.contains("sampling_ratio") && message.contains("1 to 256"), "{message}");
}
