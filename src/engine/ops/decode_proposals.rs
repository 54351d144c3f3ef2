//! Proposals from the region proposal head.

use crate::engine::ops::boxes::decode_bound;
use crate::engine::ops::case::{Case, integers, one_way, random, random_integers, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, AnchorGrid};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "decode_proposals",
    takes: "deltas [4A, H, W], scores [K], indices u32 [K], count u32 [1]",
    gives: "boxes [K, 4], scores [K]",
    params: &[
        Param::required("anchors", "-16,-16,16,16", Range::Numbers(-65_536.0, 65_536.0)),
        Param::required("stride", "8", Range::Whole(1, 4096)),
        Param::required("width", "320", Range::Whole(1, 65_536)),
        Param::required("height", "320", Range::Whole(1, 65_536)),
    ],
    build,
    cases,
};

/// Most anchors of a cell: far past any use.
const MAX_ANCHORS: usize = 1024;

/// Boxes of the chosen anchors, clipped to the picture, and their objectness.
///
/// Inputs: `deltas` f32 `[4A, H, W]`, channel = anchor · 4 + (dx, dy, dw, dh); `scores` f32 `[K]`,
/// logits of the chosen; `indices` u32 `[K]`, (y · W + x) · A + anchor, where one past the end names
/// the last; `count` u32 `[1]`. Outputs: `boxes` f32 `[K, 4]`, `scores` f32 `[K]` in 0 to 1; rows
/// behind the count are not written. The conventions are torchvision's `AnchorGenerator` and
/// `BoxCoder` with weights (1, 1, 1, 1).
#[derive(Clone, Debug)]
pub struct DecodeProposals {
    /// Anchors of one cell, around the origin.
    pub anchors: Vec<[f32; 4]>,
    /// Pixels between cells.
    pub stride: usize,
    /// Width of the picture in pixels, to which boxes are clipped.
    pub width: usize,
    /// Height of the picture in pixels.
    pub height: usize,
}

impl DecodeProposals {
    pub(crate) fn grid(&self, width: usize) -> AnchorGrid<'_> {
        AnchorGrid { cell: &self.anchors, stride: self.stride as f32, width }
    }
}

impl Op for DecodeProposals {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("anchors", self.anchors.as_flattened().into()),
            ("stride", self.stride.into()),
            ("width", self.width.into()),
            ("height", self.height.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["deltas", "scores", "indices", "count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["boxes", "scores"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        if !(1..=MAX_ANCHORS).contains(&self.anchors.len()) {
            let expected = format!("at least one, at most {MAX_ANCHORS}");
            return Err(Error::param(name, "anchors", expected, self.anchors.len()));
        }
        if let Some(anchor) = self.anchors.iter().find(|[x1, y1, x2, y2]| x1 >= x2 || y1 >= y2) {
            let expected = "x1 below x2 and y1 below y2";
            return Err(Error::param(name, "anchors", expected, format!("{anchor:?}")));
        }
        let [channels, h, w] = dims(name, "deltas", &inputs[0], DType::F32)?;
        if channels != 4 * self.anchors.len() || h * w == 0 {
            let expected = format!("f32 [{}, H, W] without a zero", 4 * self.anchors.len());
            return Err(Error::tensor(name, "deltas", expected, &inputs[0]));
        }
        let [k] = dims(name, "scores", &inputs[1], DType::F32)?;
        if k == 0 {
            return Err(Error::tensor(name, "scores", "f32 [K] without a zero", &inputs[1]));
        }
        expect(name, "indices", &TensorSpec::u32([k]), &inputs[2])?;
        expect_count(name, Some(&inputs[3]))?;
        Ok(vec![TensorSpec::f32([k, 4]), TensorSpec::f32([k])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (deltas, logits, indices) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].u32()?);
        let count = live(Some(inputs[3]), logits.data().len())?;
        let extent = [self.width as f32, self.height as f32];
        let grid = self.grid(deltas.dims()[2]);
        let mut boxes =
            reference::decode_proposals(deltas, &indices.data()[..count], grid, extent).concat();
        boxes.resize(specs[0].shape.elements(), 0.0);
        let score = |i: usize| {
            if i < count { reference::sigmoid(logits.data()[i].into()) as f32 } else { 0.0 }
        };
        Ok(vec![
            Tensor::new(specs[0].shape.clone(), boxes)?.into(),
            Tensor::from_fn(specs[1].shape.clone(), score).into(),
        ])
    }

