//! Counts on the device: how many leading rows of a tensor are in use.
//!
//! A count is a u32 `[1]` tensor that the host never sees. Shaders clamp it to the tensor's fixed
//! capacity, and so do the references.

use crate::engine::ops::op::expect;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::Result;

/// Checks that a count, if there is one, is u32 `[1]`.
pub(crate) fn expect_count(op: &str, count: Option<&TensorSpec>) -> Result<()> {
    count.map_or(Ok(()), |spec| expect(op, "count", &TensorSpec::u32([1]), spec))
}

/// Rows in use, for a reference: `count` clamped to `capacity`, or all.
pub(crate) fn live(count: Option<&Value>, capacity: usize) -> Result<usize> {
    match count {
        None => Ok(capacity),
        Some(count) => Ok(capacity.min(count.u32()?.data()[0] as usize)),
    }
}
