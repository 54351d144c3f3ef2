//! Detections from the RoI head.

use crate::engine::ops::boxes::{decode_bound, row};
use crate::engine::ops::case::{
    Case, integers, one_way, random, random_boxes, random_scaled, values,
};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, DetectionRule};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "decode_detections",
    takes: "rois [R, 4], deltas [R, 4C], logits [R, C], count u32 [1]",
    gives: "boxes [R(C - 1), 4], scores [R(C - 1)], margins [R(C - 1)], classes u32 [R(C - 1)], count u32 [1]",
    params: &[
        Param::required("width", "320", Range::Whole(1, 65_536)),
        Param::required("height", "320", Range::Whole(1, 65_536)),
        Param::optional("weights", "10,10,5,5", Range::Numbers(1e-3, 1e3)),
        Param::optional("temperature", "1", Range::Number(1e-3, 1e3)),
        Param::optional("class_mask", "4294967295", Range::Whole(0, u32::MAX as u64)),
    ],
    build,
    cases,
};

/// Classes that the mask has bits for.
const MAX_CLASSES: usize = 32;

/// A box and a score for each region and class but the background, by region, then class.
///
/// Inputs: `rois` f32 `[R, 4]`; `deltas` f32 `[R, 4·classes]`, (dx, dy, dw, dh) of each class, the
/// background first; `logits` f32 `[R, classes]`; `count` u32 `[1]`, regions in use. Outputs, with
/// N = R · (classes − 1): `boxes` f32 `[N, 4]`, clipped to the picture; `scores` f32 `[N]`, softmax of
/// logits / temperature, −1 where the class is not wanted; `margins` f32 `[N]`, the scores' logits, by
/// which boxes are to be ordered: scores close to 1 are equal in f32 where these differ; `classes` u32
/// `[N]`; `count` u32 `[1]`, how many of the N are written. The conventions are torchvision's
/// `RoIHeads.postprocess_detections` before its thresholds, and its `BoxCoder`.
#[derive(Clone, Copy, Debug)]
pub struct DecodeDetections {
    /// Width of the picture in pixels, to which boxes are clipped.
    pub width: usize,
    /// Height of the picture in pixels.
    pub height: usize,
    /// What (dx, dy, dw, dh) are divided by; torchvision's (10, 10, 5, 5) by default.
    pub weights: [f32; 4],
    /// What the logits are divided by; 1 by default. A higher one makes the shares more even (Guo et al.,
    /// On Calibration of Modern Neural Networks, 2017).
    pub temperature: f32,
    /// Bit c: class c is wanted; all by default.
    pub class_mask: u32,
}

impl Default for DecodeDetections {
    fn default() -> Self {
        Self {
            width: 320,
            height: 320,
            weights: [10.0, 10.0, 5.0, 5.0],
            temperature: 1.0,
            class_mask: u32::MAX,
        }
    }
}

impl DecodeDetections {
    fn rule(&self, classes: usize) -> DetectionRule {
        DetectionRule {
            extent: [self.width as f32, self.height as f32],
            weights: self.weights,
            temperature: self.temperature,
            class_mask: self.class_mask,
            classes,
        }
    }
}

