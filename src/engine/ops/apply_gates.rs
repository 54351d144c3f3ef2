//! CBAM's gating.

use crate::engine::ops::bounds::{SumOrder, magnitude, sigmoid_error, sum_error};
use crate::engine::ops::case::{Case, GATED_MAPS, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference::{self, ConvShape};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "apply_gates",
    takes: "input [C, H, W], channel_gate [C], pooled [2, H, W], weight [1, 2, 7, 7], bias [1]",
    gives: "output [C, H, W]",
    params: &[],
    build,
    cases,
};

/// CBAM's result: the map times its channel gate, times its spatial gate, which is the logistic function of a 7×7
/// convolution with padding 3 of what was pooled over the channels.
///
/// Inputs: `input [C, H, W]`, `channel_gate [C]`, `pooled [2, H, W]` from
/// [`SpatialPool`](crate::engine::ops::SpatialPool), `weight [1, 2, 7, 7]` and `bias [1]` with the batch norm folded
/// into them. Output: `output [C, H, W]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ApplyGates;

impl Op for ApplyGates {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["input", "channel_gate", "pooled", "weight", "bias"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [channels, height, width] = map_dims(name, "input", &inputs[0])?;
        expect(name, "channel_gate", &TensorSpec::f32([channels]), &inputs[1])?;
        expect(name, "pooled", &TensorSpec::f32([2, height, width]), &inputs[2])?;
        expect(name, "weight", &TensorSpec::f32([1, 2, 7, 7]), &inputs[3])?;
        expect(name, "bias", &TensorSpec::f32([1]), &inputs[4])?;
        Ok(vec![inputs[0].clone()])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let [input, channel_gate, pooled] = [inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?];
        let (weight, bias) = (inputs[3].f32()?, inputs[4].f32()?);
        Ok(vec![reference::apply_gates(input, channel_gate, pooled, weight, bias).into()])
    }

    /// The spatial gate's logit is a sum of 98 products and a bias. Then two products, and the reference's own
    /// rounding.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let [pooled, weight, bias] =
            [magnitude(inputs[2])?, magnitude(inputs[3])?, magnitude(inputs[4])?];
        let shape = ConvShape { stride: 1, padding: 3, dilation: 1 };
        let sizes = reference::conv2d(&pooled, &weight, Some(&bias), None, shape, false);
        let order = SumOrder::serial(98).and(1);
        let gates: Vec<f64> =
            sizes.data().iter().map(|s| sigmoid_error(order.error(f64::from(*s)))).collect();
        let (input, channel_gate) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let results = reference[0].f32()?.data().iter().enumerate();
        let each = results.map(|(i, y)| {
            let channel = f64::from(channel_gate.data()[i / gates.len()]);
            let moved = f64::from(input.data()[i]) * channel * gates[i % gates.len()];
            moved + sum_error(3, f64::from(y.abs()) + moved)
        });
        Ok(vec![Tolerance::Each(each.collect())])
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(ApplyGates))
}

/// A kernel of zeros but for one tap.
fn tap(plane: usize, y: usize, x: usize, weight: f32) -> Value {
    let at = (plane * 7 + y) * 7 + x;
    Tensor::from_fn([1, 2, 7, 7], |i| if i == at { weight } else { 0.0 }).into()
}

