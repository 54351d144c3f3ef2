//! Non-maximum suppression.

use crate::engine::ops::boxes::row;
use crate::engine::ops::case::{Case, integers, random, random_boxes, random_integers, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, NmsRule};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "nms",
    takes: "boxes [N, 4], scores [N], N at most 1024 on a GPU; optional: order [N], classes u32 [N], count u32 [1]",
    gives: "keep u32 [min(N, max_out)], count u32 [1]",
    params: &[
        Param::optional("iou_threshold", "0.5", Range::Number(0.0, 1.0)),
        Param::optional("max_out", "1024", Range::Whole(1, u32::MAX as u64)),
        Param::optional("min_score", "-inf", Range::Number(f32::NEG_INFINITY, f32::MAX)),
        Param::optional("min_size", "0", Range::Number(0.0, f32::MAX)),
        Param::optional("sorted", "false", Range::Flag),
    ],
    build,
    cases,
};

/// Boxes that the shader's one workgroup can scan.
pub(crate) const MAX_BOXES: usize = 1024;

/// Greedy non-maximum suppression by descending score, or what else `order` says, ties by lower index.
///
/// A box is dropped if its intersection over union with a better box that was kept is above the
/// threshold; equality keeps it, as in `torchvision.ops.nms`. The comparison is defined in f32
/// without a division ([`reference::iou_above`]), so that indices are equal on every device.
///
/// Inputs: `boxes` f32 `[N, 4]`, `scores` f32 `[N]`, `order` f32 `[N]` if `order`, `classes` u32 `[N]` if
/// `classes`, `count` u32 `[1]` if `count`: only boxes below it take part. Outputs: `keep` u32 `[min(N, max_out)]`, indices
/// into the inputs, and `count` u32 `[1]`, which is how many of them are written.
#[derive(Clone, Copy, Debug)]
pub struct Nms {
    /// A box with more intersection over union than this with a better one is dropped.
    pub iou_threshold: f32,
    /// Largest number of boxes kept: the best.
    pub max_out: usize,
    /// Only boxes with a score above this take part; −∞ lets in every number.
    pub min_score: f32,
    /// Only boxes at least this wide and high take part (torchvision's `remove_small_boxes`); 0
    /// lets in all but inverted boxes.
    pub min_size: f32,
    /// Whether the scores descend already, so that no sort is needed.
    pub sorted: bool,
    /// Whether the boxes are ordered by something else than their scores, the best highest, such as the
    /// scores' logits: scores close to 1 are equal in f32 where those differ. Not where they are `sorted`.
    pub order: bool,
    /// Whether there are classes; boxes of different classes do not suppress each other.
    pub classes: bool,
    /// Whether a count limits the boxes.
    pub count: bool,
}

impl Default for Nms {
    fn default() -> Self {
        Self {
            iou_threshold: 0.5,
            max_out: MAX_BOXES,
            min_score: f32::NEG_INFINITY,
            min_size: 0.0,
            sorted: false,
            order: false,
            classes: false,
            count: false,
        }
    }
}

impl Nms {
    /// The optional inputs: what orders the boxes, classes and count.
    pub(crate) fn optional<'a, T>(&self, inputs: &'a [T]) -> [Option<&'a T>; 3] {
        let mut rest = inputs[2..].iter();
        [self.order, self.classes, self.count].map(|there| there.then(|| rest.next()).flatten())
    }
}