impl Op for DecodeDetections {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("width", self.width.into()),
            ("height", self.height.into()),
            ("weights", self.weights[..].into()),
            ("temperature", self.temperature.into()),
            ("class_mask", self.class_mask.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["rois", "deltas", "logits", "count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["boxes", "scores", "margins", "classes", "count"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [rois, classes] = dims(name, "logits", &inputs[2], DType::F32)?;
        if rois == 0 || classes < 2 {
            let expected = "f32 [R, classes] with R above 0 and at least 2 classes";
            return Err(Error::tensor(name, "logits", expected, &inputs[2]));
        }
        if classes > MAX_CLASSES {
            return Err(Error::Capacity {
                what: "classes in the class mask".into(),
                needed: classes as u64,
                available: MAX_CLASSES as u64,
            });
        }
        expect(name, "rois", &TensorSpec::f32([rois, 4]), &inputs[0])?;
        expect(name, "deltas", &TensorSpec::f32([rois, 4 * classes]), &inputs[1])?;
        expect_count(name, Some(&inputs[3]))?;
        let n = rois * (classes - 1);
        Ok(vec![
            TensorSpec::f32([n, 4]),
            TensorSpec::f32([n]),
            TensorSpec::f32([n]),
            TensorSpec::u32([n]),
            TensorSpec::u32([1]),
        ])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (rois, deltas, logits) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?);
        let classes = logits.dims()[1];
        let count = live(Some(inputs[3]), rois.dims()[0])?;
        let found: Vec<_> = (0..count)
            .flat_map(|i| {
                let deltas = &deltas.data()[i * 4 * classes..][..4 * classes];
                let logits = &logits.data()[i * classes..][..classes];
                reference::decode_detections(
                    row(rois.data(), i),
                    deltas,
                    logits,
                    self.rule(classes),
                )
            })
            .collect();
        let [boxes, scores, margins, labels] = [0, 1, 2, 3].map(|i| specs[i].shape.clone());
        Ok(vec![
            Tensor::from_fn(boxes, |i| found.get(i / 4).map_or(0.0, |f| f.bbox[i % 4])).into(),
            Tensor::from_fn(scores, |i| found.get(i).map_or(0.0, |f| f.score)).into(),
            Tensor::from_fn(margins, |i| found.get(i).map_or(0.0, |f| f.margin)).into(),
            Tensor::from_fn(labels, |i| found.get(i).map_or(0, |f| f.class)).into(),
            Tensor::from_fn([1], |_| found.len() as u32).into(),
        ])
    }

    /// Boxes: see `decode_bound`. Margins: see `margin_bound`. Scores: as of `decode_proposals`,
    /// s(1 − s) times the errors of exp and of the margin, and of the quotient and the sum 7ε.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (rois, deltas, logits) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?);
        let classes = logits.dims()[1];
        let rule = self.rule(classes);
        let boxes = deltas.data().chunks(4 * classes).enumerate().flat_map(|(i, deltas)| {
            let roi = row(rois.data(), i);
            (1..classes).flat_map(move |c| decode_bound(roi, rule.deltas(deltas, c)))
        });
        let (mut scores, mut margins) = (Vec::new(), Vec::new());
        for logits in logits.data().chunks(classes) {
            for class in 1..classes {
                let margin = reference::margin(logits, class, self.temperature);
                let off = margin_bound(logits, class, self.temperature);
                let score = reference::sigmoid(margin);
                let power = EPS * (6.0 + 4.0 * margin.abs().min(1e6)) + 1.001 * off;
                let moved = score * ((1.0 - score) * power + 7.0 * EPS);
                scores.push(moved + f64::from(f32::MIN_POSITIVE));
                margins.push(off);
            }
        }
        let each = [boxes.collect(), scores, margins].map(Tolerance::Each);
        Ok(each.into_iter().chain([Tolerance::Exact, Tolerance::Exact]).collect())
    }

    fn defined(&self, reference: &[&Value], _inputs: &[&Value]) -> Vec<usize> {
        let count = live(Some(reference[4]), usize::MAX).unwrap_or(0);
        vec![count * 4, count, count, count, 1]
    }
}

/// How far a margin in f32 may be from exact. With h the highest of the others and d = |x − h| / T: the
/// difference, 1 / T and their product round to 3εd, for the class itself and for each of the others, whose
/// exp is then off by (6 + 7d)ε of itself, as of softmax. Their sum of n rounds n times; its logarithm is off
/// by that relative error, and by 2⁻²¹ up to 2 and else 3 ULP (WGSL). The last difference rounds once, and
/// the reference once.
fn margin_bound(logits: &[f32], class: usize, temperature: f32) -> f64 {
    let others = || logits.iter().enumerate().filter(|(c, _)| *c != class).map(|(_, x)| *x);
    let highest = others().fold(f32::NEG_INFINITY, f32::max);
    let far = |x: f32| (f64::from(x) - f64::from(highest)).abs() / f64::from(temperature);
    let (mut sum, mut off) = (0.0, 0.0);
    for x in others() {
        let power = (-far(x)).exp();
        sum += power;
        // What is nothing is so for certain, however far.
        off += power * (6.0 + 7.0 * far(x).min(1e6));
    }
    let terms = off / sum + logits.len() as f64;
    let logarithm = 8.0 + 6.0 * sum.ln();
    let margin = reference::margin(logits, class, temperature).abs();
    EPS * (3.0 * far(logits[class]) + terms + logarithm + 2.0 * margin)
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    let default = DecodeDetections::default();
    Ok(Box::new(DecodeDetections {
        width: params.require("width")?,
        height: params.require("height")?,
        weights: params.take_array("weights", default.weights)?,
        temperature: params.take("temperature", default.temperature)?,
        class_mask: params.take("class_mask", default.class_mask)?,
    }))
}

