//! The k highest scores and where they are.

use crate::engine::ops::case::{Case, integers, one_way, random, random_integers, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "top_k",
    takes: "scores [N] or [C, H, W]; optional: count u32 [1]",
    gives: "values [K], indices u32 [K], count u32 [1]",
    params: &[Param::required("k", "1000", Range::Whole(1, u32::MAX as u64))],
    build,
    cases,
};

/// The `k` highest scores by descending score, ties by lower index; −0 equals +0, NaN is lowest.
///
/// Inputs: `scores` f32 `[N]`, or `[C, H, W]`, whose elements count in torchvision's order
/// `(H, W, C)`: index = (h · W + w) · C + c; `count` u32 `[1]` if `count`: only indices below it
/// take part. Outputs, with K = min(k, N): `values` f32 `[K]`, `indices` u32 `[K]`, and `count` u32
/// `[1]`, which is how many of the K are written: min(k, N, the input's count).
#[derive(Clone, Copy, Debug)]
pub struct TopK {
    /// How many, or all scores if those are fewer; on a GPU at most 1024.
    pub k: usize,
    /// Whether a count limits the scores.
    pub count: bool,
}

/// Channels and positions of scores of either rank.
pub(crate) fn layout(dims: &[usize]) -> Option<(usize, usize)> {
    match dims {
        [n] => Some((1, *n)),
        [c, h, w] => Some((*c, h * w)),
        _ => None,
    }
    .filter(|(channels, area)| channels * area > 0)
}

