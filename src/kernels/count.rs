//! Counts on the device: dispatches over the rows in use.

use crate::error::{Error, Result};
use crate::graph::TensorId;
use crate::kernels::{Grid, Recording, indirect_grid};
use crate::ops::IndirectGrid;
use crate::tensor::Tensor;

/// The count to bind: the given one, or a constant that says that every row is in use.
pub(super) fn count_tensor(
    recording: &mut Recording,
    count: Option<TensorId>,
    capacity: usize,
) -> TensorId {
    count.unwrap_or_else(|| {
        // Constants of one name are one: programs of the same weights share them.
        let name = format!("count (all {capacity})");
        recording.constant(name, Tensor::from_fn([1], |_| capacity as u32))
    })
}

/// Workgroups of `size` for `capacity` rows of `items` invocations each: indirect over the rows in
/// use where there is a count.
pub(super) fn row_grid(
    recording: &mut Recording,
    count: Option<TensorId>,
    capacity: usize,
    items: usize,
    size: u32,
) -> Result<Grid> {
    Ok(match count {
        None => Grid::linear(capacity * items, size),
        Some(count) => {
            let items_per_count = u32::try_from(items).map_err(|_| Error::Capacity {
                what: "invocations for one row".into(),
                needed: items as u64,
                available: u64::from(u32::MAX),
            })?;
            let op = IndirectGrid { capacity, items_per_count, workgroup_size: size, layers: 1 };
            Grid::Indirect(indirect_grid::scratch(&op, recording, count)?)
        }
    })
}
