use crate::support::check_op;
use smr_gpu::ops::{IndirectGrid, Op};
use smr_gpu::shape::TensorSpec;

#[test]
fn shader_matches_reference_and_hand() {
    check_op("indirect_grid");
}

#[test]
fn refuses_what_does_not_fit() {
    let op = IndirectGrid { capacity: 9, items_per_count: 1, workgroup_size: 64, layers: 1 };
    let message = op.infer(&[TensorSpec::f32([1])]).expect_err("f32").to_string();
    assert!(message.contains("`count`") && message.contains("u32[1]"), "{message}");
    let zero = IndirectGrid { workgroup_size: 0, ..op };
    let message = zero.infer(&[TensorSpec::u32([1])]).expect_err("zero").to_string();
    assert!(message.contains("`workgroup_size`: expected 1 to 256, got 0"), "{message}");

    let op = IndirectGrid { capacity: 65_536, items_per_count: 65_536, ..op };
    let message = op.infer(&[TensorSpec::u32([1])]).expect_err("past a u32").to_string();
    assert!(message.contains("needs 4294967296, but only 4294967295"), "{message}");
}
