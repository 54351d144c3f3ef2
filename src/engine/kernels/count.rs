//! Counts on the device: dispatches over the rows in use.

use crate::engine::graph::TensorId;
use crate::engine::kernels::{Grid, Recording};
use crate::engine::ops::{IndirectGrid, Op};
use crate::engine::reference;
use crate::engine::tensor::Tensor;
use crate::error::{Error, Result};

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

/// Workgroups of `workgroup_size` for `capacity` rows of `items` invocations each, in so many layers; for
/// the rows in use alone where there is a count.
pub(super) fn row_grid(
    recording: &Recording,
    count: Option<TensorId>,
    capacity: usize,
    [items, layers]: [usize; 2],
    workgroup_size: u32,
) -> Result<Grid> {
    let items_per_count = u32::try_from(items).map_err(|_| Error::Capacity {
        what: "invocations for one row".into(),
        needed: items as u64,
        available: u64::from(u32::MAX),
    })?;
    let layers = layers as u32;
    Ok(match count {
        None => Grid::Workgroups(reference::indirect_grid(
            capacity,
            items_per_count,
            workgroup_size,
            layers,
        )),
        Some(count) => {
            let rule = IndirectGrid { capacity, items_per_count, workgroup_size, layers };
            rule.infer(&[recording.info(count).spec.clone()])?;
            Grid::Counted(count, rule)
        }
    })
}
