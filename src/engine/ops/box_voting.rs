//! Box voting.

use crate::engine::ops::bounds::gamma;
use crate::engine::ops::boxes::row;
use crate::engine::ops::case::{
    Case, integers, one_way, random, random_boxes, random_integers, values,
};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, Voters};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "box_voting",
    takes: "rows [R, M], boxes [N, 4], scores [N], classes u32 [N], keep u32 [K], kept u32 [1], count u32 [1]; \
            N a multiple of R",
    gives: "output [K, M]",
    params: &[Param::optional("iou_threshold", "0.7", Range::Number(0.0, 0.99))],
    build,
    cases,
};

/// The rows of the kept boxes, each moved to a weighted mean of the rows of its class whose boxes
/// overlap with it (box voting: Gidaris and Komodakis 2015, section 4.3).
///
/// A vote weighs score · (IoU − t) / (1 − t), where that is above 0, and the kept box's own its
/// score. Unlike the paper's it begins at 0, so that a box that is just past the threshold t on one
/// device and not on another moves nothing. A box for which no other votes keeps its row, bit by bit.
///
/// Inputs: `rows` f32 `[R, M]`, what is averaged: row j / (N / R) is candidate j's; `boxes` f32
/// `[N, 4]`, `scores` f32 `[N]` and `classes` u32 `[N]`, the candidates; `keep` u32 `[K]`, which of
/// them were kept, where one past the end names the last; `kept` u32 `[1]`, how many; `count` u32
/// `[1]`, candidates in use. Output: `output` f32 `[K, M]`; rows that are not kept are not written.
#[derive(Clone, Copy, Debug)]
pub struct BoxVoting {
    /// Intersection over union above which a candidate votes.
    pub iou_threshold: f32,
}

impl Default for BoxVoting {
    fn default() -> Self {
        Self { iou_threshold: 0.7 }
    }
}

