//! CBAM's gating.

use crate::engine::ops::bounds::sum_error;
use crate::engine::ops::case::{Case, GATED_MAPS, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::Result;

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "apply_gates",
    takes: "input [C, H, W], channel_gate [C], spatial_gate [1, H, W]",
    gives: "output [C, H, W]",
    params: &[],
    build,
    cases,
};

/// CBAM's result: the map times its channel gate, times its spatial gate.
///
/// Inputs: `input [C, H, W]`, `channel_gate [C]`, `spatial_gate [1, H, W]`. Output:
/// `output [C, H, W]`.
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
        vec!["input", "channel_gate", "spatial_gate"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [channels, height, width] = map_dims(name, "input", &inputs[0])?;
        expect(name, "channel_gate", &TensorSpec::f32([channels]), &inputs[1])?;
        expect(name, "spatial_gate", &TensorSpec::f32([1, height, width]), &inputs[2])?;
        Ok(vec![inputs[0].clone()])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let [input, channel, spatial] = [inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?];
        Ok(vec![reference::apply_gates(input, channel, spatial).into()])
    }

    /// Two products, and the reference's own rounding.
    fn tolerance(&self, _inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let results = reference[0].f32()?.data();
        let each = results.iter().map(|y| sum_error(3, f64::from(y.abs())));
        Ok(vec![Tolerance::Each(each.collect())])
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(ApplyGates))
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        Case::new(
            "two channels of two pixels by hand",
            ApplyGates,
            vec![
                values([2, 1, 2], &[1.0, 2.0, -3.0, 4.0]),
                values([2], &[0.5, 0.25]),
                values([1, 1, 2], &[1.0, 0.5]),
            ],
        )
        .by_hand(vec![values([2, 1, 2], &[0.5, 0.5, -0.75, 0.5])]),
        Case::new(
            "four channels of two pixels by hand",
            ApplyGates,
            vec![
                values([4, 1, 2], &[1.0, 2.0, -3.0, 4.0, 5.0, 6.0, 0.5, -8.0]),
                values([4], &[0.5, 0.25, 1.0, 2.0]),
                values([1, 1, 2], &[1.0, 0.5]),
            ],
        )
        .by_hand(vec![values([4, 1, 2], &[0.5, 0.5, -0.75, 0.5, 5.0, 3.0, 1.0, -8.0])]),
    ];
    let shapes = [
        ("one of everything", [1, 1, 1], 1.0),
        ("prime sizes", [13, 17, 19], 1.0),
        ("63 elements: a workgroup less one", [7, 3, 3], 1.0),
        ("65 elements: a workgroup and one", [13, 1, 5], 1.0),
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
            random(seed + 2, [1, dims[1], dims[2]]).into(),
        ];
        cases.push(Case::new(name, ApplyGates, inputs));
    }
    // More workgroups than one dimension of a grid may have.
    let inputs = vec![
        random(90, [41, 320, 321]).into(),
        random(91, [41]).into(),
        random(92, [1, 320, 321]).into(),
    ];
    cases.push(Case::new("a grid folded to two dimensions", ApplyGates, inputs));
    for (seed, (channels, edge)) in GATED_MAPS.into_iter().enumerate() {
        let seed = 1000 + seed as u64 * 10;
        let inputs = vec![
            one_way(seed, [channels, edge, edge]).into(),
            one_way(seed + 1, [channels]).into(),
            one_way(seed + 2, [1, edge, edge]).into(),
        ];
        let name = format!("{channels} channels of {edge} × {edge}");
        cases.push(Case::new(name, ApplyGates, inputs).in_network());
    }
    cases
}
