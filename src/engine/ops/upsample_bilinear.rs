//! Bilinear interpolation to another size.

use crate::engine::ops::bounds::{magnitude, sum_error};
use crate::engine::ops::case::{Case, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, map_dims};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "upsample_bilinear",
    takes: "input [C, H, W]",
    gives: "output [C, out_height, out_width]",
    params: &[
        Param::required("out_height", "40", Range::Whole(1, MAX_EDGE as u64)),
        Param::required("out_width", "40", Range::Whole(1, MAX_EDGE as u64)),
    ],
    build,
    cases,
};

/// Longest edge: the shader's positions, twice the product of two, stay below 2³².
const MAX_EDGE: usize = 32_768;

/// PyTorch's `interpolate(mode="bilinear", align_corners=False)` to a given size.
///
/// Input: `input [C, H, W]`. Output: `output [C, out_height, out_width]`. The size may also shrink;
/// there is no antialiasing.
#[derive(Clone, Copy, Debug)]
pub struct UpsampleBilinear {
    /// Rows of the output.
    pub out_height: usize,
    /// Columns of the output.
    pub out_width: usize,
}

impl Op for UpsampleBilinear {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("out_height", self.out_height.into()), ("out_width", self.out_width.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["input"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [channels, height, width] = map_dims(name, "input", &inputs[0])?;
        if height.max(width) > MAX_EDGE {
            let expected = format!("edges of at most {MAX_EDGE}");
            return Err(Error::tensor(name, "input", expected, &inputs[0]));
        }
        Ok(vec![TensorSpec::f32([channels, self.out_height, self.out_width])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let input = inputs[0].f32()?;
        Ok(vec![reference::upsample_bilinear(input, self.out_height, self.out_width).into()])
    }

    /// A part of a pixel is 2.5 ULP off by its division, which is 5 roundings, and so is one minus
    /// it, with one more; with the products and the sum each axis makes at most 14 roundings
    /// relative to the largest of the four values that meet.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let sizes = magnitude(inputs[0])?;
        let [height, width] = [1, 2].map(|i| sizes.dims()[i]);
        let (out_height, out_width) = (self.out_height, self.out_width);
        // The two pixels around output `i`, one more on each side where the position rounds.
        let around = |i: usize, input: usize, output: usize| {
            let position = ((2 * i + 1) * input).saturating_sub(output) / (2 * output);
            position.saturating_sub(1)..(position + 2).min(input)
        };
        let each = (0..sizes.dims()[0] * out_height * out_width).map(|at| {
            let (row, x) = (at / out_width, at % out_width);
            let (channel, y) = (row / out_height, row % out_height);
            let mut largest = 0.0f32;
            for iy in around(y, height, out_height) {
                for ix in around(x, width, out_width) {
                    largest = largest.max(sizes.data()[(channel * height + iy) * width + ix]);
                }
            }
            sum_error(28, f64::from(largest))
        });
        Ok(vec![Tolerance::Each(each.collect())])
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(UpsampleBilinear {
        out_height: params.require("out_height")?,
        out_width: params.require("out_width")?,
    }))
}

fn cases() -> Vec<Case> {
    let to = |out_height, out_width| UpsampleBilinear { out_height, out_width };
    let mut cases = vec![
        // Output centres at −1/4, 1/4, 3/4 and 5/4 between the centres of 0 and 8.
        Case::new("2 to 4 by hand", to(1, 4), vec![values([1, 1, 2], &[0.0, 8.0])])
            .by_hand(vec![values([1, 1, 4], &[0.0, 2.0, 6.0, 8.0])]),
        Case::new("one pixel to 2x3 by hand", to(2, 3), vec![values([1, 1, 1], &[-2.5])])
            .by_hand(vec![values([1, 2, 3], &[-2.5; 6])]),
        // Rows at 0, 1/2, 1; columns at 0, 2/5, 1, 8/5, 2.
        Case::new(
            "2x3 to 3x5 by hand",
            to(3, 5),
            vec![values([1, 2, 3], &[1.0, 2.0, 4.0, 8.0, 16.0, 32.0])],
        )
        .by_hand(vec![values(
            [1, 3, 5],
            &[1.0, 1.4, 2.0, 3.2, 4.0, 4.5, 6.3, 9.0, 14.4, 18.0, 8.0, 11.2, 16.0, 25.6, 32.0],
        )]),
        // Each row twice, each channel by itself.
        Case::new(
            "two channels by hand",
            to(2, 2),
            vec![values([2, 1, 2], &[0.0, 8.0, 100.0, 108.0])],
        )
        .by_hand(vec![values([2, 2, 2], &[0.0, 8.0, 0.0, 8.0, 100.0, 108.0, 100.0, 108.0])]),
        // Every second pixel between two, as there is no antialiasing: 6 to 3 looks at 1/2, 5/2,
        // 9/2.
        Case::new(
            "6 to 3 by hand",
            to(1, 3),
            vec![values([1, 1, 6], &[1.0, 3.0, 5.0, 5.0, -1.0, 0.0])],
        )
        .by_hand(vec![values([1, 1, 3], &[2.0, 5.0, -0.5])]),
    ];
    let shapes = [
        ("stride 16 to 8", [31, 20, 20], to(40, 40)),
        ("stride 32 to 8", [17, 10, 10], to(40, 40)),
        ("prime sizes", [3, 7, 11], to(29, 31)),
        ("one pixel to a column", [5, 1, 1], to(13, 1)),
        ("63 outputs: a workgroup less one", [1, 4, 3], to(9, 7)),
        ("65 outputs: a workgroup and one", [1, 4, 3], to(13, 5)),
        ("same size", [3, 9, 8], to(9, 8)),
        ("smaller", [3, 23, 29], to(7, 5)),
        ("31.25 times the size", [4, 4, 4], to(125, 125)),
        ("1/31.25 of the size", [4, 125, 125], to(4, 4)),
        ("to the longest edge", [1, 1, 3], to(1, MAX_EDGE)),
        ("quads side by side", STACKED, to(67, 5)),
    ];
    for (i, (name, dims, op)) in shapes.into_iter().enumerate() {
        cases.push(Case::new(name, op, vec![random(i as u64, dims).into()]));
    }
    cases.push(Case::new("1e30", to(9, 11), vec![random_scaled(90, [3, 5, 7], 1e30)]));
    cases.push(Case::new("1e-30", to(9, 11), vec![random_scaled(91, [3, 5, 7], 1e-30)]));
    for (seed, edge) in [(1000, 20), (1001, 10)] {
        let input = one_way(seed, [256, edge, edge]).into();
        cases.push(Case::new(format!("{edge} to 40"), to(40, 40), vec![input]).in_network());
    }
    cases
}