fn cases() -> Vec<Case> {
    let op = DecodeDetections { width: 40, height: 32, ..DecodeDetections::default() };
    let count = |n: u32| integers([1], &[n]);
    let random_case = |name: &str, seed: u64, rois: usize, classes: usize, mask: u32, n: u32| {
        let mut deltas = random(seed, [rois, 4 * classes]);
        deltas.data_mut().iter_mut().for_each(|d| *d *= 12.0);
        let inputs = vec![
            random_boxes(seed + 1, rois, 320.0, 100.0).into(),
            deltas.into(),
            random_scaled(seed + 2, [rois, classes], 20.0),
            count(n),
        ];
        let op = DecodeDetections { class_mask: mask, ..DecodeDetections::default() };
        Case::new(name, op, inputs)
    };
    let (ln2, ln3) = (std::f32::consts::LN_2, 3f64.ln() as f32);
    let mut cases = vec![
        // The box (8, 8)–(16, 24), centre (12, 16). Class 1: dx = 5/10 of 8 is 4, dy = −10/10 of
        // 16 is −16, so the centre is (16, 0), and the upper half is clipped. Class 2 is not
        // wanted; its dw = 100/5 is clamped to ln 62.5, which fills the picture's width. Shares of 2, 1 and 1
        // in 4: each class is 1 to 3.
        Case::new(
            "by hand",
            DecodeDetections { class_mask: 0b011, ..op },
            vec![
                values([2, 4], &[8.0, 8.0, 16.0, 24.0, 1.0, 1.0, 2.0, 2.0]),
                values([2, 12], &{
                    let mut deltas = [0.0; 24];
                    deltas[4..12].copy_from_slice(&[5.0, -10.0, 0.0, 0.0, 0.0, 0.0, 100.0, 0.0]);
                    deltas
                }),
                values([2, 3], &[ln2, 0.0, 0.0, 1.0, 0.0, 0.0]),
                count(1),
            ],
        )
        .by_hand(vec![
            values(
                [4, 4],
                &[
                    12.0, 0.0, 20.0, 8.0, 0.0, 8.0, 40.0, 24.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
                    0.0,
                ],
            ),
            values([4], &[0.25, -1.0, 0.0, 0.0]),
            values([4], &[-ln3, -ln3, 0.0, 0.0]),
            integers([4], &[1, 2, 0, 0]),
            integers([1], &[2]),
        ]),
        // Each delta has its weight: dx = 0.5/1 of 8 and dy = 0.5/2 of 16 are both 4, and dw = 4 ln 2/4
        // doubles the width, dh = −8 ln 2/8 halves the height. The centre is (16, 20), the size 16 × 8.
        Case::new(
            "four weights by hand",
            DecodeDetections { weights: [1.0, 2.0, 4.0, 8.0], ..op },
            vec![
                values([1, 4], &[8.0, 8.0, 16.0, 24.0]),
                values([1, 8], &[0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 4.0 * ln2, -8.0 * ln2]),
                values([1, 2], &[0.0, ln3]),
                count(1),
            ],
        )
        .by_hand(vec![
            values([1, 4], &[8.0, 16.0, 24.0, 24.0]),
            values([1], &[0.75]),
            values([1], &[ln3]),
            integers([1], &[1]),
            integers([1], &[1]),
        ]),
        torchvision(),
        random_case("nothing counted", 10, 3, 3, u32::MAX, 0),
        random_case("one class", 20, 1, 2, u32::MAX, 1),
        random_case("63 outputs, odd classes", 30, 21, 4, 0b1010, 21),
        random_case("65 outputs", 40, 13, 6, u32::MAX, 99),
        random_case("100 regions, 97 counted", 50, 100, 3, u32::MAX, 97),
        random_case("32 classes", 60, 7, 32, 0x8000_0001, 7),
    ];
    // A box of 2 × 2 around (160, 160): dw = 100/5 and dh = 20.7/5 = 4.14 are clamped to ln 62.5,
    // which makes 125 × 125; dh = 4 of class 2 is not, and makes 2e⁴. Nothing is clipped.
    let half = 4f64.exp() as f32;
    cases.push(
        Case::new(
            "the clamp by hand",
            DecodeDetections::default(),
            vec![
                values([1, 4], &[159.0, 159.0, 161.0, 161.0]),
                values([1, 12], &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0, 20.7, 0.0, 0.0, 0.0, 20.0]),
                values([1, 3], &[0.0, ln2, 0.0]),
                count(1),
            ],
        )
        .by_hand(vec![
            values([2, 4], &[97.5, 97.5, 222.5, 222.5, 159.0, 160.0 - half, 161.0, 160.0 + half]),
            values([2], &[0.5, 0.25]),
            values([2], &[0.0, -ln3]),
            integers([2], &[1, 2]),
            integers([1], &[2]),
        ]),
    );
    // 1 − 4e-9 and what is nearer to 1 are 1 in f32. At twice the temperature a margin is half as wide.
    for (name, temperature, logits, margins) in [
        ("scores of 1 by hand", 1.0, [[0.0, 20.0], [0.5, 20.0], [-1.0, 20.0]], [20.0, 19.5, 21.0]),
        (
            "a temperature by hand",
            2.0,
            [[0.0, 80.0], [1.0, 80.0], [-2.0, 80.0]],
            [40.0, 39.5, 41.0],
        ),
    ] {
        let op = DecodeDetections { temperature, ..DecodeDetections::default() };
        let boxes = || values([3, 4], &[1.0, 2.0, 3.0, 4.0].repeat(3));
        let inputs = vec![
            boxes(),
            Tensor::<f32>::zeros([3, 8]).into(),
            values([3, 2], logits.as_flattened()),
            count(3),
        ];
        cases.push(Case::new(name, op, inputs).by_hand(vec![
            boxes(),
            values([3], &[1.0; 3]),
            values([3], &margins),
            integers([3], &[1; 3]),
            integers([1], &[3]),
        ]));
    }
    for (seed, scale) in [(70, 1.0), (80, 1e4)] {
        let op = DecodeDetections { temperature: 1.37, ..DecodeDetections::default() };
        let inputs = vec![
            random_boxes(seed, 31, 320.0, 100.0).into(),
            random(seed + 1, [31, 20]).into(),
            random_scaled(seed + 2, [31, 5], scale),
            count(31),
        ];
        cases.push(Case::new(format!("logits to ±{scale:e}"), op, inputs));
    }
    cases.extend(stiff());
    let inputs = vec![
        random_boxes(1000, 100, 320.0, 120.0).into(),
        one_way(1001, [100, 12]).into(),
        one_way(1002, [100, 3]).into(),
        count(100),
    ];
    cases.push(Case::new("the RoI head", DecodeDetections::default(), inputs).in_network());
    cases
}

