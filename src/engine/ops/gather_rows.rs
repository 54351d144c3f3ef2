//! Rows of a tensor by index.

use crate::engine::ops::case::{Case, integers, one_way, random, random_integers, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance, dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, Shape, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "gather_rows",
    takes: "rows [N] or [N, M], indices u32 [K], count u32 [1]",
    gives: "output [K] or [K, M]",
    params: &[],
    build,
    cases,
};

/// `output[i] = rows[indices[i]]` for each i below the count; the others are not written.
///
/// Inputs: `rows` f32 or u32, `[N]` or `[N, M]`; `indices` u32 `[K]`, where one past the end names
/// the last row; `count` u32 `[1]`. Output: `output` `[K]` or `[K, M]` of the rows' type, bit by bit.
#[derive(Clone, Copy, Debug, Default)]
pub struct GatherRows {}

/// Rows and columns of `[N]` or `[N, M]`.
pub(crate) fn layout(dims: &[usize]) -> Option<(usize, usize)> {
    match dims {
        [n] => Some((*n, 1)),
        [n, m] => Some((*n, *m)),
        _ => None,
    }
    .filter(|(n, m)| n * m > 0)
}

impl Op for GatherRows {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["rows", "indices", "count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let rows = &inputs[0];
        if layout(&rows.shape.0).is_none() {
            let expected = "[N] or [N, M] without a zero";
            return Err(Error::tensor(self.name(), "rows", expected, rows));
        }
        let [k] = dims(self.name(), "indices", &inputs[1], DType::U32)?;
        expect_count(self.name(), Some(&inputs[2]))?;
        let mut shape = rows.shape.clone();
        shape.0[0] = k;
        Ok(vec![TensorSpec { shape, dtype: rows.dtype }])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (_, columns) = layout(&inputs[0].spec().shape.0).unwrap_or((1, 1));
        let indices = inputs[1].u32()?.data();
        let indices = &indices[..live(Some(inputs[2]), indices.len())?];
        fn padded<T: Copy + Default>(shape: &Shape, mut rows: Vec<T>) -> Result<Tensor<T>> {
            rows.resize(shape.elements(), T::default());
            Tensor::new(shape.clone(), rows)
        }
        let shape = &specs[0].shape;
        Ok(vec![match inputs[0] {
            Value::F32(t) => {
                padded(shape, reference::gather_rows(t.data(), columns, indices))?.into()
            }
            Value::U32(t) => {
                padded(shape, reference::gather_rows(t.data(), columns, indices))?.into()
            }
        }])
    }

    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }

    fn defined(&self, _reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        let (_, columns) = layout(&inputs[0].spec().shape.0).unwrap_or((1, 1));
        let capacity = inputs[1].spec().shape.elements();
        vec![live(Some(inputs[2]), capacity).unwrap_or(0) * columns]
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(GatherRows {}))
}

fn cases() -> Vec<Case> {
    let op = GatherRows {};
    let count = |n: u32| integers([1], &[n]);
    let three = || values([3, 2], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let bits = [f32::NAN, -0.0, f32::INFINITY, 1e-45];
    let mut cases = vec![
        Case::new("by hand", op, vec![three(), integers([4], &[2, 0, 2, 1]), count(3)])
            .by_hand(vec![values([4, 2], &[5.0, 6.0, 1.0, 2.0, 5.0, 6.0, 0.0, 0.0])]),
        Case::new(
            "integers by hand",
            op,
            vec![integers([3], &[7, u32::MAX, 9]), integers([2], &[1, 0]), count(9)],
        )
        .by_hand(vec![integers([2], &[u32::MAX, 7])]),
        Case::new(
            "an index past the end by hand",
            op,
            vec![three(), integers([2], &[3, u32::MAX]), count(2)],
        )
        .by_hand(vec![values([2, 2], &[5.0, 6.0, 5.0, 6.0])]),
        Case::new(
            "bits by hand",
            op,
            vec![values([4], &bits), integers([3], &[1, 3, 0]), count(3)],
        )
        .by_hand(vec![values([3], &[-0.0, 1e-45, f32::NAN])]),
        Case::new("nothing counted", op, vec![three(), integers([2], &[1, 2]), count(0)]),
        Case::new("one", op, vec![values([1], &[4.0]), integers([1], &[0]), count(1)]),
        Case::new(
            "63 elements: a workgroup less one",
            op,
            vec![random(1, [97, 7]).into(), random_integers(2, [9], 97), count(9)],
        ),
        Case::new(
            "65 elements: a workgroup and one",
            op,
            vec![random(3, [97, 13]).into(), random_integers(4, [5], 97), count(5)],
        ),
        Case::new(
            "whole workgroups to the last",
            op,
            vec![random(9, [97, 64]).into(), random_integers(10, [70], 97), count(70)],
        ),
        Case::new(
            "wide rows",
            op,
            vec![random(5, [31, 12_547]).into(), random_integers(6, [23], 31), count(19)],
        ),
        Case::new(
            "4.2 million elements: past 65 535 workgroups",
            op,
            vec![random(7, [5, 4099]).into(), random_integers(8, [1031], 5), count(1030)],
        ),
    ];
    let indices = |n: u32| random_integers(1010, [100], n);
    let ways: Vec<(&str, Value, u32)> = vec![
        ("candidates' boxes", one_way(1000, [1000, 4]).into(), 1000),
        ("candidates' scores", one_way(1001, [1000]).into(), 1000),
        ("detections' boxes", one_way(1002, [200, 4]).into(), 200),
        ("detections' scores", one_way(1003, [200]).into(), 200),
        ("detections' classes", random_integers(1004, [200], 3), 200),
    ];
    for (name, rows, n) in ways {
        cases.push(Case::new(name, op, vec![rows, indices(n), count(100)]).in_network());
    }
    cases
}
