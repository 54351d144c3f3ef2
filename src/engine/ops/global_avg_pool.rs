//! Average pooling over all of space.

use crate::engine::ops::bounds::{PARTIAL_SUMS, SumOrder, magnitude, mean_error};
use crate::engine::ops::case::{Case, STACKED, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, map_dims};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "global_avg_pool",
    takes: "map0 [C0, H, W]; optional: map1, map2",
    gives: "output [C0 + C1 + C2]",
    params: &[Param::by_tensors("maps", Range::Whole(1, MAPS.len() as u64))],
    build,
    cases,
};

/// Average of each channel over space, PyTorch's `adaptive_avg_pool2d(1)`; of several maps side by
/// side.
///
/// Inputs: `map0 [C0, H, W]`, `map1`, …; their sizes may differ. Output: `output [C0 + C1 + …]`.
#[derive(Clone, Copy, Debug)]
pub struct GlobalAvgPool {
    /// How many maps, 1 to 3.
    pub maps: usize,
}

/// Names of the inputs.
pub(crate) const MAPS: [&str; 3] = ["map0", "map1", "map2"];

impl Op for GlobalAvgPool {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("maps", self.maps.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        MAPS.into_iter().take(self.maps).collect()
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let mut total = 0;
        for (name, input) in MAPS.into_iter().zip(inputs) {
            let [channels, ..] = map_dims(self.name(), name, input)?;
            total += channels;
        }
        Ok(vec![TensorSpec::f32([total])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let mut means = Vec::new();
        for input in inputs {
            means.extend(reference::global_avg_pool(input.f32()?).into_data());
        }
        Ok(vec![Tensor::new([means.len()], means)?.into()])
    }

    /// A mean in [`PARTIAL_SUMS`] parts: one after the other, 160 × 160 values would lose 1.5e-3.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Self::averaged(inputs, |height, width| SumOrder::dealt(height * width, PARTIAL_SUMS))
    }
}

impl GlobalAvgPool {
    /// The bounds where the sum over a map of this height and width has this order.
    pub(crate) fn averaged(
        inputs: &[&Value],
        order: impl Fn(usize, usize) -> SumOrder,
    ) -> Result<Vec<Tolerance>> {
        let mut each = Vec::new();
        for input in inputs {
            let sizes = magnitude(input)?;
            let order = order(sizes.dims()[1], sizes.dims()[2]);
            let means = reference::global_avg_pool(&sizes);
            each.extend(means.data().iter().map(|m| mean_error(order, f64::from(*m))));
        }
        Ok(vec![Tolerance::Each(each)])
    }
}

fn build(_params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    let maps = MAPS.iter().filter(|name| present.contains(name)).count();
    Ok(Box::new(GlobalAvgPool { maps }))
}

fn cases() -> Vec<Case> {
    const ONE: GlobalAvgPool = GlobalAvgPool { maps: 1 };
    let mut cases = vec![
        // (1 + 2 + 3 + 6) / 4 and (0.5 − 0.5 + 8 + 0) / 4.
        Case::new(
            "2x2 by hand",
            ONE,
            vec![values([2, 2, 2], &[1.0, 2.0, 3.0, 6.0, 0.5, -0.5, 8.0, 0.0])],
        )
        .by_hand(vec![values([2], &[3.0, 2.0])]),
        // (1 + 3) / 2, then 5, then (2 + 4) / 2 and (−1 + 1) / 2.
        Case::new(
            "three maps side by side by hand",
            GlobalAvgPool { maps: 3 },
            vec![
                values([1, 1, 2], &[1.0, 3.0]),
                values([1, 1, 1], &[5.0]),
                values([2, 2, 1], &[2.0, 4.0, -1.0, 1.0]),
            ],
        )
        .by_hand(vec![values([4], &[2.0, 5.0, 3.0, 0.0])]),
    ];
    let shapes = [
        ("one of everything", [1, 1, 1]),
        ("63 pixels: a workgroup less one", [3, 9, 7]),
        ("64 pixels: a workgroup", [3, 8, 8]),
        ("65 pixels: a workgroup and one", [3, 5, 13]),
        ("prime sizes", [61, 31, 37]),
        ("as in the re-weighting", [64, 40, 40]),
        ("65 537 channels: a grid folded to two dimensions", [65_537, 1, 1]),
        ("quads side by side", STACKED),
    ];
    for (i, (name, dims)) in shapes.into_iter().enumerate() {
        cases.push(Case::new(name, ONE, vec![random(i as u64, dims).into()]));
    }
    let mut offset = random(90, [2, 160, 160]);
    offset.data_mut().iter_mut().for_each(|x| *x += 1e4);
    cases.push(Case::new("25 600 values at an offset of 1e4", ONE, vec![offset.into()]));
    cases.push(Case::new("1e30", ONE, vec![random_scaled(91, [3, 11, 13], 1e30)]));
    cases.push(Case::new("1e-30", ONE, vec![random_scaled(92, [3, 11, 13], 1e-30)]));
    // Its rounding errors all go one way: summed in order they would be past the bound.
    let third = Tensor::from_fn([1, 160, 160], |_| 1.0 / 3.0);
    cases.push(Case::new("one third everywhere", ONE, vec![third.into()]));
    for (name, maps) in [("the three scales", 3), ("the scales without the deepest", 2)] {
        let seeds = 1000..1000 + maps as u64;
        let inputs = seeds.map(|seed| one_way(seed, [256, 40, 40]).into()).collect();
        cases.push(Case::new(name, GlobalAvgPool { maps }, inputs).in_network());
    }
    cases
}