    /// Boxes: see `decode_bound`. Scores: s = e/(1 + e) moves by s(1 − s) times the relative error
    /// of e, which is (3 + 2|x|) ULP of at most 2ε; the quotient adds 2.5 ULP and the sum ε.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (deltas, logits, indices) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].u32()?);
        let grid = self.grid(deltas.dims()[2]);
        let last = deltas.data().len() / 4 - 1;
        let boxes = indices.data().iter().flat_map(|index| {
            let index = last.min(*index as usize);
            decode_bound(grid.anchor(index).0, grid.deltas(deltas, index))
        });
        let sigmoids = reference[1].f32()?.data().iter().zip(logits.data()).map(|(s, x)| {
            let (s, x) = (f64::from(*s), f64::from(x.abs()));
            let exponential = s * (1.0 - s) * (6.0 + 4.0 * x);
            EPS * (exponential + 7.0 * s) + f64::from(f32::MIN_POSITIVE)
        });
        Ok(vec![Tolerance::Each(boxes.collect()), Tolerance::Each(sigmoids.collect())])
    }

    fn defined(&self, _reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        let capacity = inputs[1].spec().shape.elements();
        let count = live(Some(inputs[3]), capacity).unwrap_or(0);
        vec![count * 4, count]
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    let sides: Vec<f32> = params.require_list("anchors")?;
    let (anchors, rest) = sides.as_chunks::<4>();
    if !rest.is_empty() {
        let got = format!("{} numbers", sides.len());
        return Err(Error::param(ENTRY.name, "anchors", "x1,y1,x2,y2 of each anchor", got));
    }
    Ok(Box::new(DecodeProposals {
        anchors: anchors.to_vec(),
        stride: params.require("stride")?,
        width: params.require("width")?,
        height: params.require("height")?,
    }))
}

