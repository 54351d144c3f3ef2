//! Workgroups of an indirect dispatch from a count on the device.

use crate::engine::ops::case::{Case, integers};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, MAX_WORKGROUPS};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "indirect_grid",
    takes: "count u32 [1]",
    gives: "grid u32 [3]",
    params: &[
        Param::required("capacity", "100", Range::Whole(1, u32::MAX as u64)),
        Param::optional("items_per_count", "1", Range::Whole(1, u32::MAX as u64)),
        Param::optional("workgroup_size", "64", Range::Whole(1, 256)),
        Param::optional("layers", "1", Range::Whole(1, MAX_WORKGROUPS as u64)),
    ],
    build,
    cases,
};

/// Workgroups that cover `count · items_per_count` invocations.
///
/// Input: `count` u32 `[1]`. Output: `grid` u32 `[3]`, as an indirect dispatch takes it: x and y
/// folded past 65 535, `[0, 0, layers]` for a count of zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndirectGrid {
    /// Largest count; what lies above it is taken for it.
    pub capacity: usize,
    /// Invocations that one count needs.
    pub items_per_count: u32,
    /// Invocations of a workgroup.
    pub workgroup_size: u32,
    /// Workgroups in z, for every count.
    pub layers: u32,
}

impl Op for IndirectGrid {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("capacity", self.capacity.into()),
            ("items_per_count", self.items_per_count.into()),
            ("workgroup_size", self.workgroup_size.into()),
            ("layers", self.layers.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["grid"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        expect_count(self.name(), Some(&inputs[0]))?;
        let items = (self.capacity as u64).saturating_mul(self.items_per_count.into());
        if items > u64::from(u32::MAX) {
            return Err(Error::Capacity {
                what: format!("invocations of one dispatch for a count of {}", self.capacity),
                needed: items,
                available: u64::from(u32::MAX),
            });
        }
        let groups = items.div_ceil(self.workgroup_size.into());
        let most = u64::from(MAX_WORKGROUPS).pow(2);
        if groups > most {
            let what = format!("workgroups of one dispatch for a count of {}", self.capacity);
            return Err(Error::Capacity { what, needed: groups, available: most });
        }
        Ok(vec![TensorSpec::u32([3])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let count = live(Some(inputs[0]), self.capacity)?;
        let grid =
            reference::indirect_grid(count, self.items_per_count, self.workgroup_size, self.layers);
        Ok(vec![Tensor::from_fn([3], |i| grid[i]).into()])
    }

    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(IndirectGrid {
        capacity: params.require("capacity")?,
        items_per_count: params.take("items_per_count", 1)?,
        workgroup_size: params.take("workgroup_size", 64)?,
        layers: params.take("layers", 1)?,
    }))
}

fn cases() -> Vec<Case> {
    let by_hand = |name: &str, op: IndirectGrid, count: u32, grid: [u32; 3]| {
        Case::new(name, op, vec![integers([1], &[count])]).by_hand(vec![integers([3], &grid)])
    };
    let op = IndirectGrid { capacity: 1000, items_per_count: 1, workgroup_size: 64, layers: 1 };
    let many = IndirectGrid { capacity: 65_536, items_per_count: 65_535, ..op };
    vec![
        by_hand("nothing", op, 0, [0, 0, 1]),
        by_hand("one", op, 1, [1, 1, 1]),
        by_hand("a workgroup less one", op, 63, [1, 1, 1]),
        by_hand("a workgroup", op, 64, [1, 1, 1]),
        by_hand("a workgroup and one", op, 65, [2, 1, 1]),
        by_hand("above the capacity", op, u32::MAX, [16, 1, 1]),
        // 13 · 49 = 637 invocations are 9 workgroups and 61 invocations.
        by_hand("layers", IndirectGrid { items_per_count: 49, layers: 5, ..op }, 13, [10, 1, 5]),
        // 64 · 65 535 invocations fill one row of workgroups exactly; 65 · 65 535 need
        // 66 559 workgroups (65 · 65 535 / 64 = 66 558.98).
        by_hand("one full row", many, 64, [65_535, 1, 1]),
        by_hand("a second row", many, 65, [65_535, 2, 1]),
        // 65 536 · 65 535 = 2³² − 65 536 invocations: 67 107 840 workgroups, 1024 rows.
        by_hand("nearly all of a u32", many, 65_536, [65_535, 1024, 1]),
    ]
}