impl Op for BoxVoting {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("iou_threshold", self.iou_threshold.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["rows", "boxes", "scores", "classes", "keep", "kept", "count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [rows, columns] = dims(name, "rows", &inputs[0], DType::F32)?;
        if rows * columns == 0 {
            return Err(Error::tensor(name, "rows", "f32 [R, M] without a zero", &inputs[0]));
        }
        let [n, sides] = dims(name, "boxes", &inputs[1], DType::F32)?;
        if sides != 4 || n == 0 || n % rows != 0 {
            let expected = format!("f32 [N, 4] with N a multiple of {rows}");
            return Err(Error::tensor(name, "boxes", expected, &inputs[1]));
        }
        expect(name, "scores", &TensorSpec::f32([n]), &inputs[2])?;
        expect(name, "classes", &TensorSpec::u32([n]), &inputs[3])?;
        let [kept] = dims(name, "keep", &inputs[4], DType::U32)?;
        expect(name, "kept", &TensorSpec::u32([1]), &inputs[5])?;
        expect_count(name, Some(&inputs[6]))?;
        Ok(vec![TensorSpec::f32([kept, columns])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let vote = Vote::new(inputs)?;
        let row = |j| vote.row(j);
        let rows = vote.keep.iter();
        let rows =
            rows.flat_map(|k| reference::box_voting(vote.voters(), row, *k, self.iou_threshold));
        let mut output: Vec<_> = rows.map(|v| v as f32).collect();
        output.resize(specs[0].shape.elements(), 0.0);
        Ok(vec![Tensor::new(specs[0].shape.clone(), output)?.into()])
    }

    /// Lengths round once, areas three times, the union (of at least half of what it is made from)
    /// comes to 12ε of itself, and with a division of 2.5 ULP an overlap to 20ε. A vote is so off by
    /// δ = 30ε · score / (1 − t), also one that is not counted. The mean shift is a quotient of two
    /// sums of n votes: each vote moves it by δ/W times how far its row is from it; each sum rounds n
    /// times, its terms three times, the quotient five, and the last sum once.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let vote = Vote::new(inputs)?;
        let voters = vote.voters();
        let output = reference[0].f32()?;
        let columns = output.dims()[1];
        let mut bounds = vec![0.0; output.data().len()];
        for ((bounds, voted), k) in
            bounds.chunks_mut(columns).zip(output.data().chunks(columns)).zip(&vote.keep)
        {
            let own = vote.row(*k);
            let mut total = f64::from(voters.scores[*k].max(0.0));
            let mut moved = vec![0.0; columns];
            let mut size = vec![0.0; columns];
            let mut votes = 0;
            for j in 0..voters.boxes.len() {
                let weight = voters.vote(*k, j, self.iou_threshold);
                let off = 30.0 * EPS * f64::from(voters.scores[j].max(0.0))
                    / f64::from(1.0 - self.iou_threshold);
                if j == *k || weight == 0.0 || weight < -off {
                    continue;
                }
                votes += 1;
                total += weight.max(0.0);
                for (c, value) in vote.row(j).iter().enumerate() {
                    let far = f64::from(*value) - f64::from(own[c]);
                    let shift = f64::from(voted[c]) - f64::from(own[c]);
                    moved[c] += off * (far.abs() + shift.abs());
                    size[c] += weight.max(0.0) * (far.abs() + shift.abs());
                }
            }
            for c in 0..columns {
                if votes > 0 {
                    let sums = gamma(votes + 10) * size[c] + 1.001 * moved[c];
                    bounds[c] = sums / total + 2.0 * EPS * f64::from(voted[c].abs());
                }
            }
        }
        Ok(vec![Tolerance::Each(bounds)])
    }

    fn defined(&self, _reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        let columns = inputs[0].spec().shape.0[1];
        vec![Vote::new(inputs).map_or(0, |vote| vote.keep.len() * columns)]
    }
}

/// The inputs as far as they are in use.
struct Vote<'a> {
    rows: &'a [f32],
    columns: usize,
    share: usize,
    boxes: Vec<[f32; 4]>,
    scores: &'a [f32],
    classes: &'a [u32],
    /// The kept among the candidates.
    keep: Vec<usize>,
}

impl<'a> Vote<'a> {
    fn new(inputs: &[&'a Value]) -> Result<Self> {
        let (rows, boxes) = (inputs[0].f32()?, inputs[1].f32()?);
        let n = live(Some(inputs[6]), boxes.dims()[0])?;
        let keep = inputs[4].u32()?.data();
        let kept = if n == 0 { 0 } else { live(Some(inputs[5]), keep.len())? };
        Ok(Self {
            rows: rows.data(),
            columns: rows.dims()[1],
            share: boxes.dims()[0] / rows.dims()[0],
            boxes: (0..n).map(|i| row(boxes.data(), i)).collect(),
            scores: &inputs[2].f32()?.data()[..n],
            classes: &inputs[3].u32()?.data()[..n],
            keep: keep[..kept].iter().map(|k| (*k as usize).min(n - 1)).collect(),
        })
    }

    fn voters(&self) -> Voters<'_> {
        Voters { boxes: &self.boxes, scores: self.scores, classes: self.classes }
    }

