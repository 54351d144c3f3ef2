//! Values that are no finite number.

use crate::engine::ops::case::{Case, integers, random, random_scaled, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, Shape, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "not_finite",
    takes: "values0 [N, …]; optional: values1 to values15 of any shape, count u32 [1]",
    gives: "output u32 [Σ ⌈elements / 4096⌉]",
    params: &[Param::by_tensors("values", Range::Whole(1, VALUES.len() as u64))],
    build,
    cases,
};

/// Elements of a chunk.
pub(crate) const CHUNK: usize = 4096;

/// Names of the inputs.
const VALUES: [&str; 16] = [
    "values0", "values1", "values2", "values3", "values4", "values5", "values6", "values7",
    "values8", "values9", "values10", "values11", "values12", "values13", "values14", "values15",
];

/// Chunks of a tensor.
pub(crate) fn chunks(values: &TensorSpec) -> usize {
    values.shape.elements().div_ceil(CHUNK)
}

/// How many values of each chunk of 4096 in a row are infinite or NaN, of one tensor after the other.
///
/// Inputs: `values0 [N, …]`, `values1`, …, of any shapes, none empty; `count u32[1]`, if [`NotFinite::count`], how
/// many rows of each are in use: the others do not count. Output: `output u32[Σ ⌈elements / 4096⌉]`.
#[derive(Clone, Copy, Debug)]
pub struct NotFinite {
    /// How many tensors, 1 to 16.
    pub values: usize,
    /// Whether there is a count.
    pub count: bool,
}

impl Default for NotFinite {
    fn default() -> Self {
        Self { values: 1, count: false }
    }
}

