//! Weighted sum of maps.

use crate::engine::ops::bounds::{SumOrder, magnitude};
use crate::engine::ops::case::{Case, one_way, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::Result;

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "weighted_sum",
    takes: "weights [K], map0 [C, H, W]; optional: map1 to map4",
    gives: "output [C, H, W]",
    params: &[Param::by_tensors("maps", Range::Whole(1, MAPS.len() as u64))],
    build,
    cases,
};

/// The maps by name. With the weights and the output they take seven of the eight storage buffers
/// that a stage has.
pub(crate) const MAPS: [&str; 5] = ["map0", "map1", "map2", "map3", "map4"];

/// RW-Net's fused map: `Σ weights[k] · mapk`.
///
/// Inputs: `weights [K]`, then `map0` … `map{K−1}`, each `[C, H, W]`; K is 1 to 5. Output:
/// `output [C, H, W]`.
#[derive(Clone, Copy, Debug)]
pub struct WeightedSum {
    /// How many maps: 3 in SMR-Net.
    pub maps: usize,
}

impl Op for WeightedSum {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("maps", self.maps.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        [&["weights"], &MAPS[..self.maps.min(MAPS.len())]].concat()
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        expect(name, "weights", &TensorSpec::f32([self.maps]), &inputs[0])?;
        map_dims(name, "map0", &inputs[1])?;
        for (map, spec) in MAPS.iter().zip(&inputs[1..]) {
            expect(name, map, &inputs[1], spec)?;
        }
        Ok(vec![inputs[1].clone()])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let maps = inputs[1..].iter().map(|v| v.f32()).collect::<Result<Vec<_>>>()?;
        Ok(vec![reference::weighted_sum(inputs[0].f32()?, &maps).into()])
    }

    /// A sum of K products.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let sizes = inputs.iter().map(|v| magnitude(v)).collect::<Result<Vec<_>>>()?;
        let sums = reference::weighted_sum(&sizes[0], &sizes[1..].iter().collect::<Vec<_>>());
        let order = SumOrder::serial(self.maps);
        let each = sums.data().iter().map(|s| order.error(f64::from(*s)));
        Ok(vec![Tolerance::Each(each.collect())])
    }
}

fn build(_params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    let maps = MAPS.iter().filter(|name| present.contains(name)).count();
    Ok(Box::new(WeightedSum { maps }))
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        // 0.5·1 + 0.25·8 − 2·1 = 0.5; 0.5·2 + 0.25·4 − 2·(−3) = 8.
        Case::new(
            "three maps by hand",
            WeightedSum { maps: 3 },
            vec![
                values([3], &[0.5, 0.25, -2.0]),
                values([1, 1, 2], &[1.0, 2.0]),
                values([1, 1, 2], &[8.0, 4.0]),
                values([1, 1, 2], &[1.0, -3.0]),
            ],
        )
        .by_hand(vec![values([1, 1, 2], &[0.5, 8.0])]),
        // 1 + 20 + 300 + 4000 + 50000: each map counts once, in its place.
        Case::new(
            "five maps by hand",
            WeightedSum { maps: 5 },
            vec![
                values([5], &[1.0, 2.0, 3.0, 4.0, 5.0]),
                values([1, 1, 1], &[1.0]),
                values([1, 1, 1], &[10.0]),
                values([1, 1, 1], &[100.0]),
                values([1, 1, 1], &[1e3]),
                values([1, 1, 1], &[1e4]),
            ],
        )
        .by_hand(vec![values([1, 1, 1], &[54_321.0])]),
    ];
    // One scale by e^80: of the others nothing is left.
    let map = |value: f32| values([4, 1, 2], &[value; 8]);
    let weights = values([3], &[1.804_851_4e-35, 1.0, 1.804_851_4e-35]);
    cases.push(
        Case::new(
            "one scale by e^80, by hand",
            WeightedSum { maps: 3 },
            vec![weights, map(1e4), map(0.25), map(-1e4)],
        )
        .by_hand(vec![map(0.25)]),
    );
    let shapes = [
        ("one map, one element", 1, [1, 1, 1], 1.0),
        ("two maps, 63 elements: a workgroup less one", 2, [7, 3, 3], 1.0),
        ("four maps, 65 elements: a workgroup and one", 4, [13, 1, 5], 1.0),
        ("as the fusion", 3, [256, 40, 40], 1.0),
        ("prime sizes", 3, [13, 17, 19], 1.0),
        ("1e30", 3, [3, 5, 7], 1e30),
        ("1e-30", 3, [3, 5, 7], 1e-30),
    ];
    for (i, (name, maps, dims, scale)) in shapes.into_iter().enumerate() {
        let seed = i as u64 * 10;
        let mut inputs: Vec<Value> = vec![random(seed, [maps]).into()];
        inputs.extend((0..maps).map(|k| random_scaled(seed + 1 + k as u64, dims, scale)));
        cases.push(Case::new(name, WeightedSum { maps }, inputs));
    }
    for (name, maps) in [("the three scales", 3), ("the scales without the deepest", 2)] {
        let mut inputs: Vec<Value> = vec![one_way(1000, [maps]).into()];
        let seeds = 1001..1001 + maps as u64;
        inputs.extend(seeds.map(|seed| Value::from(one_way(seed, [256, 40, 40]))));
        cases.push(Case::new(name, WeightedSum { maps }, inputs).in_network());
    }
    cases
}
