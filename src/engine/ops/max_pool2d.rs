//! 2-D maximum pooling.

use crate::engine::ops::case::{Case, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, map_dims};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "max_pool2d",
    takes: "input [C, H, W]",
    gives: "output [C, H', W']",
    params: &[
        Param::required("kernel", "3", Range::Whole(1, 4096)),
        Param::optional("stride", "kernel", Range::Whole(1, 4096)),
        Param::optional("padding", "0", Range::Whole(0, 2048)),
    ],
    build,
    cases,
};

/// PyTorch's `max_pool2d` with square windows; the padding is minus infinity.
///
/// Input: `input [C, H, W]`. Output: `output [C, H', W']`, `H' = (H + 2·padding − kernel) / stride
/// + 1`, rounded down.
#[derive(Clone, Copy, Debug)]
pub struct MaxPool2d {
    /// Length of the window's edges.
    pub kernel: usize,
    /// Step between windows.
    pub stride: usize,
    /// Pixels added on each side, at most half the kernel.
    pub padding: usize,
}

impl Op for MaxPool2d {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("kernel", self.kernel.into()),
            ("stride", self.stride.into()),
            ("padding", self.padding.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["input"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        if self.padding > self.kernel / 2 {
            let expected = format!("at most half the kernel ({})", self.kernel / 2);
            return Err(Error::param(name, "padding", expected, self.padding));
        }
        let [channels, height, width] = map_dims(name, "input", &inputs[0])?;
        let pooled =
            |n: usize| Some((n + 2 * self.padding).checked_sub(self.kernel)? / self.stride + 1);
        let Some((height, width)) = pooled(height).zip(pooled(width)) else {
            let expected = format!("at least the kernel ({}) with padding", self.kernel);
            return Err(Error::tensor(name, "input", expected, &inputs[0]));
        };
        Ok(vec![TensorSpec::f32([channels, height, width])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        Ok(vec![
            reference::max_pool2d(inputs[0].f32()?, self.kernel, self.stride, self.padding).into(),
        ])
    }

    /// A maximum is one of the inputs.
    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    let kernel = params.require("kernel")?;
    let stride = params.take("stride", kernel)?;
    Ok(Box::new(MaxPool2d { kernel, stride, padding: params.take("padding", 0)? }))
}

fn cases() -> Vec<Case> {
    let op = |kernel, stride, padding| MaxPool2d { kernel, stride, padding };
    let nan = f32::NAN;
    let nine: [f32; 18] = std::array::from_fn(|i| i as f32);
    let mut cases = vec![
        Case::new(
            "2x2 by hand",
            op(2, 2, 0),
            vec![values([1, 2, 4], &[1.0, 5.0, -3.0, -2.0, 4.0, 0.0, -7.0, -1.0])],
        )
        .by_hand(vec![values([1, 1, 2], &[5.0, -1.0])]),
        // All negative: padding with zeros would show.
        Case::new(
            "3x3 stride 2 padding 1 by hand",
            op(3, 2, 1),
            vec![values([1, 3, 3], &[-1.0, -2.0, -3.0, -4.0, -9.0, -6.0, -7.0, -8.0, -5.0])],
        )
        .by_hand(vec![values([1, 2, 2], &[-1.0, -2.0, -4.0, -5.0])]),
        // Windows (1, 5, 0, 3) and (5, 2, 3, 4), then the second channel's.
        Case::new(
            "two channels, not square, by hand",
            op(2, 1, 0),
            vec![values(
                [2, 2, 3],
                &[1.0, 5.0, 2.0, 0.0, 3.0, 4.0, -9.0, -8.0, -3.0, -6.0, -5.0, -4.0],
            )],
        )
        .by_hand(vec![values([2, 1, 2], &[5.0, 5.0, -5.0, -3.0])]),
        // Two quads and one more: of windows of one pixel all that comes is what was there.
        Case::new("nine channels by hand", op(1, 1, 0), vec![values([9, 1, 2], &nine)])
            .by_hand(vec![values([9, 1, 2], &nine)]),
        // An infinity is no NaN: −∞ loses, ∞ wins.
        Case::new(
            "infinities by hand",
            op(2, 2, 0),
            vec![values(
                [1, 2, 4],
                &[1.0, -f32::INFINITY, f32::INFINITY, 2.0, -2.0, -f32::INFINITY, 3.0, f32::MAX],
            )],
        )
        .by_hand(vec![values([1, 1, 2], &[1.0, f32::INFINITY])]),
        // Whoever begins with the lowest number finds that.
        Case::new("all −∞ by hand", op(2, 2, 0), vec![values([1, 2, 4], &[-f32::INFINITY; 8])])
            .by_hand(vec![values([1, 1, 2], &[-f32::INFINITY; 2])]),
        // As PyTorch's: an overflow must reach the outputs, where the host looks for it.
        Case::new(
            "a NaN stays, wherever it is in its window",
            op(2, 2, 0),
            vec![values([1, 2, 6], &[nan, 9.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 3.0, nan, 3.0, 4.0])],
        )
        .by_hand(vec![values([1, 1, 3], &[nan, nan, 4.0])]),
    ];
    let shapes = [
        ("one pixel", op(1, 1, 0), [1, 1, 1]),
        ("one pixel, padded", op(3, 2, 1), [1, 1, 1]),
        ("as after conv1, primes", op(3, 2, 1), [7, 31, 37]),
        ("even sizes leave a rest", op(3, 2, 1), [3, 10, 14]),
        ("63 outputs", op(2, 2, 0), [1, 2, 126]),
        ("65 outputs", op(2, 2, 0), [5, 2, 26]),
        ("windows apart", op(2, 5, 1), [2, 13, 17]),
        ("5x5, overlapping", op(5, 1, 2), [2, 11, 3]),
        ("quads side by side", op(3, 2, 1), STACKED),
    ];
    for (i, (name, op, dims)) in shapes.into_iter().enumerate() {
        cases.push(Case::new(name, op, vec![random(i as u64, dims).into()]));
    }
    cases.push(Case::new("1e30", op(3, 2, 1), vec![random_scaled(90, [3, 9, 9], 1e30)]));
    cases.push(Case::new("1e-30", op(3, 2, 1), vec![random_scaled(91, [3, 9, 9], 1e-30)]));
    let input = one_way(1000, [64, 160, 160]).into();
    cases.push(Case::new("after conv1", op(3, 2, 1), vec![input]).in_network());
    cases
}
