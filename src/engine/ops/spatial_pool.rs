//! CBAM's pooling over channels.

use crate::engine::ops::bounds::{SumOrder, magnitude, mean_error, sum_error};
use crate::engine::ops::case::{Case, GATED_MAPS, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "spatial_pool",
    takes: "input [C, H, W], channel_gate [C]",
    gives: "output [2, H, W]",
    params: &[],
    build,
    cases,
};

/// Invocations that share a pixel's channels.
const SLICES: usize = 8;

/// Maximum and mean over the channels of the gated map: what CBAM's spatial gate looks at.
///
/// Inputs: `input [C, H, W]`, `channel_gate [C]`. Output: `output [2, H, W]`, the maximum of
/// `input · channel_gate` in row 0, its mean in row 1. The gated map itself is not stored.
#[derive(Clone, Copy, Debug, Default)]
pub struct SpatialPool;

impl Op for SpatialPool {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["input", "channel_gate"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let [channels, height, width] = map_dims(self.name(), "input", &inputs[0])?;
        expect(self.name(), "channel_gate", &TensorSpec::f32([channels]), &inputs[1])?;
        Ok(vec![TensorSpec::f32([2, height, width])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        Ok(vec![reference::spatial_pool(inputs[0].f32()?, inputs[1].f32()?).into()])
    }

    /// The channels are dealt out to `SLICES` invocations.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Self::averaged(inputs, |channels| SumOrder::dealt(channels, SLICES))
    }
}

impl SpatialPool {
    /// The bounds where the sum over so many channels has this order. A maximum is one product, so
    /// one rounding (and the reference's own) of the largest of all; the mean is one of C products.
    pub(crate) fn averaged(
        inputs: &[&Value],
        order: impl Fn(usize) -> SumOrder,
    ) -> Result<Vec<Tolerance>> {
        let (input, gate) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let sizes = reference::spatial_pool(&input, &gate);
        let (largest, means) = sizes.data().split_at(sizes.data().len() / 2);
        let maxima = largest.iter().map(|m| sum_error(2, f64::from(*m)));
        let order = order(gate.data().len());
        let means = means.iter().map(|m| mean_error(order, f64::from(*m)));
        Ok(vec![Tolerance::Each(maxima.chain(means).collect())])
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(SpatialPool))
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        // Channels (1, −8), (6, −2), (−3, −4) by gates 1, 1/2, 2: products (1, −8), (3, −1),
        // (−6, −8); maxima 3 and −1, means −2/3 and −17/3.
        Case::new(
            "two pixels by hand",
            SpatialPool,
            vec![
                values([3, 1, 2], &[1.0, -8.0, 6.0, -2.0, -3.0, -4.0]),
                values([3], &[1.0, 0.5, 2.0]),
            ],
        )
        .by_hand(vec![values([2, 1, 2], &[3.0, -1.0, -2.0 / 3.0, -17.0 / 3.0])]),
        // Products (1, −8), (3, −1), (−6, −8), (1/2, 2).
        Case::new(
            "two pixels of four channels by hand",
            SpatialPool,
            vec![
                values([4, 1, 2], &[1.0, -8.0, 6.0, -2.0, -3.0, -4.0, 2.0, 8.0]),
                values([4], &[1.0, 0.5, 2.0, 0.25]),
            ],
        )
        .by_hand(vec![values([2, 1, 2], &[3.0, 2.0, -0.375, -3.75])]),
        // Whoever begins with the lowest number finds that to be the maximum.
        Case::new(
            "all −∞ by hand",
            SpatialPool,
            vec![Tensor::from_fn([4, 1, 2], |_| -f32::INFINITY).into(), values([4], &[0.5; 4])],
        )
        .by_hand(vec![Tensor::from_fn([2, 1, 2], |_| -f32::INFINITY).into()]),
    ];
    let shapes = [
        ("one of everything", [1, 1, 1]),
        ("prime sizes", [13, 17, 19]),
        ("7 channels, 31 pixels: a workgroup less one", [7, 1, 31]),
        ("9 channels, 33 pixels: a workgroup and one", [9, 3, 11]),
        ("deep and small, as conv5_x", [512, 10, 10]),
        ("as conv2_x", [64, 80, 80]),
        ("33 quads: one slice a quad short of the other", [132, 5, 19]),
        ("65 quads in four slices", [260, 3, 11]),
        ("quads side by side", STACKED),
    ];
    for (i, (name, dims)) in shapes.into_iter().enumerate() {
        let seed = i as u64 * 10;
        let inputs = vec![random(seed, dims).into(), random(seed + 1, [dims[0]]).into()];
        cases.push(Case::new(name, SpatialPool, inputs));
    }
    for (i, scale) in [1e30, 1e-30].into_iter().enumerate() {
        let seed = 90 + i as u64 * 10;
        let inputs = vec![random_scaled(seed, [11, 5, 7], scale), random(seed + 1, [11]).into()];
        cases.push(Case::new(format!("{scale:e}"), SpatialPool, inputs));
    }
    // Constant, zero, and one pixel of one channel: 160 · 0.5 is the largest of 16 and 5 on average.
    let gates = || -> Value { Tensor::from_fn([16], |_| 0.5).into() };
    let map = |of: &dyn Fn(usize) -> f32| -> Value { Tensor::from_fn([16, 4, 5], of).into() };
    let pixels = |of: &dyn Fn(usize) -> [f32; 2]| -> Value {
        Tensor::from_fn([2, 4, 5], |i| of(i % 20)[i / 20]).into()
    };
    let constant = map(&|_| 0.25);
    cases.push(
        Case::new("a constant map by hand", SpatialPool, vec![constant, gates()])
            .by_hand(vec![pixels(&|_| [0.125; 2])]),
    );
    cases.push(
        Case::new("zeros by hand", SpatialPool, vec![map(&|_| 0.0), gates()])
            .by_hand(vec![pixels(&|_| [0.0; 2])]),
    );
    let spike = map(&|i| if i == 11 * 20 + 7 { 160.0 } else { 0.0 });
    let want = pixels(&|at| if at == 7 { [80.0, 5.0] } else { [0.0; 2] });
    cases.push(
        Case::new("one spike by hand", SpatialPool, vec![spike, gates()]).by_hand(vec![want]),
    );
    let mut offset = random(98, [31, 6, 7]);
    offset.data_mut().iter_mut().for_each(|x| *x += 1e4);
    let inputs = vec![offset.into(), random(99, [31]).into()];
    cases.push(Case::new("an offset of 1e4", SpatialPool, inputs));
    for (seed, (channels, edge)) in GATED_MAPS.into_iter().enumerate() {
        let seed = 1000 + seed as u64 * 10;
        let inputs = vec![
            one_way(seed, [channels, edge, edge]).into(),
            one_way(seed + 1, [channels]).into(),
        ];
        let name = format!("{channels} channels of {edge} × {edge}");
        cases.push(Case::new(name, SpatialPool, inputs).in_network());
    }
    cases
}