impl Op for TopK {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("k", self.k.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["scores"];
        names.extend(self.count.then_some("count"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["values", "indices", "count"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let scores = &inputs[0];
        let fits = layout(&scores.shape.0).filter(|_| scores.dtype == DType::F32);
        let Some((channels, area)) = fits else {
            let expected = "f32 [N] or [C, H, W] without a zero";
            return Err(Error::tensor(self.name(), "scores", expected, scores));
        };
        expect_count(self.name(), inputs.get(1))?;
        let k = self.k.min(channels * area);
        Ok(vec![TensorSpec::f32([k]), TensorSpec::u32([k]), TensorSpec::u32([1])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let scores = inputs[0].f32()?;
        let n = live(inputs.get(1).copied(), scores.data().len())?;
        let (channels, area) = layout(scores.dims()).unwrap_or((1, n));
        let in_order: Vec<f32> =
            (0..n).map(|i| scores.data()[i % channels * area + i / channels]).collect();
        let best = reference::top_k(&in_order, self.k);
        let k = specs[0].shape.clone();
        let index = |i: usize| best.get(i).copied().unwrap_or(0);
        Ok(vec![
            Tensor::from_fn(k.clone(), |i| best.get(i).map_or(0.0, |b| in_order[*b as usize]))
                .into(),
            Tensor::from_fn(k, index).into(),
            Tensor::from_fn([1], |_| best.len() as u32).into(),
        ])
    }

    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact; 3])
    }

    fn defined(&self, reference: &[&Value], _inputs: &[&Value]) -> Vec<usize> {
        let count = live(Some(reference[2]), usize::MAX).unwrap_or(0);
        vec![count, count, 1]
    }
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(TopK { k: params.require("k")?, count: present.contains(&"count") }))
}

fn cases() -> Vec<Case> {
    let all = |k: usize| TopK { k, count: false };
    let counted = |k: usize| TopK { k, count: true };
    let mut cases = vec![
        Case::new("by hand", all(3), vec![values([5], &[0.5, -1.0, 2.0, 0.25, 2.0])]).by_hand(
            vec![values([3], &[2.0, 2.0, 0.5]), integers([3], &[2, 4, 0]), integers([1], &[3])],
        ),
        // Index = (h · 2 + w) · 2 + c: channel 0 holds indices 0, 2, 4, 6.
        Case::new(
            "channels last by hand",
            all(4),
            vec![values([2, 2, 2], &[1.0, 5.0, 3.0, 7.0, 8.0, 4.0, 6.0, 2.0])],
        )
        .by_hand(vec![
            values([4], &[8.0, 7.0, 6.0, 5.0]),
            integers([4], &[1, 6, 5, 2]),
            integers([1], &[4]),
        ]),
        Case::new(
            "only the counted by hand",
            counted(3),
            vec![values([4], &[1.0, 2.0, 9.0, 9.0]), integers([1], &[2])],
        )
        .by_hand(vec![
            values([3], &[2.0, 1.0, 0.0]),
            integers([3], &[1, 0, 0]),
            integers([1], &[2]),
        ]),
        // NaN last, −0 and +0 equal, subnormals and infinities in their places.
        Case::new(
            "extremes by hand",
            all(9),
            vec![values(
                [9],
                &[
                    f32::NAN,
                    -0.0,
                    0.0,
                    f32::NEG_INFINITY,
                    1e-45,
                    f32::INFINITY,
                    f32::MIN,
                    -1e-45,
                    f32::MAX,
                ],
            )],
        )
        .by_hand(vec![
            values(
                [9],
                &[
                    f32::INFINITY,
                    f32::MAX,
                    1e-45,
                    -0.0,
                    0.0,
                    -1e-45,
                    f32::MIN,
                    f32::NEG_INFINITY,
                    f32::NAN,
                ],
            ),
            integers([9], &[5, 8, 4, 1, 2, 7, 6, 3, 0]),
            integers([1], &[9]),
        ]),
        // NaNs of either sign are equal and the lowest, in the order of their places.
        Case::new(
            "NaNs among numbers by hand",
            all(6),
            vec![values([6], &[f32::NAN, 1.0, -f32::NAN, f32::NEG_INFINITY, 2.0, f32::NAN])],
        )
        .by_hand(vec![
            values([6], &[2.0, 1.0, f32::NEG_INFINITY, f32::NAN, -f32::NAN, f32::NAN]),
            integers([6], &[4, 1, 3, 0, 2, 5]),
            integers([1], &[6]),
        ]),
        // Each of the 500 least numbers: place i holds number 7i modulo 500, and one. As 7 · 143 is 1
        // there, number n is in place 143n. A device that flushes them sees them all equal.
        Case::new(
            "subnormal differences by hand",
            all(500),
            vec![Tensor::from_fn([500], |i| f32::from_bits((i as u32 * 7) % 500 + 1)).into()],
        )
        .by_hand(vec![
            Tensor::from_fn([500], |i| f32::from_bits(500 - i as u32)).into(),
            Tensor::from_fn([500], |i| (499 - i as u32) * 143 % 500).into(),
            integers([1], &[500]),
        ]),
        Case::new("one", all(1), vec![values([1], &[-3.0])]),
        Case::new("k above the number", all(1000), vec![random(1, [7]).into()]),
        Case::new("nothing counted", counted(5), vec![random(2, [9]).into(), integers([1], &[0])]),
        Case::new("count above all", counted(5), vec![random(3, [9]).into(), integers([1], &[99])]),
        Case::new("a workgroup less one", all(255), vec![random(4, [255]).into()]),
        Case::new("a workgroup and one", all(257), vec![random(5, [257]).into()]),
        Case::new("all equal", all(1000), vec![Tensor::<f32>::zeros([5003]).into()]),
        Case::new("all NaN", all(5), vec![Tensor::from_fn([11], |_| f32::NAN).into()]),
        Case::new("primes, channels last", all(613), vec![random(6, [7, 31, 29]).into()]),
        Case::new(
            "counted, channels last",
            counted(500),
            vec![random(7, [3, 40, 41]).into(), integers([1], &[1009])],
        ),
        Case::new("k of 1024", all(1024), vec![random(8, [24_000]).into()]),
        Case::new("100 003 scores", all(1000), vec![random(9, [100_003]).into()]),
    ];
    // Few distinct scores: the cut is among ties, in every digit of the index.
    for (seed, n, below) in [(10, 1000, 3), (11, 70_001, 2), (12, 70_001, 60)] {
        if let Value::U32(ranks) = random_integers(seed, [n], below) {
            let scores = Tensor::from_fn([n], |i| ranks.data()[i] as f32 - 1.0);
            cases.push(Case::new(format!("{below} scores, {n}"), all(997), vec![scores.into()]));
        }
    }
    // Ever lower: the radix select goes through all bytes of the key.
    let close = Tensor::from_fn([3001], |i| f32::from_bits(0x3f80_0000 + (i as u32 * 7) % 3001));
    cases.push(Case::new("neighbouring values", all(700), vec![close.into()]));
    // The ten highest come last, and the ties' cut is between two indices that differ in their last
    // byte alone: more of them than room would displace the highest.
    let last = Tensor::from_fn([5003], |i| if i < 4993 { 0.0 } else { 1.0 });
    cases.push(Case::new("ties to the last byte by hand", all(1024), vec![last.into()]).by_hand(
        vec![
            Tensor::from_fn([1024], |i| if i < 10 { 1.0 } else { 0.0 }).into(),
            Tensor::from_fn([1024], |i| if i < 10 { 4993 + i as u32 } else { i as u32 - 10 })
                .into(),
            integers([1], &[1024]),
        ],
    ));
    let scores = one_way(1000, [20, 40, 40]).into();
    cases.push(Case::new("the anchors", all(1000), vec![scores]).in_network());
    cases
}