/// `BoxCoder((10, 10, 5, 5)).decode`, then `clip_boxes_to_image`, without the background.
fn torchvision() -> Case {
    let op = DecodeDetections { width: 40, height: 32, ..DecodeDetections::default() };
    let rois = [3.0, 4.0, 30.0, 20.0, 0.0, 0.0, 16.0, 31.0, 10.5, 2.25, 12.5, 30.0];
    let deltas = Tensor::from_fn([3, 12], |i| ((i as f64).cos() * 8.0) as f32);
    // Shares of 1, 1 and 6 in 8, of 1, 2 and 1 in 4, and of e⁻⁴⁰, 1 and e⁻¹⁰⁰ in 1.
    let [ln2, ln3, ln6, ln7] = [2f64, 3.0, 6.0, 7.0].map(|x| x.ln() as f32);
    let logits = [0.0, 0.0, ln6, 0.0, ln2, 0.0, -40.0, 0.0, -100.0];
    let golden = [
        [0.0, 0.0, 40.0, 32.0],
        [9.831_16, 0.0, 16.883_238, 8.394_383],
        [0.0, 0.0, 18.752_405, 32.0],
        [11.608_177, 0.0, 14.838_724, 8.524_488],
        [8.679_904, 0.0, 11.239_757, 32.0],
        [12.577_509, 12.562_246, 13.092_007, 19.098_267],
    ];
    Case::new(
        "torchvision",
        op,
        vec![values([3, 4], &rois), deltas.into(), values([3, 3], &logits), integers([1], &[3])],
    )
    .by_hand(vec![
        values([6, 4], golden.as_flattened()),
        values([6], &[0.125, 0.75, 0.5, 0.25, 1.0, 3.8e-44]),
        values([6], &[-ln7, ln3, 0.0, -ln3, 40.0, -100.0]),
        integers([6], &[1, 2, 1, 2, 1, 2]),
        integers([1], &[6]),
    ])
}