fn cases() -> Vec<Case> {
    let anchors = vec![[-8.0, -4.0, 8.0, 4.0], [-2.0, -2.0, 2.0, 2.0]];
    let op = DecodeProposals { anchors, stride: 8, width: 32, height: 24 };
    let count = |n: u32| integers([1], &[n]);
    let deltas =
        |seed: u64, a: usize, h: usize, w: usize| -> Value { random(seed, [4 * a, h, w]).into() };
    let three =
        vec![[-16.0, -16.0, 16.0, 16.0], [-23.0, -11.0, 23.0, 11.0], [-5.5, -9.0, 5.5, 9.0]];
    let rpn = DecodeProposals { anchors: three, stride: 8, width: 317, height: 251 };
    let case = |name: &str, seed: u64, k: usize, counted: u32| {
        let logits = Tensor::from_fn([k], |i| (i as f32 - k as f32 / 2.0) * 0.25);
        let inputs = vec![
            deltas(seed, 3, 31, 37),
            logits.into(),
            random_integers(seed + 1, [k], 3 * 31 * 37),
            count(counted),
        ];
        Case::new(name, rpn.clone(), inputs)
    };
    let mut extreme = random(70, [12, 5, 7]);
    extreme.data_mut().iter_mut().for_each(|x| *x *= 20.0);
    let mut cases = vec![
        // Index 9 is anchor 1 at x = 1, y = 1: (6, 6, 10, 10), centre 8. dx = 0.5 moves it by 2,
        // dy = −1 by −4; dw = dh = 0. Index 0 is anchor 0 at the origin, clipped at 0; its dw of
        // 9 is clamped to ln 62.5, so that it is 16 · 62.5 wide. A logit of 0 is one half.
        Case::new("by hand", op.clone(), {
            let mut deltas = Tensor::zeros([8, 2, 3]);
            let position = 3 + 1;
            deltas.data_mut()[4 * 6 + position] = 0.5;
            deltas.data_mut()[5 * 6 + position] = -1.0;
            deltas.data_mut()[2 * 6] = 9.0;
            vec![
                deltas.into(),
                values([3], &[0.0, -1000.0, 1.0]),
                integers([3], &[9, 0, 0]),
                count(2),
            ]
        })
        .by_hand(vec![
            values([3, 4], &[8.0, 2.0, 12.0, 6.0, 0.0, 0.0, 32.0, 4.0, 0.0, 0.0, 0.0, 0.0]),
            values([3], &[0.5, 0.0, 0.0]),
        ]),
        Case::new(
            "nothing counted, and an index past the end",
            op.clone(),
            vec![deltas(1, 2, 2, 3), values([1], &[2.0]), integers([1], &[12]), count(0)],
        ),
        Case::new(
            "an index past the end",
            op,
            vec![deltas(2, 2, 2, 3), values([1], &[2.0]), integers([1], &[u32::MAX]), count(1)],
        ),
        case("a workgroup less one", 10, 63, 63),
        case("a workgroup and one", 20, 65, 65),
        case("a thousand, 613 counted", 30, 1000, 613),
        Case::new(
            "large deltas",
            rpn.clone(),
            vec![
                extreme.into(),
                values([4], &[88.0, -88.0, 103.0, -120.0]),
                integers([4], &[0, 17, 55, 104]),
                count(u32::MAX),
            ],
        ),
        torchvision(),
    ];
    // An anchor of 2 × 2 at (160, 160): dw = 9 and dh = 4.14 are clamped to ln 62.5, which makes
    // 125 × 125; dh = 4 is not, and makes 2e⁴. Nothing is clipped.
    let small = DecodeProposals {
        anchors: vec![[159.0, 159.0, 161.0, 161.0]],
        stride: 8,
        width: 320,
        height: 320,
    };
    let half = 4f64.exp() as f32;
    cases.push(
        Case::new(
            "the clamp by hand",
            small,
            vec![
                values([4, 1, 2], &[0.0, -4.0, 0.0, 0.0, 9.0, 0.0, 4.14, 4.0]),
                values([2], &[0.0, 0.0]),
                integers([2], &[0, 1]),
                count(2),
            ],
        )
        .by_hand(vec![
            // The second lies one stride to the right, and dx = −4 of 2 brings it back.
            values([2, 4], &[97.5, 97.5, 222.5, 222.5, 159.0, 160.0 - half, 161.0, 160.0 + half]),
            values([2], &[0.5, 0.5]),
        ]),
    );
    // An index past the end names the last anchor, here the second at (160, 160) + (8, 0).
    let past = DecodeProposals {
        anchors: vec![[-1.0, -1.0, 1.0, 1.0], [159.0, 159.0, 161.0, 161.0]],
        stride: 8,
        width: 320,
        height: 320,
    };
    let inputs = vec![
        Tensor::<f32>::zeros([8, 1, 2]).into(),
        values([2], &[0.0, 0.0]),
        integers([2], &[4, 2]),
        count(9),
    ];
    cases.push(Case::new("an index past the end by hand", past, inputs).by_hand(vec![
        values([2, 4], &[167.0, 159.0, 169.0, 161.0, 7.0, 0.0, 9.0, 1.0]),
        values([2], &[0.5, 0.5]),
    ]));
    // Larger than the picture on all sides.
    let huge = DecodeProposals {
        anchors: vec![[-100.0, -100.0, 100.0, 100.0]],
        stride: 8,
        width: 32,
        height: 24,
    };
    let inputs = vec![
        Tensor::<f32>::zeros([4, 1, 1]).into(),
        values([1], &[0.0]),
        integers([1], &[0]),
        count(1),
    ];
    cases.push(
        Case::new("clipped on all sides by hand", huge, inputs)
            .by_hand(vec![values([1, 4], &[0.0, 0.0, 32.0, 24.0]), values([1], &[0.5])]),
    );
    // Outside of it: dx and dy of ±20 take a box of 2 × 2 at the origin 40 away.
    let outside =
        DecodeProposals { anchors: vec![[-1.0, -1.0, 1.0, 1.0]], stride: 8, width: 32, height: 24 };
    let inputs = vec![
        values([4, 1, 2], &[-20.0, 20.0, -20.0, 20.0, 0.0, 0.0, 0.0, 0.0]),
        values([2], &[0.0, 0.0]),
        integers([2], &[0, 1]),
        count(2),
    ];
    cases.push(Case::new("outside the picture by hand", outside, inputs).by_hand(vec![
        values([2, 4], &[0.0, 0.0, 0.0, 0.0, 32.0, 24.0, 32.0, 24.0]),
        values([2], &[0.5, 0.5]),
    ]));
    cases.extend(stiff());
    let sides = [16.0, 24.0, 32.0, 48.0].map(|s: f32| [s, s / 2.0]).concat();
    let anchors = (0..20).map(|i| {
        let [w, h] = [sides[i % 8], sides[(i + 3) % 8]];
        [-w, -h, w, h]
    });
    let rpn = DecodeProposals { anchors: anchors.collect(), stride: 8, width: 320, height: 320 };
    let inputs = vec![
        one_way(1000, [80, 40, 40]).into(),
        one_way(1001, [1000]).into(),
        random_integers(1002, [1000], 20 * 40 * 40),
        count(1000),
    ];
    cases.push(Case::new("the anchors", rpn, inputs).in_network());
    cases
}