impl Op for Nms {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("iou_threshold", self.iou_threshold.into()),
            ("max_out", self.max_out.into()),
            ("min_score", self.min_score.into()),
            ("min_size", self.min_size.into()),
            ("sorted", self.sorted.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["boxes", "scores"];
        names.extend(self.order.then_some("order"));
        names.extend(self.classes.then_some("classes"));
        names.extend(self.count.then_some("count"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["keep", "count"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [n, sides] = dims(name, "boxes", &inputs[0], DType::F32)?;
        if sides != 4 || n == 0 {
            let expected = "f32 [N, 4] with N above 0";
            return Err(Error::tensor(name, "boxes", expected, &inputs[0]));
        }
        expect(name, "scores", &TensorSpec::f32([n]), &inputs[1])?;
        if self.order && self.sorted {
            return Err(Error::param(name, "sorted", "false with an order", self.sorted));
        }
        let [order, classes, count] = self.optional(inputs);
        if let Some(order) = order {
            expect(name, "order", &TensorSpec::f32([n]), order)?;
        }
        if let Some(classes) = classes {
            expect(name, "classes", &TensorSpec::u32([n]), classes)?;
        }
        expect_count(name, count)?;
        Ok(vec![TensorSpec::u32([n.min(self.max_out)]), TensorSpec::u32([1])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (boxes, scores) = (inputs[0].f32()?, inputs[1].f32()?);
        let [order, classes, count] = self.optional(inputs);
        let n = live(count.copied(), scores.data().len())?;
        let boxes: Vec<_> = (0..n).map(|i| row(boxes.data(), i)).collect();
        let classes = classes.map(|c| c.u32()).transpose()?.map(|c| &c.data()[..n]);
        let rule = NmsRule {
            iou_threshold: self.iou_threshold,
            min_score: self.min_score,
            min_size: self.min_size,
        };
        let scores = &scores.data()[..n];
        let order = match (self.sorted, order) {
            (true, _) => (0..n as u32).collect(),
            (false, Some(order)) => reference::top_k(&order.f32()?.data()[..n], n),
            (false, None) => reference::top_k(scores, n),
        };
        let mut keep = reference::nms(&boxes, scores, classes, rule, &order, self.max_out);
        let count = keep.len() as u32;
        keep.resize(specs[0].shape.elements(), 0);
        Ok(vec![
            Tensor::new(specs[0].shape.clone(), keep)?.into(),
            Tensor::from_fn([1], |_| count).into(),
        ])
    }

    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact; 2])
    }

    fn defined(&self, reference: &[&Value], _inputs: &[&Value]) -> Vec<usize> {
        vec![live(Some(reference[1]), usize::MAX).unwrap_or(0), 1]
    }
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    let default = Nms::default();
    Ok(Box::new(Nms {
        iou_threshold: params.take("iou_threshold", default.iou_threshold)?,
        max_out: params.take("max_out", default.max_out)?,
        min_score: params.take("min_score", default.min_score)?,
        min_size: params.take("min_size", default.min_size)?,
        sorted: params.take("sorted", false)?,
        order: present.contains(&"order"),
        classes: present.contains(&"classes"),
        count: present.contains(&"count"),
    }))
}

fn cases() -> Vec<Case> {
    let half = Nms::default();
    // Boxes 0 and 1 share 10·5 of 150, 1/3; 0 and 2 share 10·8 of 100, 0.8; 3 is apart.
    let four = || {
        values(
            [4, 4],
            &[
                0.0, 0.0, 10.0, 10.0, 0.0, 5.0, 10.0, 15.0, 0.0, 0.0, 10.0, 8.0, 50.0, 50.0, 60.0,
                51.0,
            ],
        )
    };
    let four_scores = || values([4], &[0.5, 0.9, 0.6, 0.7]);
    // 3·4 of 4·4 + 3·4 − 12 = 16: exactly 3/4. 8·8 and its half: exactly 1/2. Twelve apart.
    let equal = || {
        values(
            [4, 4],
            &[
                0.0, 0.0, 4.0, 4.0, 0.0, 0.0, 3.0, 4.0, 20.0, 20.0, 28.0, 28.0, 20.0, 24.0, 28.0,
                28.0,
            ],
        )
    };
    let by_hand = |name: &str, op: Nms, inputs: Vec<Value>, keep: &[u32], count: u32| {
        let keep = integers([keep.len()], keep);
        Case::new(name, op, inputs).by_hand(vec![keep, integers([1], &[count])])
    };
    let ranks = |n: usize| -> Value { Tensor::from_fn([n], |i| -(i as f32)).into() };
    let mut cases = vec![
        by_hand("by hand", half, vec![four(), four_scores()], &[1, 3, 2, 0], 3),
        by_hand(
            "classes by hand",
            Nms { classes: true, ..half },
            vec![four(), four_scores(), integers([4], &[1, 2, 2, 1])],
            &[1, 3, 2, 0],
            4,
        ),
        // Scores that are equal in f32, of boxes in the order 2, 3, 0, 1: of 0 and 2, which share 0.8, the
        // second stays. By the scores alone it would be the first.
        by_hand(
            "equal scores in another order by hand",
            Nms { order: true, min_score: 0.5, ..half },
            vec![four(), values([4], &[1.0; 4]), values([4], &[20.0, 19.5, 21.0, 20.5])],
            &[2, 3, 1, 0],
            3,
        ),
        // The order says who is better, not who takes part.
        by_hand(
            "an order against the scores by hand",
            Nms { order: true, min_score: 0.5, classes: true, count: true, ..half },
            vec![
                four(),
                four_scores(),
                values([4], &[4.0, 3.0, 2.0, 1.0]),
                integers([4], &[1, 1, 2, 2]),
                integers([1], &[4]),
            ],
            &[1, 2, 3, 0],
            3,
        ),
        by_hand(
            "score, size and count by hand",
            Nms { min_score: 0.6, min_size: 2.0, count: true, ..half },
            vec![four(), four_scores(), integers([1], &[4])],
            &[1, 0, 0, 0],
            1,
        ),
        by_hand(
            "the best two by hand",
            Nms { max_out: 2, ..half },
            vec![four(), four_scores()],
            &[1, 3],
            2,
        ),
        by_hand("at the threshold of 1/2 by hand", half, vec![equal(), ranks(4)], &[0, 2, 3, 0], 3),
        by_hand(
            "at the threshold of 3/4 by hand",
            Nms { iou_threshold: 0.75, ..half },
            vec![equal(), ranks(4)],
            &[0, 1, 2, 3],
            4,
        ),
        by_hand(
            "a hair below 3/4 by hand",
            Nms { iou_threshold: 0.749_999_94, ..half },
            vec![equal(), ranks(4)],
            &[0, 2, 3, 0],
            3,
        ),
        by_hand(
            "nothing counted by hand",
            Nms { count: true, ..half },
            vec![four(), four_scores(), integers([1], &[0])],
            &[0; 4],
            0,
        ),
        // A box of no area has no union with itself: 0 > 0 does not hold. An inverted one is out.
        by_hand(
            "degenerate by hand",
            half,
            vec![
                values([3, 4], &[1.0, 1.0, 1.0, 5.0, 1.0, 1.0, 1.0, 5.0, 9.0, 9.0, 3.0, 3.0]),
                values([3], &[0.25, 0.5, 0.75]),
            ],
            &[1, 0, 0],
            2,
        ),
        // 2 × 5 and 5 × 2 are just large enough, 1.5 × 5 and 5 × 1.5 are not.
        by_hand(
            "least width and height by hand",
            Nms { min_size: 2.0, ..half },
            vec![
                values(
                    [4, 4],
                    &[
                        0.0, 0.0, 2.0, 5.0, 10.0, 0.0, 15.0, 2.0, 20.0, 0.0, 21.5, 5.0, 30.0, 0.0,
                        35.0, 1.5,
                    ],
                ),
                ranks(4),
            ],
            &[0, 1, 0, 0],
            2,
        ),
        // Far from the origin. Neighbours share 7 of 13, the ends 4 of 16: a box that is dropped drops no
        // other.
        by_hand(
            "a chain by hand",
            half,
            vec![
                values(
                    [3, 4],
                    &[100.0, 50.0, 110.0, 60.0, 100.0, 53.0, 110.0, 63.0, 100.0, 56.0, 110.0, 66.0],
                ),
                ranks(3),
            ],
            &[0, 2, 0],
            2,
        ),
        // The first two share 7 · 9 of 200 − 63, less than half; the small ones lie apart.
        by_hand(
            "shifted both ways, and apart, by hand",
            half,
            vec![
                values(
                    [4, 4],
                    &[
                        3.0, 0.0, 13.0, 10.0, 0.0, 1.0, 10.0, 11.0, 20.0, 30.0, 20.5, 30.5, 21.0,
                        31.0, 21.5, 31.5,
                    ],
                ),
                ranks(4),
            ],
            &[0, 1, 2, 3],
            4,
        ),
        // NaN is above no score. Of two equal boxes with equal scores the first stays.
        by_hand(
            "a NaN and a tie by hand",
            half,
            vec![
                values(
                    [3, 4],
                    &[50.0, 50.0, 60.0, 60.0, 0.0, 0.0, 10.0, 10.0, 0.0, 0.0, 10.0, 10.0],
                ),
                values([3], &[f32::NAN, 0.5, 0.5]),
            ],
            &[1, 0, 0],
            1,
        ),
        Case::new("one", half, vec![random_boxes(1, 1, 9.0, 9.0).into(), ranks(1)]),
    ];
    cases.extend(stiff());
    // (name, boxes, extent, side, op)
    let third = Nms { iou_threshold: 0.3, ..half };
    let sets = [
        ("31 boxes", 31, 40.0, 20.0, third),
        ("33 boxes", 33, 40.0, 20.0, third),
        ("997 boxes", 997, 320.0, 100.0, half),
        ("1000 crowded boxes", 1000, 60.0, 40.0, Nms { iou_threshold: 0.7, ..half }),
        ("1024 boxes, the best 100", 1024, 320.0, 60.0, Nms { max_out: 100, ..third }),
        ("sorted", 1000, 320.0, 80.0, Nms { sorted: true, ..third }),
        ("counted, of three classes", 500, 100.0, 50.0, Nms { count: true, classes: true, ..half }),
        ("in another order", 601, 100.0, 50.0, Nms { order: true, classes: true, ..half }),
        ("sorted and counted", 700, 99.0, 50.0, Nms { sorted: true, count: true, ..half }),
        ("small ones out", 509, 90.0, 40.0, Nms { min_size: 16.0, min_score: -0.5, ..half }),
    ];
    for (seed, (name, n, extent, side, op)) in sets.into_iter().enumerate() {
        let seed = seed as u64 * 10 + 100;
        let scores = if op.sorted { ranks(n) } else { random(seed + 1, [n]).into() };
        let mut inputs = vec![random_boxes(seed, n, extent, side).into(), scores];
        inputs.extend(op.order.then(|| random(seed + 3, [n]).into()));
        inputs.extend(op.classes.then(|| random_integers(seed + 2, [n], 3)));
        inputs.extend(op.count.then(|| integers([1], &[331])));
        cases.push(Case::new(name, op, inputs));
    }
    // Whole coordinates and few scores: many pairs exactly at the threshold, many ties.
    for (seed, iou_threshold) in [(200, 0.5), (210, 0.25), (220, 0.6)] {
        let mut boxes = random_boxes(seed, 1000, 24.0, 8.0);
        boxes.data_mut().iter_mut().for_each(|x| *x = x.round());
        let mut scores = random(seed + 1, [1000]);
        scores.data_mut().iter_mut().for_each(|x| *x = (*x * 16.0).round());
        let op = Nms { iou_threshold, ..half };
        let name = format!("whole pixels at {iou_threshold}");
        cases.push(Case::new(name, op, vec![boxes.into(), scores.into()]));
    }
    let proposals =
        Nms { iou_threshold: 0.7, max_out: 100, min_size: 1e-3, sorted: true, count: true, ..half };
    let inputs =
        vec![random_boxes(1000, 1000, 320.0, 120.0).into(), ranks(1000), integers([1], &[1000])];
    cases.push(Case::new("the proposals", proposals, inputs).in_network());
    let detections =
        Nms { max_out: 100, min_score: 0.05, order: true, classes: true, count: true, ..half };
    let inputs = vec![
        random_boxes(1010, 200, 320.0, 120.0).into(),
        random(1011, [200]).into(),
        random(1013, [200]).into(),
        random_integers(1012, [200], 2),
        integers([1], &[200]),
    ];
    cases.push(Case::new("the detections", detections, inputs).in_network());
    cases
}

/// As many boxes as there may be, all alike in one way or another.
fn stiff() -> Vec<Case> {
    const N: usize = 1000;
    let half = Nms::default();
    let boxes = |of: &dyn Fn(usize) -> [f32; 4]| -> Value {
        Tensor::from_fn([N, 4], |i| of(i / 4)[i % 4]).into()
    };
    let falling = || -> Value { Tensor::from_fn([N], |i| -(i as f32)).into() };
    let equal = || -> Value { Tensor::from_fn([N], |_| 0.5).into() };
    let case = |name: &str, op: Nms, boxes: Value, scores: Value, keep: &[u32]| {
        let mut all = keep.to_vec();
        all.resize(N, 0);
        Case::new(name, op, vec![boxes, scores])
            .by_hand(vec![integers([N], &all), integers([1], &[keep.len() as u32])])
    };
    let every_second: Vec<u32> = (0..N as u32).step_by(2).collect();
    let all: Vec<u32> = (0..N as u32).collect();
    let from_behind: Vec<u32> = all.iter().rev().copied().collect();
    // 10 × 10 in a row, so many pixels apart.
    let row = |step: f32| move |i: usize| [step * i as f32, 0.0, step * i as f32 + 10.0, 10.0];
    vec![
        case(
            "1000 identical boxes by hand",
            half,
            boxes(&|_| [1.0, 2.0, 9.0, 8.0]),
            falling(),
            &[0],
        ),
        case(
            "1000 identical boxes with one score, by hand",
            half,
            boxes(&|_| [1.0, 2.0, 9.0, 8.0]),
            equal(),
            &[0],
        ),
        // Neighbours share 7 of 13, the next but one 4 of 16: each that stays drops the next alone.
        case("a chain of 1000 by hand", half, boxes(&row(3.0)), falling(), &every_second),
        // 5 of 15 is exactly the third only where nothing rounds; 6 · 10 of 200 − 60 is 3/7.
        case("1000 just below the threshold by hand", half, boxes(&row(4.0)), falling(), &all),
        case("ties by index, by hand", half, boxes(&row(20.0)), equal(), &all),
        case(
            "the last first, by hand",
            half,
            boxes(&row(20.0)),
            Tensor::from_fn([N], |i| i as f32).into(),
            &from_behind,
        ),
        // The same chain a million pixels away, and in thousandths (powers of two, so that nothing
        // rounds).
        case(
            "a chain at 1e6 by hand",
            half,
            boxes(&|i| row(3.0)(i).map(|x| x + 1_048_576.0)),
            falling(),
            &every_second,
        ),
        case(
            "a chain of boxes of 1e-2 by hand",
            half,
            boxes(&|i| row(3.0)(i).map(|x| x / 1024.0)),
            falling(),
            &every_second,
        ),
        // No comparison with NaN holds, so that such a box has not the least width.
        case(
            "every second box NaN, by hand",
            half,
            boxes(&|i| if i % 2 == 1 { [f32::NAN; 4] } else { row(20.0)(i) }),
            equal(),
            &every_second,
        ),
    ]
}
