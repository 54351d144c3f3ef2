//! Detections from the RoI head.

use crate::cpu::{self, DetectionRule};
use crate::error::{Error, Result};
use crate::ops::boxes::{decode_bound, row};
use crate::ops::case::{Case, integers, one_way, random, random_boxes, values};
use crate::ops::count::{expect_count, live};
use crate::ops::op::{Entry, Op, Tolerance, dims, expect};
use crate::ops::params::{Param, Params as Named, Range, Settings};
use crate::shape::{DType, TensorSpec};
use crate::tensor::{Tensor, Value};

/// This operation in [`crate::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "decode_detections",
    takes: "rois [R, 4], deltas [R, 4C], probabilities [R, C], count u32 [1]",
    gives: "boxes [R(C - 1), 4], scores [R(C - 1)], classes u32 [R(C - 1)], count u32 [1]",
    params: &[
        Param::required("width", "320", Range::Whole(1, 65_536)),
        Param::required("height", "320", Range::Whole(1, 65_536)),
        Param::optional("weights", "10,10,5,5", Range::Numbers(1e-3, 1e3)),
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
/// background first; `probabilities` f32 `[R, classes]`; `count` u32 `[1]`, regions in use. Outputs,
/// with N = R · (classes − 1): `boxes` f32 `[N, 4]`, clipped to the picture; `scores` f32 `[N]`, −1
/// where the class is not wanted; `classes` u32 `[N]`; `count` u32 `[1]`, how many of the N are
/// written. The conventions are torchvision's `RoIHeads.postprocess_detections` before its
/// thresholds, and its `BoxCoder`.
#[derive(Clone, Copy, Debug)]
pub struct DecodeDetections {
    /// Width of the picture in pixels, to which boxes are clipped.
    pub width: usize,
    /// Height of the picture in pixels.
    pub height: usize,
    /// What (dx, dy, dw, dh) are divided by; torchvision's (10, 10, 5, 5) by default.
    pub weights: [f32; 4],
    /// Bit c: class c is wanted; all by default.
    pub class_mask: u32,
}

impl Default for DecodeDetections {
    fn default() -> Self {
        Self { width: 320, height: 320, weights: [10.0, 10.0, 5.0, 5.0], class_mask: u32::MAX }
    }
}

impl DecodeDetections {
    fn rule(&self, classes: usize) -> DetectionRule {
        DetectionRule {
            extent: [self.width as f32, self.height as f32],
            weights: self.weights,
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
            ("class_mask", self.class_mask.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["rois", "deltas", "probabilities", "count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["boxes", "scores", "classes", "count"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [rois, classes] = dims(name, "probabilities", &inputs[2], DType::F32)?;
        if rois == 0 || classes < 2 {
            let expected = "f32 [R, classes] with R above 0 and at least 2 classes";
            return Err(Error::tensor(name, "probabilities", expected, &inputs[2]));
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
            TensorSpec::u32([n]),
            TensorSpec::u32([1]),
        ])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (rois, deltas, probabilities) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?);
        let classes = probabilities.dims()[1];
        let count = live(Some(inputs[3]), rois.dims()[0])?;
        let found: Vec<_> = (0..count)
            .flat_map(|i| {
                let deltas = &deltas.data()[i * 4 * classes..][..4 * classes];
                let probabilities = &probabilities.data()[i * classes..][..classes];
                cpu::decode_detections(
                    row(rois.data(), i),
                    deltas,
                    probabilities,
                    self.rule(classes),
                )
            })
            .collect();
        let [boxes, scores, labels] = [0, 1, 2].map(|i| specs[i].shape.clone());
        Ok(vec![
            Tensor::from_fn(boxes, |i| found.get(i / 4).map_or(0.0, |f| f.0[i % 4])).into(),
            Tensor::from_fn(scores, |i| found.get(i).map_or(0.0, |f| f.1)).into(),
            Tensor::from_fn(labels, |i| found.get(i).map_or(0, |f| f.2)).into(),
            Tensor::from_fn([1], |_| found.len() as u32).into(),
        ])
    }

    /// Boxes: see `decode_bound`. The rest is copied or counted.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (rois, deltas, probabilities) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?);
        let classes = probabilities.dims()[1];
        let rule = self.rule(classes);
        let boxes = deltas.data().chunks(4 * classes).enumerate().flat_map(|(i, deltas)| {
            let roi = row(rois.data(), i);
            (1..classes).flat_map(move |c| decode_bound(roi, rule.deltas(deltas, c)))
        });
        let boxes = Tolerance::Each(boxes.collect());
        Ok(vec![boxes, Tolerance::Exact, Tolerance::Exact, Tolerance::Exact])
    }

    fn defined(&self, reference: &[&Value], _inputs: &[&Value]) -> Vec<usize> {
        let count = live(Some(reference[3]), usize::MAX).unwrap_or(0);
        vec![count * 4, count, count, 1]
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    let default = DecodeDetections::default();
    Ok(Box::new(DecodeDetections {
        width: params.require("width")?,
        height: params.require("height")?,
        weights: params.take_array("weights", default.weights)?,
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
            random(seed + 2, [rois, classes]).into(),
            count(n),
        ];
        let op = DecodeDetections { class_mask: mask, ..DecodeDetections::default() };
        Case::new(name, op, inputs)
    };
    let ln2 = std::f32::consts::LN_2;
    let mut cases = vec![
        // The box (8, 8)–(16, 24), centre (12, 16). Class 1: dx = 5/10 of 8 is 4, dy = −10/10 of
        // 16 is −16, so the centre is (16, 0), and the upper half is clipped. Class 2 is not
        // wanted; its dw = 100/5 is clamped to ln 62.5, which fills the picture's width.
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
                values([2, 3], &[0.5, 0.25, 0.25, 1.0, 0.0, 0.0]),
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
                values([1, 2], &[0.25, 0.75]),
                count(1),
            ],
        )
        .by_hand(vec![
            values([1, 4], &[8.0, 16.0, 24.0, 24.0]),
            values([1], &[0.75]),
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
                values([1, 3], &[0.25, 0.5, 0.25]),
                count(1),
            ],
        )
        .by_hand(vec![
            values([2, 4], &[97.5, 97.5, 222.5, 222.5, 159.0, 160.0 - half, 161.0, 160.0 + half]),
            values([2], &[0.5, 0.25]),
            integers([2], &[1, 2]),
            integers([1], &[2]),
        ]),
    );
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
    let probabilities = [0.0, 0.125, 0.875, 0.25, 0.5, 0.25, 0.0, 1.0, 0.0];
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
        vec![
            values([3, 4], &rois),
            deltas.into(),
            values([3, 3], &probabilities),
            integers([1], &[3]),
        ],
    )
    .by_hand(vec![
        values([6, 4], golden.as_flattened()),
        values([6], &[0.125, 0.875, 0.5, 0.25, 1.0, 0.0]),
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
            Tensor::from_fn([n], |_| 1u32).into(),
            integers([1], &[n as u32]),
        ])
    };
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let near = 5.0 * crate::cpu::MAX_LOG_SCALE;
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