/// Regions from nothing to a million pixels, and deltas past every number.
fn stiff() -> Vec<Case> {
    let op = DecodeDetections { width: 65_536, height: 65_536, ..DecodeDetections::default() };
    let case = |name: &str, rois: &[[f32; 4]], deltas: &[[f32; 4]]| {
        let n = rois.len();
        // The background's deltas come first, and count for nothing.
        let delta = |i: usize| if i % 8 < 4 { f32::NAN } else { deltas[i / 8][i % 4] };
        let inputs = vec![
            values([n, 4], rois.as_flattened()),
            Tensor::from_fn([n, 8], delta).into(),
            Tensor::from_fn([n, 2], |_| 0.5).into(),
            integers([1], &[n as u32]),
        ];
        Case::new(name, op, inputs)
    };
    let by_hand = |case: Case, boxes: &[[f32; 4]]| {
        let n = boxes.len();
        case.by_hand(vec![
            values([n, 4], boxes.as_flattened()),
            Tensor::from_fn([n], |_| 0.5).into(),
            Tensor::from_fn([n], |_| 0f32).into(),
            Tensor::from_fn([n], |_| 1u32).into(),
            integers([1], &[n as u32]),
        ])
    };
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let near = 5.0 * crate::engine::reference::MAX_LOG_SCALE;
    let roi = [1000.0, 1000.0, 1002.0, 1004.0];
    vec![
        case(
            "a thousandth of a pixel",
            &[[9.0, 9.0, 9.001, 9.001]; 2],
            &[[5.0, -5.0, 10.0, -10.0], [0.0; 4]],
        ),
        // −10 of 10 times the width of a million bring the first to where it fills the picture.
        by_hand(
            case(
                "a million pixels by hand",
                &[[1e6, 1e6, 2e6, 2e6], [-1e6, -1e6, 0.0, 1e6]],
                &[[-10.0, -10.0, 0.0, 0.0], [0.0; 4]],
            ),
            &[[0.0, 0.0, 65_536.0, 65_536.0], [0.0, 0.0, 0.0, 65_536.0]],
        ),
        case(
            "a million pixels, back into the picture",
            &[[1e6, 1e6, 1e6 + 64.0, 1e6 + 32.0]],
            &[[-150_000.0, -300_000.0, 0.0, 5.0]],
        ),
        case(
            "next to the clamp",
            &[roi; 4],
            &[
                [0.0, 0.0, near, near.next_up()],
                [0.0, 0.0, near.next_down(), near],
                [0.0, 0.0, 1e30, 22.0],
                [0.0, 0.0, -1e30, -440.0],
            ],
        ),
        by_hand(
            case(
                "a region of no size by hand",
                &[[7.0, 5.0, 7.0, 5.0]],
                &[[3e38, -3e38, 3e38, -3e38]],
            ),
            &[[7.0, 5.0, 7.0, 5.0]],
        ),
        case(
            "shifts past every number",
            &[roi; 2],
            &[[3e38, -3e38, 88.0, -88.0], [-1e30, 1e30, 0.0, 0.0]],
        ),
        by_hand(
            case(
                "what is not finite, by hand",
                &[roi, roi, [nan, 1000.0, 1002.0, 1004.0], [1000.0, 1000.0, 1002.0, inf]],
                &[[0.0, nan, 0.0, 0.0], [0.0, 0.0, inf, 0.0], [0.0; 4], [0.0; 4]],
            ),
            &[
                [1000.0, nan, 1002.0, nan],
                [nan, 1000.0, nan, 1004.0],
                [nan, 1000.0, nan, 1004.0],
                [1000.0, nan, 1002.0, nan],
            ],
        ),
    ]
}
