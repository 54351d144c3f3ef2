//! RoIAlign: features of each box on a grid of fixed size.

use crate::engine::ops::boxes::row;
use crate::engine::ops::case::{Case, STACKED, integers, random, random_boxes, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance, dims};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, RoiGrid};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "roi_align",
    takes: "features [C, H, W], boxes [N, 4]; optional: count u32 [1]",
    gives: "output [N, C, output_size, output_size]",
    params: &[
        Param::required("spatial_scale", "0.125", Range::Number(1e-4, 1e4)),
        Param::required("output_size", "7", Range::Whole(1, 256)),
        Param::optional("sampling_ratio", "2", Range::Whole(1, 256)),
    ],
    build,
    cases,
};

/// `torchvision.ops.roi_align` with `aligned=True`, which is not torchvision's default: boxes are
/// shifted by half a feature, so that they lie where the picture's pixels are.
///
/// Inputs: `features` f32 `[C, H, W]`, `boxes` f32 `[R, 4]` in pixels, `count` u32 `[1]` if `count`.
/// Output: `output` f32 `[R, C, P, P]`; boxes behind the count are not written.
#[derive(Clone, Copy, Debug)]
pub struct RoiAlign {
    /// Features a pixel: 1/8 for a map of stride 8.
    pub spatial_scale: f32,
    /// Bins on each side of a box, P.
    pub output_size: usize,
    /// Samples on each side of a bin, at least 1.
    pub sampling_ratio: usize,
    /// Whether a count limits the boxes.
    pub count: bool,
}

impl RoiAlign {
    /// The grid of samples.
    pub(crate) fn grid(&self) -> RoiGrid {
        RoiGrid {
            scale: f64::from(self.spatial_scale),
            size: self.output_size,
            ratio: self.sampling_ratio,
        }
    }
}