    fn row(&self, candidate: usize) -> &'a [f32] {
        &self.rows[candidate / self.share * self.columns..][..self.columns]
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    let default = BoxVoting::default();
    Ok(Box::new(BoxVoting { iou_threshold: params.take("iou_threshold", default.iou_threshold)? }))
}

fn cases() -> Vec<Case> {
    let half = BoxVoting { iou_threshold: 0.5 };
    let one = |n: u32| integers([1], &[n]);
    /// Candidates 10 high from `low` to `high`.
    fn spans(ends: &[(f32, f32)]) -> Value {
        let boxes: Vec<_> = ends.iter().flat_map(|(low, high)| [*low, 0.0, *high, 10.0]).collect();
        values([ends.len(), 4], &boxes)
    }
    // Of the first the second is 3/4: with a score of 1/2 it weighs 1/2 · (3/4 − 1/2) · 2 = 1/4, and
    // the first's own vote 3/4. The third, exactly one half of the first, and the fourth, apart, have
    // no say.
    let four = || spans(&[(0.0, 8.0), (0.0, 6.0), (0.0, 4.0), (20.0, 28.0)]);
    let scores = || values([4], &[0.75, 0.5, 0.25, 0.125]);
    let case = |name: &str, op: BoxVoting, inputs: [Value; 5], kept: u32, count: u32| {
        let [rows, boxes, scores, classes, keep] = inputs;
        let counts = [one(kept), one(count)];
        let inputs = [rows, boxes, scores, classes, keep].into_iter().chain(counts);
        Case::new(name, op, inputs.collect())
    };
    let alike = |n: usize| integers([n], &vec![1; n]);
    let rows = || values([4, 2], &[0.0, 1.0, 4.0, 1.0, 100.0, 100.0, 7.0, -7.0]);
    let mut cases = vec![
        // 0 and 1/4 of the way from 0 to 4, and to 1 that is there already; the last is alone.
        case(
            "by hand",
            half,
            [rows(), four(), scores(), alike(4), integers([3], &[0, 3, 9])],
            2,
            4,
        )
        .by_hand(vec![values([3, 2], &[1.0, 1.0, 7.0, -7.0, 0.0, 0.0])]),
        case(
            "its own boxes by hand",
            half,
            [four(), four(), scores(), alike(4), integers([1], &[0])],
            1,
            4,
        )
        .by_hand(vec![values([1, 4], &[0.0, 0.0, 7.5, 10.0])]),
        // Rows of two candidates each: the second's is the first's own, the third's counts for nothing.
        case(
            "a row for two by hand",
            half,
            [values([2, 1], &[3.0, 50.0]), four(), scores(), alike(4), integers([2], &[0, 2])],
            2,
            4,
        )
        // 4 of 6 is 2/3 for the third: a third of 1/2 from the second, with 1/4 of its own.
        .by_hand(vec![values([2, 1], &[3.0, 50.0 - 47.0 * (1.0 / 6.0) / (5.0 / 12.0)])]),
        case(
            "another class by hand",
            half,
            [rows(), four(), scores(), integers([4], &[1, 2, 1, 1]), integers([1], &[0])],
            1,
            4,
        )
        .by_hand(vec![values([1, 2], &[0.0, 1.0])]),
        case(
            "not counted by hand",
            half,
            [rows(), four(), scores(), alike(4), integers([2], &[0, 3])],
            2,
            1,
        )
        .by_hand(vec![values([2, 2], &[0.0, 1.0, 0.0, 1.0])]),
        // A score below 0 of a box apart, whose vote would be above 0, none, and one that is no number.
        case(
            "no scores by hand",
            half,
            [
                rows(),
                spans(&[(0.0, 8.0), (20.0, 28.0), (0.0, 8.0), (0.0, 8.0)]),
                values([4], &[-1.0, -1.0, f32::NAN, 0.0]),
                alike(4),
                integers([1], &[0]),
            ],
            1,
            4,
        )
        .by_hand(vec![values([1, 2], &[0.0, 1.0])]),
        // Equal boxes with equal scores: the mean of 0, 4, 100 and 7, and of 1, 1, 100 and −7.
        case(
            "four alike by hand",
            BoxVoting::default(),
            [
                rows(),
                spans(&[(1.0, 9.0); 4]),
                values([4], &[0.5; 4]),
                alike(4),
                integers([1], &[2]),
            ],
            1,
            4,
        )
        .by_hand(vec![values([1, 2], &[27.75, 23.75])]),
        // 0 of 0 is no overlap; neither is that with a box that is no number.
        case(
            "no area and no number by hand",
            half,
            [
                rows(),
                values(
                    [4, 4],
                    &[
                        5.0,
                        5.0,
                        5.0,
                        9.0,
                        5.0,
                        5.0,
                        5.0,
                        9.0,
                        f32::NAN,
                        5.0,
                        f32::NAN,
                        9.0,
                        9.0,
                        9.0,
                        3.0,
                        3.0,
                    ],
                ),
                values([4], &[0.5; 4]),
                alike(4),
                integers([4], &[0, 1, 2, 3]),
            ],
            4,
            4,
        )
        .by_hand(vec![rows()]),
        case(
            "nothing counted",
            half,
            [rows(), four(), scores(), alike(4), integers([2], &[0, 1])],
            2,
            0,
        ),
        case("none kept", half, [rows(), four(), scores(), alike(4), integers([2], &[0, 1])], 0, 4),
    ];
    let uniform = |seed: u64, n: usize| {
        let mut scores = random(seed, [n]);
        scores.data_mut().iter_mut().for_each(|s| *s = 0.5 + 0.5 * *s);
        scores
    };
    // Crowded boxes, so that many vote; whole pixels, so that many overlaps are at a threshold.
    for (seed, (name, n, share, columns, kept, round, op)) in [
        ("63 numbers: a workgroup less one", 40, 1, 7, 9, false, half),
        ("65 numbers: a workgroup and one", 40, 2, 13, 5, false, half),
        ("997 crowded boxes", 997, 1, 4, 31, false, BoxVoting::default()),
        ("whole pixels at 1/2", 500, 2, 6, 100, true, half),
        ("whole pixels at 3/4", 500, 2, 6, 100, true, BoxVoting { iou_threshold: 0.75 }),
        ("any overlap", 120, 3, 5, 20, false, BoxVoting { iou_threshold: 0.0 }),
        ("nearly equal boxes", 300, 1, 4, 300, true, BoxVoting { iou_threshold: 0.99 }),
    ]
    .into_iter()
    .enumerate()
    {
        let seed = 10 * (seed as u64 + 1);
        let mut boxes = random_boxes(seed, n, 24.0, 20.0);
        if round {
            boxes.data_mut().iter_mut().for_each(|x| *x = x.round());
        }
        let inputs = [
            random(seed + 1, [n / share, columns]).into(),
            boxes.into(),
            uniform(seed + 2, n).into(),
            random_integers(seed + 3, [n], 2),
            random_integers(seed + 4, [kept], n as u32),
        ];
        cases.push(case(name, op, inputs, kept as u32, n as u32));
    }
    // A row of boxes 100 wide, a pixel apart: at a million pixels, and in thousandths; rows of every size.
    for (name, scale, offset, size) in [
        ("at 1e6", 1.0, 1_048_576.0, 1.0),
        ("boxes of 1e-2", 1.0 / 8192.0, 0.0, 1.0),
        ("rows of 1e30", 1.0, 0.0, 1e30),
        ("rows of 1e-30", 1.0, 0.0, 1e-30),
    ] {
        let side = |i: usize, s: usize| offset + [i, 0, i + 100, 100][s] as f32 * scale;
        let mut rows = random(200, [60, 4]);
        rows.data_mut().iter_mut().for_each(|v| *v *= size);
        let inputs = [
            rows.into(),
            Tensor::from_fn([60, 4], |i| side(i / 4, i % 4)).into(),
            uniform(201, 60).into(),
            alike(60),
            Tensor::from_fn([60], |i| i as u32).into(),
        ];
        cases.push(case(name, BoxVoting::default(), inputs, 60, 60));
    }
    let network = |name: &str, seed: u64, share: usize, columns: usize| {
        let inputs = [
            one_way(seed, [200 / share, columns]).into(),
            random_boxes(seed + 1, 200, 120.0, 100.0).into(),
            uniform(seed + 2, 200).into(),
            random_integers(seed + 3, [200], 3),
            random_integers(seed + 4, [100], 200),
        ];
        case(name, BoxVoting::default(), inputs, 100, 200).in_network()
    };
    cases.push(network("the detections' boxes", 1000, 1, 4));
    cases.push(network("their poses", 1010, 2, 6));
    cases
}
