//! CBAM's spatial gate.

use crate::engine::ops::bounds::{SumOrder, magnitude, sigmoid_error};
use crate::engine::ops::case::{Case, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference::{self, ConvShape};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "spatial_gate",
    takes: "pooled [2, H, W], weight [1, 2, 7, 7], bias [1]",
    gives: "output [1, H, W]",
    params: &[],
    build,
    cases,
};

/// CBAM's spatial gate: the logistic function of a 7×7 convolution with padding 3.
///
/// Inputs: `pooled [2, H, W]` from [`SpatialPool`](crate::engine::ops::SpatialPool), `weight [1, 2, 7, 7]`
/// and `bias [1]` with the batch norm folded into them. Output: `output [1, H, W]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct SpatialGate;

impl Op for SpatialGate {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["pooled", "weight", "bias"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [maps, height, width] = map_dims(name, "pooled", &inputs[0])?;
        if maps != 2 {
            return Err(Error::tensor(name, "pooled", "[2, H, W]", &inputs[0]));
        }
        expect(name, "weight", &TensorSpec::f32([1, 2, 7, 7]), &inputs[1])?;
        expect(name, "bias", &TensorSpec::f32([1]), &inputs[2])?;
        Ok(vec![TensorSpec::f32([1, height, width])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let [pooled, weight, bias] = [inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?];
        Ok(vec![reference::spatial_gate(pooled, weight, bias).into()])
    }

    /// The logit is a sum of 98 products and a bias.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let [pooled, weight, bias] =
            [magnitude(inputs[0])?, magnitude(inputs[1])?, magnitude(inputs[2])?];
        let shape = ConvShape { stride: 1, padding: 3, dilation: 1 };
        let sizes = reference::conv2d(&pooled, &weight, Some(&bias), None, shape, false);
        let order = SumOrder::serial(98).and(1);
        let each = sizes.data().iter().map(|s| sigmoid_error(order.error(f64::from(*s))));
        Ok(vec![Tolerance::Each(each.collect())])
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(SpatialGate))
}

fn cases() -> Vec<Case> {
    // A kernel of zeros but for one tap.
    let tap = |plane: usize, y: usize, x: usize, weight: f32| -> Value {
        let at = (plane * 7 + y) * 7 + x;
        Tensor::from_fn([1, 2, 7, 7], |i| if i == at { weight } else { 0.0 }).into()
    };
    let ln3 = 1.098_612_3;
    let mut cases = vec![
        // Tap (0, 6) of the second plane looks 3 rows up and 3 columns to the right: only the last
        // row's first pixel finds the map's upper right corner, 2 there; the rest is padding. The
        // bias ln 3 makes 3/4, and ln 3 − ln 3 · 2 / 2 makes 1/2.
        Case::new(
            "one tap in a corner by hand",
            SpatialGate,
            vec![
                values(
                    [2, 4, 4],
                    &std::array::from_fn::<f32, 32, _>(|i| if i == 19 { 2.0 } else { 0.0 }),
                ),
                tap(1, 0, 6, -ln3 / 2.0),
                values([1], &[ln3]),
            ],
        )
        .by_hand(vec![values(
            [1, 4, 4],
            &std::array::from_fn::<f32, 16, _>(|i| if i == 12 { 0.5 } else { 0.75 }),
        )]),
        Case::new(
            "saturated by hand",
            SpatialGate,
            vec![
                values([2, 1, 4], &[1e4, -1e4, 1e30, -1e30, 0.0, 0.0, 0.0, 0.0]),
                tap(0, 3, 3, 1.0),
                values([1], &[0.0]),
            ],
        )
        .by_hand(vec![values([1, 1, 4], &[1.0, 0.0, 1.0, 0.0])]),
    ];
    let logits = [88.0, -88.0, 104.0, -104.0, 1e3, -1e3];
    let map = Tensor::from_fn([2, 1, 6], |i| if i < 6 { logits[i] } else { 7.0 });
    cases.push(
        Case::new(
            "±88, ±104, ±1e3 by hand",
            SpatialGate,
            vec![map.into(), tap(0, 3, 3, 1.0), values([1], &[0.0])],
        )
        .by_hand(vec![values([1, 1, 6], &[1.0, 6.054_602e-39, 1.0, 0.0, 1.0, 0.0])]),
    );
    // A map of one value, of none, and of one pixel.
    let kernel = || -> Value { random(90, [1, 2, 7, 7]).into() };
    let flat = |value: f32, at: Option<usize>| -> Value {
        let spike = |i: usize| if at.is_none_or(|at| at == i) { value } else { 0.0 };
        Tensor::from_fn([2, 11, 13], spike).into()
    };
    let zeros = vec![flat(0.0, None), kernel(), values([1], &[0.0])];
    cases.push(
        Case::new("zeros by hand", SpatialGate, zeros)
            .by_hand(vec![values([1, 11, 13], &[0.5; 143])]),
    );
    for (name, map) in [("a constant map", flat(0.1, None)), ("one spike", flat(1e4, Some(200)))] {
        cases.push(Case::new(name, SpatialGate, vec![map, kernel(), values([1], &[0.25])]));
    }
    let shapes = [
        ("one pixel", [2, 1, 1], 1.0),
        ("narrower than the kernel", [2, 5, 2], 1.0),
        ("prime sizes", [2, 17, 19], 0.1),
        ("63 spans: a workgroup less one", [2, 7, 72], 0.1),
        ("65 spans: a workgroup and one", [2, 5, 97], 0.1),
        ("as conv2_x", [2, 80, 80], 0.1),
        ("1e-30", [2, 9, 11], 1e-30),
        ("steep", [2, 9, 11], 100.0),
    ];
    for (i, (name, dims, scale)) in shapes.into_iter().enumerate() {
        let seed = i as u64 * 10;
        let inputs = vec![
            random_scaled(seed, dims, scale),
            random(seed + 1, [1, 2, 7, 7]).into(),
            random(seed + 2, [1]).into(),
        ];
        cases.push(Case::new(name, SpatialGate, inputs));
    }
    for (i, edge) in [160, 80, 40, 20, 10].into_iter().enumerate() {
        let seed = 1000 + i as u64 * 10;
        let pooled = one_way(seed, [2, edge, edge]);
        let weight = one_way(seed + 1, [1, 2, 7, 7]);
        // A bias that takes the middle's logit back to where the gate is steep.
        let tap = |i: usize| {
            let (plane, y, x) = (i / 49, edge / 2 + i / 7 % 7 - 3, edge / 2 + i % 7 - 3);
            weight.data()[i] * pooled.data()[(plane * edge + y) * edge + x]
        };
        let bias = -(0..98).map(tap).sum::<f32>();
        let inputs = vec![pooled.into(), weight.into(), values([1], &[bias])];
        cases.push(Case::new(format!("{edge} × {edge}"), SpatialGate, inputs).in_network());
    }
    cases
}