/// Computed by torchvision: `AnchorGenerator` and `BoxCoder((1, 1, 1, 1)).decode`, then
/// `clip_boxes_to_image`, for deltas of sin(i).
fn torchvision() -> Case {
    let op = DecodeProposals {
        anchors: vec![[-23.0, -11.0, 23.0, 11.0], [-11.0, -23.0, 11.0, 23.0]],
        stride: 8,
        width: 400,
        height: 320,
    };
    let golden = [
        [0.0, 11.974_904, 48.453_632, 28.194_69],
        [38.359_226, 20.182_24, 52.248_806, 37.132_717],
        [0.0, 0.0, 6.958_214, 35.583_992],
        [0.0, 0.0, 32.082_07, 65.766_71],
    ];
    let deltas = Tensor::from_fn([8, 4, 5], |i| (i as f64).sin() as f32);
    let inputs = vec![
        deltas.into(),
        values([4], &[-2.0, -0.5, 0.5, 3.0]),
        integers([4], &[0, 7, 22, 39]),
        integers([1], &[4]),
    ];
    Case::new("torchvision", op, inputs).by_hand(vec![
        values([4, 4], golden.as_flattened()),
        values([4], &[0.119_202_92, 0.377_540_68, 0.622_459_35, 0.952_574_1]),
    ])
}

/// Anchors from a thousandth of a pixel to the largest, deltas at the clamp and past every number, logits
/// where the exponential ends.
fn stiff() -> Vec<Case> {
    let op = |anchor: [f32; 4]| DecodeProposals {
        anchors: vec![anchor],
        stride: 8,
        width: 65_536,
        height: 65_536,
    };
    // One row of cells, 8 pixels apart, each with its column of deltas.
    let case = |name: &str, anchor: [f32; 4], deltas: [&[f32]; 4], logits: &[f32]| {
        let k = logits.len();
        let inputs = vec![
            values([4, 1, k], &deltas.concat()),
            values([k], logits),
            Tensor::from_fn([k], |i| i as u32).into(),
            integers([1], &[k as u32]),
        ];
        Case::new(name, op(anchor), inputs)
    };
    let near = crate::engine::reference::MAX_LOG_SCALE;
    let (below, above) = (near.next_down(), near.next_up());
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let (six, four) = ([0.0; 6], [0.0; 4]);
    let far = [1000.0, 1000.0, 1002.0, 1004.0];
    let thousandth = [500.0, 500.0, 500.001, 500.001];
    let shifted =
        |i: usize| far[i % 4] + if i.is_multiple_of(2) { 8.0 * (i / 4) as f32 } else { 0.0 };
    let lost = [
        [nan, 1000.0, nan, 1004.0],
        [1008.0, nan, 1010.0, nan],
        [nan, 1000.0, nan, 1004.0],
        [1024.0, nan, 1026.0, nan],
    ];
    vec![
        // e^-88 is subnormal, and e^-104 less than half of the least number.
        case(
            "logits of ±88, ±104, ±1e3 by hand",
            far,
            [&six; 4],
            &[88.0, -88.0, 104.0, -104.0, 1e3, -1e3],
        )
        .by_hand(vec![
            Tensor::from_fn([6, 4], shifted).into(),
            values([6], &[1.0, 6.054_602e-39, 1.0, 0.0, 1.0, 0.0]),
        ]),
        case(
            "next to the clamp",
            far,
            [&four, &four, &[near, below, above, 5.0], &[below, near, 88.0, above]],
            &four,
        ),
        case(
            "a thousandth of a pixel",
            thousandth,
            [&[0.5, -0.5, 7.0, 1e3], &four, &[4.0, -4.0, 0.0, 1.0], &four],
            &four,
        ),
        case(
            "the largest anchor by hand",
            [-65_536.0, -65_536.0, 65_536.0, 65_536.0],
            [&[0.0]; 4],
            &[0.0],
        )
        .by_hand(vec![values([1, 4], &[0.0, 0.0, 65_536.0, 65_536.0]), values([1], &[0.5])]),
        // A million pixels away, and further than numbers go: at the picture's edges.
        case(
            "shifts past every number",
            far,
            [&[3e38, -3e38, 5e5, -5e5], &four, &[88.0, -88.0, -1e30, 1e30], &four],
            &four,
        ),
        // Each in its column: the other axis stays, and no clamp makes a number of it.
        case(
            "deltas that are not finite, by hand",
            far,
            [
                &[nan, 0.0, 0.0, 0.0],
                &[0.0, inf, 0.0, 0.0],
                &[0.0, 0.0, nan, 0.0],
                &[0.0, 0.0, 0.0, -inf],
            ],
            &four,
        )
        .by_hand(vec![values([4, 4], lost.as_flattened()), values([4], &[0.5; 4])]),
    ]
}
