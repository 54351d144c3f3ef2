use crate::support::{check_op, record};
use smr_gpu::engine::ops::{Op, TopK};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("top_k");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = TopK { k: 1025, count: true };
    let count = TensorSpec::u32([1]);
    let text = |op: TopK, specs: &[TensorSpec]| op.infer(specs).expect_err("an error").to_string();
    let message = text(op, &[TensorSpec::f32([2, 3]), count.clone()]);
    assert!(message.contains("`scores`") && message.contains("[C, H, W]"), "{message}");
    let message = text(op, &[TensorSpec::f32([0]), count.clone()]);
    assert!(message.contains("without a zero"), "{message}");
    let message = text(op, &[TensorSpec::f32([9]), TensorSpec::u32([2])]);
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
    let message = text(TopK { k: 0, ..op }, &[TensorSpec::f32([9]), count.clone()]);
    assert!(message.contains("`k`: expected 1 to 4294967295, got 0"), "{message}");

    // 1025 of 1025 is one too many, but of 1024 scores there are only 1024 to sort.
    for (n, fits) in [(1024, true), (1025, false)] {
        let result = record(op, &[TensorSpec::f32([n]), count.clone()]);
        match result {
            Ok(()) => assert!(fits, "{n}"),
            Err(e) => assert!(!fits && e.to_string().contains("needs 1025, but only 1024"), "{e}"),
        }
    }
}
