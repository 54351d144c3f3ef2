use crate::support::check_op;
use smr_gpu::engine::ops::{DecodeDetections, Op};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("decode_detections");
}

fn specs(rois: usize, deltas: usize, classes: usize) -> [TensorSpec; 4] {
    [
        TensorSpec::f32([rois, 4]),
        TensorSpec::f32([5, deltas]),
        TensorSpec::f32([5, classes]),
        TensorSpec::u32([1]),
    ]
}

#[test]
fn refuses_what_does_not_fit() {
    let op = DecodeDetections::default();
    let text = |op: DecodeDetections, specs: [TensorSpec; 4]| {
        op.infer(&specs).expect_err("an error").to_string()
    };
    let message = text(op, specs(4, 12, 3));
    assert!(message.contains("`rois`") && message.contains("f32[5, 4]"), "{message}");
    let message = text(op, specs(5, 8, 3));
    assert!(message.contains("`deltas`") && message.contains("f32[5, 12]"), "{message}");
    let message = text(op, specs(5, 4, 1));
    assert!(message.contains("`logits`") && message.contains("2 classes"), "{message}");
    let zero = DecodeDetections { weights: [10.0, 10.0, 0.0, 5.0], ..op };
    let message = text(zero, specs(5, 12, 3));
    assert!(message.contains("`weights`: expected numbers from 0.001 to 1000"), "{message}");
    let message = text(op, specs(5, 132, 33));
    assert!(message.contains("needs 33, but only 32"), "{message}");
}
