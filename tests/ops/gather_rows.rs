use crate::support::check_op;
use smr_gpu::engine::ops::{GatherRows, Op};
use smr_gpu::engine::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("gather_rows");
}

#[test]
fn refuses_what_does_not_fit() {
    let text = |rows: TensorSpec, indices: TensorSpec, count: TensorSpec| {
        GatherRows {}.infer(&[rows, indices, count]).expect_err("an error").to_string()
    };
    let (rows, indices, count) = (TensorSpec::u32([3]), TensorSpec::u32([2]), TensorSpec::u32([1]));
    let message = text(TensorSpec::f32([1, 2, 3]), indices.clone(), count.clone());
    assert!(message.contains("`rows`") && message.contains("[N, M]"), "{message}");
    let message = text(rows.clone(), TensorSpec::f32([2]), count);
    assert!(message.contains("`indices`") && message.contains("u32 of rank 1"), "{message}");
    let message = text(rows, indices, TensorSpec::u32([2]));
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
}
