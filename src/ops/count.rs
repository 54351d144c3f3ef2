//! Counts on the device: how many leading rows of a tensor are in use.
//!
//! A count is a u32 `[1]` tensor that the host never sees. Shaders clamp it to the tensor's fixed
//! capacity, and so do the references.

use crate::error::{Error, Result};
use crate::gpu::{Grid, Recording, TensorId};
use crate::ops::indirect_grid::record_indirect_grid;
use crate::ops::op::expect;
use crate::shape::TensorSpec;
use crate::tensor::{Tensor, Value};

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

/// The count to bind: the given one, or a constant that says that every row is in use.
pub(crate) fn count_tensor(
    recording: &mut Recording,
    count: Option<TensorId>,
    capacity: usize,
) -> TensorId {
    count.unwrap_or_else(|| {
        recording.constant("count (all)", Tensor::from_fn([1], |_| capacity as u32))
    })
}

/// Workgroups of `size` for `capacity` rows of `items` invocations each: indirect over the rows in
/// use where there is a count.
pub(crate) fn row_grid(
    recording: &mut Recording,
    count: Option<TensorId>,
    capacity: usize,
    items: usize,
    size: u32,
) -> Result<Grid> {
    Ok(match count {
        None => Grid::linear(capacity * items, size),
        Some(count) => {
            let items = u32::try_from(items).map_err(|_| Error::Capacity {
                what: "invocations for one row".into(),
                needed: items as u64,
                available: u64::from(u32::MAX),
            })?;
            Grid::Indirect(record_indirect_grid(recording, count, capacity, items, size)?)
        }
    })
}
