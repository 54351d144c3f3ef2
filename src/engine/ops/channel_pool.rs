//! CBAM's pooling over space.

use crate::engine::ops::bounds::{PARTIAL_SUMS, SumOrder, magnitude, mean_error};
use crate::engine::ops::case::{Case, GATED_MAPS, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, map_dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "channel_pool",
    takes: "input [C, H, W]",
    gives: "output [2, C]",
    params: &[],
    build,
    cases,
};

/// Average and maximum of each channel over space: what CBAM's channel gate looks at.
///
/// Input: `input [C, H, W]`. Output: `output [2, C]`, the averages in row 0, the maxima in row 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct ChannelPool;

impl Op for ChannelPool {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["input"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let [channels, ..] = map_dims(self.name(), "input", &inputs[0])?;
        Ok(vec![TensorSpec::f32([2, channels])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        Ok(vec![reference::channel_pool(inputs[0].f32()?).into()])
    }

    /// Averages in [`PARTIAL_SUMS`] parts: one after the other, 160 × 160 values would lose 1.5e-3.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Self::averaged(inputs, |height, width| SumOrder::dealt(height * width, PARTIAL_SUMS))
    }
}

impl ChannelPool {
    /// The bounds where the sum over a map of this height and width has this order. Maxima are
    /// inputs, so exact.
    pub(crate) fn averaged(
        inputs: &[&Value],
        order: impl Fn(usize, usize) -> SumOrder,
    ) -> Result<Vec<Tolerance>> {
        let sizes = magnitude(inputs[0])?;
        let [channels, height, width] = [0, 1, 2].map(|i| sizes.dims()[i]);
        let means = reference::global_avg_pool(&sizes);
        let order = order(height, width);
        let averages = means.data().iter().map(|m| mean_error(order, f64::from(*m)));
        Ok(vec![Tolerance::Each(averages.chain(vec![0.0; channels]).collect())])
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(ChannelPool))
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        // (1 + 2 + 3 + 6) / 4 = 3; (−1 − 2 − 3 − 10) / 4 = −4, whose maximum is no zero.
        Case::new(
            "2x2 by hand",
            ChannelPool,
            vec![values([2, 2, 2], &[1.0, 2.0, 3.0, 6.0, -1.0, -2.0, -3.0, -10.0])],
        )
        .by_hand(vec![values([2, 2], &[3.0, -4.0, 6.0, -1.0])]),
        // Whoever begins with the lowest number finds that to be the maximum.
        Case::new(
            "all −∞ by hand",
            ChannelPool,
            vec![values([2, 1, 2], &[1.0, 3.0, -f32::INFINITY, -f32::INFINITY])],
        )
        .by_hand(vec![values([2, 2], &[2.0, -f32::INFINITY, 3.0, -f32::INFINITY])]),
    ];
    let shapes = [
        ("one of everything", [1, 1, 1]),
        ("63 pixels: a workgroup less one", [3, 9, 7]),
        ("64 pixels: a workgroup", [3, 8, 8]),
        ("65 pixels: a workgroup and one", [3, 5, 13]),
        ("prime sizes", [17, 31, 37]),
        ("deep and small, as conv5_x", [512, 10, 10]),
        ("wide, as conv1", [5, 160, 160]),
        ("65 537 channels: a grid folded to two dimensions", [65_537, 1, 1]),
        ("quads side by side", STACKED),
        ("41 rows: some invocations have one less", [6, 41, 9]),
    ];
    for (i, (name, dims)) in shapes.into_iter().enumerate() {
        cases.push(Case::new(name, ChannelPool, vec![random(i as u64, dims).into()]));
    }
    let mut offset = random(90, [3, 160, 160]);
    offset.data_mut().iter_mut().for_each(|x| *x += 1e4);
    let last = Tensor::from_fn([1, 11, 13], |i| if i == 142 { 7.0 } else { -1.0 });
    cases.push(Case::new("an offset of 1e4", ChannelPool, vec![offset.into()]));
    cases.push(Case::new("maximum in the last pixel", ChannelPool, vec![last.into()]));
    cases.push(Case::new("1e30", ChannelPool, vec![random_scaled(91, [3, 11, 13], 1e30)]));
    cases.push(Case::new("1e-30", ChannelPool, vec![random_scaled(92, [3, 11, 13], 1e-30)]));
    // Its rounding errors all go one way: summed in order they would be past the bound.
    cases.push(
        Case::new("zeros by hand", ChannelPool, vec![Tensor::<f32>::zeros([4, 9, 7]).into()])
            .by_hand(vec![values([2, 4], &[0.0; 8])]),
    );
    // One of 256 pixels: means of ±1, and a largest of 256 and of 0.
    let spikes = Tensor::from_fn([2, 16, 16], |i| match i {
        91 => 256.0,
        300 => -256.0,
        _ => 0.0,
    });
    cases.push(
        Case::new("single spikes by hand", ChannelPool, vec![spikes.into()])
            .by_hand(vec![values([2, 2], &[1.0, -1.0, 256.0, 0.0])]),
    );
    let third = Tensor::from_fn([1, 160, 160], |_| 1.0 / 3.0);
    cases.push(Case::new("one third everywhere", ChannelPool, vec![third.into()]));
    for (seed, (channels, edge)) in GATED_MAPS.into_iter().enumerate() {
        let input = one_way(1000 + seed as u64, [channels, edge, edge]).into();
        let name = format!("{channels} channels of {edge} × {edge}");
        cases.push(Case::new(name, ChannelPool, vec![input]).in_network());
    }
    cases
}