impl Op for NotFinite {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("values", self.values.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        VALUES.into_iter().take(self.values).chain(self.count.then_some("count")).collect()
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        for (name, values) in VALUES.iter().zip(&inputs[..self.values]) {
            let elements = values.shape.elements();
            if values.dtype != DType::F32 || values.shape.rank() == 0 || elements == 0 {
                let expected = "f32 [N, …] without a zero";
                return Err(Error::tensor(self.name(), name, expected, values));
            }
        }
        expect_count(self.name(), inputs.get(self.values))?;
        Ok(vec![TensorSpec::u32([inputs[..self.values].iter().map(chunks).sum()])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let mut counts = Vec::new();
        for values in &inputs[..self.values] {
            let end = counts.len() + chunks(&values.spec());
            let values = values.f32()?;
            let rows = values.dims()[0];
            let in_use =
                live(inputs.get(self.values).copied(), rows)? * (values.data().len() / rows);
            counts.extend(reference::not_finite(&values.data()[..in_use], CHUNK));
            counts.resize(end, 0);
        }
        Ok(vec![Tensor::new(specs[0].shape.clone(), counts)?.into()])
    }

    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }
}

fn build(_params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    let values = VALUES.iter().filter(|name| present.contains(name)).count();
    Ok(Box::new(NotFinite { values, count: present.contains(&"count") }))
}

fn cases() -> Vec<Case> {
    const ALL: NotFinite = NotFinite { values: 1, count: false };
    const COUNTED: NotFinite = NotFinite { values: 1, count: true };
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    // The largest number, the smallest, zeros; NaNs of all kinds but signalling ones, which some
    // processors make quiet.
    let kinds = [f32::MAX, f32::MIN, 1e-45, -0.0, 0.0, nan, -nan, inf, -inf];
    let counted = |count: u32| {
        let rows = values([3, 2], &[1.0, nan, inf, 2.0, -inf, nan]);
        vec![rows, integers([1], &[count])]
    };
    // At the ends of chunks, and of what a workgroup's invocations see first and last.
    let marked = |elements: usize, places: &[usize]| -> Value {
        let mark = |i: usize| if places.contains(&i) { nan } else { i as f32 };
        Tensor::from_fn([elements], mark).into()
    };
    let mut cases = vec![
        Case::new("each kind of number by hand", ALL, vec![values([9], &kinds)])
            .by_hand(vec![integers([1], &[4])]),
        Case::new("one number by hand", ALL, vec![values([1], &[1.0])])
            .by_hand(vec![integers([1], &[0])]),
        Case::new("two rows of three by hand", COUNTED, counted(2))
            .by_hand(vec![integers([1], &[2])]),
        Case::new("no row by hand", COUNTED, counted(0)).by_hand(vec![integers([1], &[0])]),
        Case::new("more rows than there are by hand", COUNTED, counted(u32::MAX))
            .by_hand(vec![integers([1], &[4])]),
        Case::new(
            "the ends of chunks by hand",
            ALL,
            vec![marked(9000, &[0, 255, 256, 4095, 4096, 8191, 8192, 8999])],
        )
        .by_hand(vec![integers([3], &[4, 2, 2])]),
        Case::new("a whole chunk by hand", ALL, vec![marked(4096, &[4095])])
            .by_hand(vec![integers([1], &[1])]),
        // Rows of 3000: the second chunk ends within what is in use, the third has nothing.
        Case::new(
            "rows across chunks by hand",
            COUNTED,
            vec![
                Tensor::from_fn([3, 3000], |i| if i % 1000 == 999 { inf } else { 0.0 }).into(),
                integers([1], &[2]),
            ],
        )
        .by_hand(vec![integers([3], &[4, 2, 0])]),
        // More than one dispatch sees: tensor k has k + 1 values, and one chunk more after the sixth.
        Case::new("sixteen tensors by hand", NotFinite { values: 16, count: false }, {
            let of = |k: usize| {
                let elements = if k == 6 { CHUNK + 1 } else { k + 1 };
                Tensor::from_fn([elements], |_| if k == 3 { 0.0 } else { inf }).into()
            };
            (0..16).map(of).collect()
        })
        .by_hand(vec![integers(
            [17],
            &[1, 2, 3, 0, 5, 6, 4096, 1, 8, 9, 10, 11, 12, 13, 14, 15, 16],
        )]),
        Case::new("rows of two tensors by hand", NotFinite { values: 2, count: true }, {
            let first = values([3], &[nan, 1.0, nan]);
            vec![first, values([2, 2], &[inf, nan, 0.0, inf]), integers([1], &[2])]
        })
        .by_hand(vec![integers([2], &[1, 3])]),
        Case::new("nothing but NaN", ALL, vec![values([4097], &[nan; 4097])])
            .by_hand(vec![integers([2], &[4096, 1])]),
    ];
    // What the network looks at: class and box of each anchor, what the stages pool, the weights of the
    // scales, and of each proposal the probabilities, the deltas and the pose. In half precision 10⁶ is infinite.
    let mut look = |name: &str, shapes: &[&[usize]], count: Option<u32>| {
        let tensor = |(seed, shape): (usize, &&[usize])| -> Value {
            random_scaled(1000 + seed as u64, Shape(shape.to_vec()), 1e6)
        };
        let tensors = shapes.iter().enumerate().map(tensor);
        let inputs = tensors.chain(count.map(|count| integers([1], &[count]))).collect();
        let op = NotFinite { values: shapes.len(), count: count.is_some() };
        cases.push(Case::new(name, op, inputs).in_network());
    };
    let pooled =
        |channels: &[usize]| -> Vec<[usize; 2]> { channels.iter().map(|c| [2, *c]).collect() };
    for (name, channels, scales) in [
        ("maps", &[64, 64, 128, 256, 512, 256, 256, 256][..], 3),
        ("maps without the deepest", &[64, 64, 128, 256, 256, 256], 2),
    ] {
        let pooled = pooled(channels);
        let pooled = pooled.iter().map(|shape| &shape[..]);
        let more: [&[usize]; 3] = [&[scales], &[20, 40, 40], &[80, 40, 40]];
        look(name, &pooled.chain(more).collect::<Vec<_>>(), None);
    }
    look("numbers of each proposal", &[&[100, 3], &[100, 12], &[100, 6]], Some(100));
    cases.push(Case::new("numbers alone", ALL, vec![random(5, [7, 31, 37]).into()]));
    cases
}