impl Op for RoiAlign {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("spatial_scale", self.spatial_scale.into()),
            ("output_size", self.output_size.into()),
            ("sampling_ratio", self.sampling_ratio.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["features", "boxes"];
        names.extend(self.count.then_some("count"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [c, h, w] = dims(name, "features", &inputs[0], DType::F32)?;
        if [c, h, w].contains(&0) {
            let expected = "f32 [C, H, W] without a zero";
            return Err(Error::tensor(name, "features", expected, &inputs[0]));
        }
        let [rois, sides] = dims(name, "boxes", &inputs[1], DType::F32)?;
        if sides != 4 || rois == 0 {
            let expected = "f32 [R, 4] with R above 0";
            return Err(Error::tensor(name, "boxes", expected, &inputs[1]));
        }
        expect_count(name, inputs.get(2))?;
        Ok(vec![TensorSpec::f32([rois, c, self.output_size, self.output_size])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (features, boxes) = (inputs[0].f32()?, inputs[1].f32()?);
        let rois = live(inputs.get(2).copied(), boxes.dims()[0])?;
        let boxes: Vec<_> = (0..rois).map(|i| row(boxes.data(), i)).collect();
        let mut output = reference::roi_align(features, &boxes, self.grid()).into_data();
        output.resize(specs[0].shape.elements(), 0.0);
        Ok(vec![Tensor::new(specs[0].shape.clone(), output)?.into()])
    }

    /// Three causes, each averaged over a bin's samples.
    ///
    /// A coordinate is a handful of sums and quotients (WGSL: 2.5 ULP each) of terms no larger than
    /// r = scale · (|low| + |high|) + 1, so it is off by δ ≤ 24·ε·r. That moves a bilinear sample by
    /// at most δ times the spread of the features around it, as wide as the coordinate may be off.
    /// Within δ of −1 or of the length, the sample may be there or not, which is worth all of it.
    /// Last, weights, products and sums round: (4 · samples + 12) times, by ε of the largest
    /// feature.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (features, boxes) = (inputs[0].f32()?, inputs[1].f32()?);
        let [channels, height, width] = [0, 1, 2].map(|i| features.dims()[i]);
        let rois = live(inputs.get(2).copied(), boxes.dims()[0])?;
        let (size, ratio) = (self.output_size, self.sampling_ratio);
        let mut each = vec![0.0; reference[0].spec().shape.elements()];
        for (i, bound) in each.iter_mut().enumerate().take(rois * channels * size * size) {
            let b = row(boxes.data(), i / (channels * size * size));
            let channel = i / (size * size) % channels;
            let plane = &features.data()[channel * height * width..][..height * width];
            let bins = [i % size, i / size % size];
            let range = |axis: usize, sample: usize, length: usize| {
                self.sample_range(b[axis], b[axis + 2], bins[axis], sample, length)
            };
            for iy in 0..ratio {
                for ix in 0..ratio {
                    let (y, x) = (range(1, iy, height), range(0, ix, width));
                    let around = (y.first..=y.last)
                        .flat_map(|y| plane[y * width..][x.first..=x.last].iter())
                        .map(|f| f64::from(*f));
                    let (low, high) = around
                        .fold((f64::MAX, f64::MIN), |(low, high), f| (low.min(f), high.max(f)));
                    let largest = low.abs().max(high.abs());
                    let moved = (x.off + y.off) * (high - low);
                    let there_or_not = if x.at_end || y.at_end { largest } else { 0.0 };
                    let rounding = (4 * ratio * ratio + 12) as f64 * EPS * largest;
                    *bound += moved + there_or_not + rounding;
                }
            }
            *bound = *bound / (ratio * ratio) as f64 + f64::from(f32::MIN_POSITIVE);
        }
        Ok(vec![Tolerance::Each(each)])
    }

    fn defined(&self, reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        let shape = reference[0].spec().shape;
        let rois = live(inputs.get(2).copied(), shape.0[0]).unwrap_or(0);
        vec![rois * shape.0[1..].iter().product::<usize>()]
    }
}

/// Where a sample may fall on one axis.
struct SampleRange {
    /// How far the coordinate may be off.
    off: f64,
    /// First feature that it may touch.
    first: usize,
    /// Last feature that it may touch.
    last: usize,
    /// Whether rounding decides if it is sampled at all.
    at_end: bool,
}

impl RoiAlign {
    fn sample_range(
        &self,
        low: f32,
        high: f32,
        bin: usize,
        sample: usize,
        length: usize,
    ) -> SampleRange {
        let at = self.grid().sample(low, high, bin, sample);
        let reach = f64::from(self.spatial_scale) * f64::from(low.abs() + high.abs()) + 1.0;
        let off = 24.0 * EPS * reach;
        let clamp = |x: f64| x.clamp(0.0, (length - 1) as f64) as usize;
        SampleRange {
            off,
            first: clamp((at - off).floor()),
            last: clamp((at + off).floor() + 1.0),
            at_end: (at + 1.0).abs() <= off || (at - length as f64).abs() <= off,
        }
    }
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(RoiAlign {
        spatial_scale: params.require("spatial_scale")?,
        output_size: params.require("output_size")?,
        sampling_ratio: params.take("sampling_ratio", 2)?,
        count: present.contains(&"count"),
    }))
}

fn cases() -> Vec<Case> {
    let op = RoiAlign { spatial_scale: 0.25, output_size: 2, sampling_ratio: 2, count: false };
    let counted = RoiAlign { count: true, ..op };
    let ramp = || -> Value { Tensor::from_fn([1, 4, 4], |i| (10 * (i / 4) + i % 4) as f32).into() };
    let one = RoiAlign { spatial_scale: 1.0, output_size: 1, sampling_ratio: 1, ..op };
    let mut cases = vec![
        // f = 10y + x. The box (1, 1)–(3, 3) has its centre at feature 2 − 0.5 = 1.5 on both axes:
        // 16.5. Its bins of one sample lie at 1 and 2.
        Case::new("one bin by hand", one, vec![ramp(), values([1, 4], &[1.0, 1.0, 3.0, 3.0])])
            .by_hand(vec![values([1, 1, 1, 1], &[16.5])]),
        Case::new(
            "four bins by hand",
            RoiAlign { output_size: 2, ..one },
            vec![ramp(), values([1, 4], &[1.0, 1.0, 3.0, 3.0])],
        )
        .by_hand(vec![values([1, 1, 2, 2], &[11.0, 12.0, 21.0, 22.0])]),
        // Centres at (−1, −1), still the corner; at (4, 4), still the last; at −1.25, nothing.
        Case::new(
            "the edges by hand",
            one,
            vec![
                ramp(),
                values([3, 4], &[-1.0, -1.0, 0.0, 0.0, 4.0, 4.0, 5.0, 5.0, -1.5, 1.0, 0.0, 2.0]),
            ],
        )
        .by_hand(vec![values([3, 1, 1, 1], &[0.0, 33.0, 0.0])]),
        // f = 10y + x + 5 on 3 × 5 features. Exactly at −1 and at the length there is still the edge:
        // x = −1, y = −1, x = 5 and y = 3 give f(0, 1), f(1, 0), f(4, 1), f(1, 2). A quarter further
        // there is nothing. All coordinates are sums of quarters, which nothing rounds.
        Case::new(
            "exactly at the edges by hand",
            one,
            vec![
                Tensor::from_fn([1, 3, 5], |i| (10 * (i / 5) + i % 5 + 5) as f32).into(),
                values(
                    [8, 4],
                    &[
                        [-1.0, 1.0, 0.0, 2.0],
                        [1.0, -1.0, 2.0, 0.0],
                        [5.0, 1.0, 6.0, 2.0],
                        [1.0, 3.0, 2.0, 4.0],
                        [-1.25, 1.0, -0.25, 2.0],
                        [1.0, -1.25, 2.0, -0.25],
                        [5.25, 1.0, 6.25, 2.0],
                        [1.0, 3.25, 2.0, 4.25],
                    ]
                    .concat(),
                ),
            ],
        )
        .by_hand(vec![values([8, 1, 1, 1], &[15.0, 6.0, 19.0, 26.0, 0.0, 0.0, 0.0, 0.0])])
        .exact(),
        // Four samples at 0.75 and 1.25 of each axis, whose mean is at 1: 11.
        Case::new(
            "four samples and one box counted by hand",
            RoiAlign { sampling_ratio: 2, count: true, ..one },
            vec![
                ramp(),
                values([2, 4], &[1.0, 1.0, 2.0, 2.0, 0.0, 0.0, 1.0, 1.0]),
                integers([1], &[1]),
            ],
        )
        .by_hand(vec![values([2, 1, 1, 1], &[11.0, 0.0])]),
        torchvision(),
        Case::new(
            "nothing counted",
            counted,
            vec![ramp(), random_boxes(1, 3, 16.0, 8.0).into(), integers([1], &[0])],
        ),
        Case::new(
            "one feature",
            RoiAlign { output_size: 3, sampling_ratio: 3, ..one },
            vec![random(2, [5, 1, 1]).into(), random_boxes(3, 7, 3.0, 2.5).into()],
        ),
    ];
    cases.extend(stiff());
    // (name, features, boxes, extent, side, P, ratio, count)
    let sets = [
        ("63 invocations", [9, 11, 13], 7, 50.0, 30.0, 3, 2, 7),
        ("65 invocations", [17, 11, 13], 13, 50.0, 30.0, 1, 2, 13),
        ("primes", [7, 17, 19], 11, 76.0, 60.0, 5, 3, 10),
        ("as the RoI head", [64, 40, 40], 23, 160.0, 90.0, 7, 2, 19),
        ("partly outside", [5, 8, 9], 31, 64.0, 40.0, 7, 2, u32::MAX),
        ("quads side by side", STACKED, 5, 200.0, 40.0, 2, 2, 4),
    ];
    for (seed, (name, shape, rois, extent, side, output_size, ratio, count)) in
        sets.into_iter().enumerate()
    {
        let seed = seed as u64 * 10 + 100;
        let op = RoiAlign { output_size, sampling_ratio: ratio, ..counted };
        let mut boxes = random_boxes(seed, rois, extent, side);
        if name == "partly outside" {
            boxes.data_mut().iter_mut().for_each(|x| *x -= 14.0);
        }
        let inputs = vec![random(seed + 1, shape).into(), boxes.into(), integers([1], &[count])];
        cases.push(Case::new(name, op, inputs));
    }
    // Features that differ by less than f16 can tell.
    let mut features = random(1000, [256, 40, 40]);
    features.data_mut().iter_mut().for_each(|x| *x = 1.0 + (1.0 + 0.5 * *x) / 4096.0);
    let head = RoiAlign { spatial_scale: 0.125, output_size: 7, ..counted };
    let inputs =
        vec![features.into(), random_boxes(1001, 100, 320.0, 120.0).into(), integers([1], &[100])];
    cases.push(Case::new("the RoI head", head, inputs).in_network());
    cases
}

/// Boxes of no area, of one pixel, outside, and as wide as it gets.
fn stiff() -> Vec<Case> {
    let op = RoiAlign { spatial_scale: 1.0, output_size: 2, sampling_ratio: 2, count: false };
    let ramp = || -> Value { Tensor::from_fn([1, 4, 4], |i| (10 * (i / 4) + i % 4) as f32).into() };
    let case = |name: &str, op: RoiAlign, b: [f32; 4]| {
        Case::new(name, op, vec![ramp(), values([1, 4], &b)])
    };
    let four = |bins: [f32; 4]| vec![values([1, 1, 2, 2], &bins)];
    let seven = RoiAlign { spatial_scale: 0.125, output_size: 7, ..op };
    let one = RoiAlign { output_size: 1, sampling_ratio: 1, ..op };
    let mut cases = vec![
        // All samples at (2 − 1/2, 1 − 1/2): 10 · 0.5 + 1.5.
        case("an empty box by hand", op, [2.0, 1.0, 2.0, 1.0]).by_hand(four([6.5; 4])),
        // From 1/2 to 3/2: bins around 3/4 and 5/4 on each axis.
        case("one pixel by hand", op, [1.0, 1.0, 2.0, 2.0])
            .by_hand(four([8.25, 8.75, 13.25, 13.75])),
        case("outside to the right by hand", op, [6.0, 0.0, 9.0, 3.0]).by_hand(four([0.0; 4])),
        case("outside above by hand", op, [0.0, -9.0, 3.0, -2.0]).by_hand(four([0.0; 4])),
        // From the right to the left: the bins of [1, 1, 2, 2] with columns exchanged.
        case("inverted by hand", op, [2.0, 1.0, 1.0, 2.0])
            .by_hand(four([8.75, 8.25, 13.75, 13.25])),
        // The nearest samples are 2.5e8 away.
        case("±1e9 by hand", op, [-1e9, -1e9, 1e9, 1e9]).by_hand(four([0.0; 4])),
        case("far away by hand", op, [1e9, 1e9, 1e9 + 64.0, 1e9 + 64.0]).by_hand(four([0.0; 4])),
        // Its one sample is in the middle, give or take what 1e9 rounds.
        case("one sample of ±1e9", one, [-1e9, -1e9, 1e9, 1e9]),
        case("±1e9 beside", seven, [-1e9, 3.0, 1e9, 20.0]),
        case("a thousandth of a pixel", op, [1.5, 1.5, 1.501, 1.501]),
    ];
    let mut steep = random(300, [3, 9, 8]);
    for (i, x) in steep.data_mut().iter_mut().enumerate() {
        *x = if (i / 8 + i % 8).is_multiple_of(2) { 1e30 } else { -1e30 } * (1.0 + *x / 8.0);
    }
    let inputs = vec![steep.into(), random_boxes(301, 9, 64.0, 50.0).into()];
    cases.push(Case::new("alternating signs at 1e30", seven, inputs));
    cases
}

/// `torchvision.ops.roi_align(sin(i), boxes, (2, 2), 0.25, 2, aligned=True)`.
fn torchvision() -> Case {
    let op = RoiAlign { spatial_scale: 0.25, output_size: 2, sampling_ratio: 2, count: false };
    let features = Tensor::from_fn([2, 5, 6], |i| (i as f64).sin() as f32);
    let boxes = [2.5, 1.0, 17.25, 14.0, -9.0, -5.0, 8.0, 30.0];
    let golden = [
        0.607_437,
        0.318_386_52,
        0.324_393_5,
        0.601_223_1,
        -0.391_830_62,
        0.758_758_3,
        -0.648_019,
        0.586_393_83,
        0.0,
        0.225_180_15,
        0.0,
        -0.235_089_9,
        0.0,
        -0.778_041_1,
        0.0,
        -0.398_245_84,
    ];
    Case::new("torchvision", op, vec![features.into(), values([2, 4], &boxes)])
        .by_hand(vec![values([2, 2, 2, 2], &golden)])
}