fn cases() -> Vec<Case> {
    // Spatial gates of 1 and 1/2.
    let two_pixels =
        || vec![values([2, 1, 2], &[1e4, 0.0, 0.0, 0.0]), tap(0, 3, 3, 1.0), values([1], &[0.0])];
    let by_hand = |name: &str, channels: usize, input: &[f32], gates: &[f32], output: &[f32]| {
        let mut inputs = vec![values([channels, 1, 2], input), values([channels], gates)];
        inputs.extend(two_pixels());
        Case::new(name, ApplyGates, inputs).by_hand(vec![values([channels, 1, 2], output)])
    };
    let mut cases = vec![
        by_hand(
            "two channels of two pixels by hand",
            2,
            &[1.0, 2.0, -3.0, 4.0],
            &[0.5, 0.25],
            &[0.5, 0.5, -0.75, 0.5],
        ),
        by_hand(
            "four channels of two pixels by hand",
            4,
            &[1.0, 2.0, -3.0, 4.0, 5.0, 6.0, 0.5, -8.0],
            &[0.5, 0.25, 1.0, 2.0],
            &[0.5, 0.5, -0.75, 0.5, 5.0, 3.0, 1.0, -8.0],
        ),
    ];
    // Four channels of ones with channel gates that are powers of two show the spatial gate.
    let channels = [1.0, 2.0, -1.0, 0.5];
    let mut gate =
        |name: &str, pooled: Value, weight: Value, bias: f32, expected: Option<&[f32]>| {
            let dims = pooled.spec().shape.0;
            let area = dims[1] * dims[2];
            let ones = Tensor::from_fn([4, dims[1], dims[2]], |_| 1.0).into();
            let inputs = vec![ones, values([4], &channels), pooled, weight, values([1], &[bias])];
            let case = Case::new(name, ApplyGates, inputs);
            cases.push(match expected {
                None => case,
                Some(gates) => {
                    let of = |i: usize| gates[i % area] * channels[i / area];
                    case.by_hand(vec![Tensor::from_fn([4, dims[1], dims[2]], of).into()])
                }
            });
        };
    let ln3 = 1.098_612_3;
    // Tap (0, 6) of the second plane looks 3 rows up and 3 columns to the right: only the last
    // row's first pixel finds the map's upper right corner, 2 there; the rest is padding. The
    // bias ln 3 makes 3/4, and ln 3 − ln 3 · 2 / 2 makes 1/2.
    let corner = Tensor::from_fn([2, 4, 4], |i| if i == 19 { 2.0 } else { 0.0 });
    let gates: [f32; 16] = std::array::from_fn(|i| if i == 12 { 0.5 } else { 0.75 });
    let in_corner = tap(1, 0, 6, -ln3 / 2.0);
    gate("one tap in a corner by hand", corner.into(), in_corner, ln3, Some(&gates));
    let far = values([2, 1, 4], &[1e4, -1e4, 1e30, -1e30, 0.0, 0.0, 0.0, 0.0]);
    gate("saturated by hand", far, tap(0, 3, 3, 1.0), 0.0, Some(&[1.0, 0.0, 1.0, 0.0]));
    let logits = [88.0, -88.0, 104.0, -104.0, 1e3, -1e3];
    let map = Tensor::from_fn([2, 1, 6], |i| if i < 6 { logits[i] } else { 7.0 });
    let gates = [1.0, 6.054_602e-39, 1.0, 0.0, 1.0, 0.0];
    gate("±88, ±104, ±1e3 by hand", map.into(), tap(0, 3, 3, 1.0), 0.0, Some(&gates));
    // What is pooled is one value, none, and one pixel.
    let kernel = || -> Value { random(90, [1, 2, 7, 7]).into() };
    let flat = |value: f32, at: Option<usize>| -> Value {
        let spike = |i: usize| if at.is_none_or(|at| at == i) { value } else { 0.0 };
        Tensor::from_fn([2, 11, 13], spike).into()
    };
    gate("zeros by hand", flat(0.0, None), kernel(), 0.0, Some(&[0.5; 143]));
    gate("a constant map", flat(0.1, None), kernel(), 0.25, None);
    gate("one spike", flat(1e4, Some(200)), kernel(), 0.25, None);
    gate("steep", random_scaled(91, [2, 9, 11], 100.0), kernel(), 0.25, None);
    gate("pooled of 1e-30", random_scaled(92, [2, 9, 11], 1e-30), kernel(), 0.25, None);

    let shapes = [
        ("one of everything", [1, 1, 1], 1.0),
        ("one pixel of four channels", [4, 1, 1], 1.0),
        ("narrower than the kernel", [4, 5, 2], 1.0),
        ("prime sizes", [13, 17, 19], 1.0),
        ("63 spans: a workgroup less one", [8, 7, 72], 1.0),
        ("65 spans: a workgroup and one", [3, 5, 97], 1.0),
        ("65 spans of a quad", [4, 5, 97], 1.0),
        ("1e30", [3, 5, 7], 1e30),
        ("1e-30", [3, 5, 7], 1e-30),
        ("twelve channels of prime sizes", [12, 17, 19], 1.0),
        ("quads side by side", STACKED, 1.0),
    ];
    for (i, (name, dims, scale)) in shapes.into_iter().enumerate() {
        let seed = i as u64 * 10;
        let inputs = vec![
            random_scaled(seed, dims, scale),
            random(seed + 1, [dims[0]]).into(),
            random_scaled(seed + 2, [2, dims[1], dims[2]], 0.1),
            random(seed + 3, [1, 2, 7, 7]).into(),
            random(seed + 4, [1]).into(),
        ];
        cases.push(Case::new(name, ApplyGates, inputs));
    }
    for (seed, (channels, edge)) in GATED_MAPS.into_iter().enumerate() {
        let seed = 1000 + seed as u64 * 10;
        let pooled = one_way(seed + 2, [2, edge, edge]);
        let weight = one_way(seed + 3, [1, 2, 7, 7]);
        // A bias that takes the middle's logit back to where the gate is steep.
        let tap = |i: usize| {
            let (plane, y, x) = (i / 49, edge / 2 + i / 7 % 7 - 3, edge / 2 + i % 7 - 3);
            weight.data()[i] * pooled.data()[(plane * edge + y) * edge + x]
        };
        let bias = -(0..98).map(tap).sum::<f32>();
        let inputs = vec![
            one_way(seed, [channels, edge, edge]).into(),
            one_way(seed + 1, [channels]).into(),
            pooled.into(),
            weight.into(),
            values([1], &[bias]),
        ];
        let name = format!("{channels} channels of {edge} × {edge}");
        cases.push(Case::new(name, ApplyGates, inputs).in_network());
    }
    cases
}
