//! Values that are no finite number.

use crate::engine::ops::case::{Case, integers, random, random_scaled, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "not_finite",
    takes: "values [N, …]; optional: count u32 [1]",
    gives: "output u32 [⌈elements / 4096⌉]",
    params: &[],
    build,
    cases,
};

/// Elements of a chunk.
pub(crate) const CHUNK: usize = 4096;

/// How many values of each chunk of 4096 in a row are infinite or NaN.
///
/// Inputs: `values [N, …]`, at least one; `count u32[1]`, if [`NotFinite::count`], how many of the N
/// rows are in use: the others do not count. Output: `output u32[⌈elements / 4096⌉]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct NotFinite {
    /// Whether there is a count.
    pub count: bool,
}

impl Op for NotFinite {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        ["values"].into_iter().chain(self.count.then_some("count")).collect()
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let (values, elements) = (&inputs[0], inputs[0].shape.elements());
        if values.dtype != DType::F32 || values.shape.rank() == 0 || elements == 0 {
            let expected = "f32 [N, …] without a zero";
            return Err(Error::tensor(self.name(), "values", expected, values));
        }
        expect_count(self.name(), inputs.get(1))?;
        Ok(vec![TensorSpec::u32([elements.div_ceil(CHUNK)])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let values = inputs[0].f32()?;
        let rows = values.dims()[0];
        let in_use = live(inputs.get(1).copied(), rows)? * (values.data().len() / rows);
        let mut counts = reference::not_finite(&values.data()[..in_use], CHUNK);
        counts.resize(specs[0].shape.elements(), 0);
        Ok(vec![Tensor::new(specs[0].shape.clone(), counts)?.into()])
    }

    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }
}

fn build(_params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(NotFinite { count: present.contains(&"count") }))
}

fn cases() -> Vec<Case> {
    const ALL: NotFinite = NotFinite { count: false };
    const COUNTED: NotFinite = NotFinite { count: true };
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
        Case::new("nothing but NaN", ALL, vec![values([4097], &[nan; 4097])])
            .by_hand(vec![integers([2], &[4096, 1])]),
    ];
    // What the network looks at: class and box of each anchor, what the stages pool, the weights of the
    // scales, and of each proposal the probabilities, the deltas and the pose. In half precision 10⁶ is infinite.
    for (seed, dims) in [(1000, [20, 40, 40]), (1001, [80, 40, 40])] {
        let name = format!("{} channels of the proposals", dims[0]);
        cases.push(Case::new(name, ALL, vec![random_scaled(seed, dims, 1e6)]).in_network());
    }
    for (seed, channels) in [(1010, 64), (1011, 128), (1012, 256), (1013, 512)] {
        let name = format!("the pooled channels of a stage, {channels}");
        let pooled = random_scaled(seed, [2, channels], 1e6);
        cases.push(Case::new(name, ALL, vec![pooled]).in_network());
    }
    for (name, scales) in [("the scales", 3), ("the scales without the deepest", 2)] {
        let weights = random_scaled(1002, [scales], 1e6);
        cases.push(Case::new(name, ALL, vec![weights]).in_network());
    }
    for (seed, columns) in [(1003, 3), (1004, 12), (1005, 6)] {
        let name = format!("{columns} numbers of each proposal");
        let inputs = vec![random_scaled(seed, [100, columns], 1e6), integers([1], &[100])];
        cases.push(Case::new(name, COUNTED, inputs).in_network());
    }
    cases.push(Case::new("numbers alone", ALL, vec![random(5, [7, 31, 37]).into()]));
    cases
}
