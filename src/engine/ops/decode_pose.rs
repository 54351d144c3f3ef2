//! The pose of each detection.

use crate::engine::ops::case::{Case, integers, one_way, random, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance, dims};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "decode_pose",
    takes: "rows [K, 6], count u32 [1]",
    gives: "output [K, 5]",
    params: &[],
    build,
    cases,
};

/// Numbers of a row: a vector along the direction; the logarithms of the variances of the
/// direction in rad² and of the centre along x and y in mm²; the logit of being whole.
const TAKEN: usize = 6;
/// Numbers of a pose.
const GIVEN: usize = 5;

/// The pose of each detection, from its row of the RoI head.
///
/// Inputs: `rows` f32 `[K, 6]`, (c, s, v, vx, vy, w) each; `count` u32 `[1]`, rows in use. Output:
/// `output` f32 `[K, 5]`: direction and its standard deviation in degrees, the centre's standard
/// deviations along x and y in millimetres, the probability that the part is whole; rows behind the
/// count are not written. [`reference::decode_pose`] has the formulas.
#[derive(Clone, Copy, Debug, Default)]
pub struct DecodePose {}

impl Op for DecodePose {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["rows", "count"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let [rows, columns] = dims(self.name(), "rows", &inputs[0], DType::F32)?;
        if rows == 0 || columns != TAKEN {
            return Err(Error::tensor(self.name(), "rows", "f32 [K, 6]", &inputs[0]));
        }
        expect_count(self.name(), Some(&inputs[1]))?;
        Ok(vec![TensorSpec::f32([rows, GIVEN])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let mut output = Tensor::zeros(specs[0].shape.clone());
        let rows = rows(inputs)?;
        for (out, row) in output.data_mut().as_chunks_mut::<GIVEN>().0.iter_mut().zip(rows) {
            *out = reference::decode_pose(*row).map(|v| v as f32);
        }
        Ok(vec![output.into()])
    }

    /// The direction comes from a quotient (2.5 ULP), a polynomial that is off by 2e-7 rad at most and
    /// at most six additions and products of numbers up to π: 40ε in all, in radians. e^x is off by
    /// (3 + 2|x|) ULP, each at most 2ε; the logistic function has it in numerator and denominator.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let output = reference[0].f32()?;
        let mut bounds = vec![0.0; output.data().len()];
        let rows = rows(inputs)?;
        let (values, _) = output.data().as_chunks::<GIVEN>();
        for ((bounds, v), row) in bounds.as_chunks_mut::<GIVEN>().0.iter_mut().zip(values).zip(rows)
        {
            let exponential = |value: f32, unit: f64| {
                let power = (f64::from(value) / unit).ln().abs();
                f64::from(value) * EPS * (12.0 + 4.0 * power)
            };
            let logit = f64::from(row[5]).abs();
            *bounds = [
                (40.0 * EPS).to_degrees(),
                exponential(v[1], 1f64.to_degrees()),
                exponential(v[2], 1.0),
                exponential(v[3], 1.0),
                f64::from(v[4]) * EPS * (22.0 + 8.0 * logit) + 2.0 * f64::from(f32::MIN_POSITIVE),
            ];
        }
        Ok(vec![Tolerance::Each(bounds)])
    }

    fn defined(&self, _reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        vec![rows(inputs).map_or(0, |rows| rows.len() * GIVEN)]
    }
}

/// The rows in use.
fn rows<'a>(inputs: &[&'a Value]) -> Result<&'a [[f32; TAKEN]]> {
    let (rows, _) = inputs[0].f32()?.data().as_chunks::<TAKEN>();
    Ok(&rows[..live(Some(inputs[1]), rows.len())?])
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(DecodePose {}))
}

fn cases() -> Vec<Case> {
    let op = DecodePose {};
    let count = |n: u32| integers([1], &[n]);
    let row = |r: [f32; 6]| values([1, 6], &r);
    let degree = 1f32.to_degrees();
    let ln2 = std::f32::consts::LN_2;
    let mut cases = vec![
        // e^(2 ln 2 / 2) = 2; 1/(1 + e^-ln 3).
        Case::new(
            "by hand",
            op,
            vec![
                values(
                    [3, 6],
                    &[
                        3.0,
                        3.0,
                        -2.0 * ln2,
                        0.0,
                        0.0,
                        0.0,
                        0.0,
                        -2.0,
                        0.0,
                        0.0,
                        2.0 * ln2,
                        3f32.ln(),
                        1.0,
                        1.0,
                        1.0,
                        1.0,
                        1.0,
                        1.0,
                    ],
                ),
                count(2),
            ],
        )
        .by_hand(vec![values(
            [3, 5],
            &[
                45.0,
                0.5 * degree,
                1.0,
                1.0,
                0.5,
                -90.0,
                degree,
                1.0,
                2.0,
                0.75,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
            ],
        )]),
        Case::new(
            "a count past the last by hand",
            op,
            vec![row([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), count(u32::MAX)],
        )
        .by_hand(vec![values([1, 5], &[180.0, degree, 1.0, 1.0, 0.5])]),
        // e^-6; π/√3 is 180/√3 = 103.923 degrees; √100. A logit of ±200: e^-200 is below every f32.
        Case::new(
            "the clamps by hand",
            op,
            vec![
                values(
                    [2, 6],
                    &[1.0, 0.0, -99.0, -13.0, 3e38, 200.0, 1.0, -0.0, 3e38, 7.0, -3e38, -200.0],
                ),
                count(2),
            ],
        )
        .by_hand(vec![values(
            [2, 5],
            &[
                0.0,
                0.142_022_04,
                0.002_478_752_2,
                10.0,
                1.0,
                0.0,
                103.923_05,
                10.0,
                0.002_478_752_2,
                0.0,
            ],
        )]),
        Case::new("no direction by hand", op, vec![row([0.0; 6]), count(1)])
            .by_hand(vec![values([1, 5], &[0.0, degree, 1.0, 1.0, 0.5])]),
        Case::new(
            "subnormal vectors by hand",
            op,
            vec![row([-1e-45, 1e-40, 0.0, 0.0, 0.0, 0.0]), count(1)],
        )
        .by_hand(vec![values([1, 5], &[0.0, degree, 1.0, 1.0, 0.5])]),
        Case::new("nothing counted", op, vec![random(1, [3, 6]).into(), count(0)]),
    ];
    // Every direction by 1.25 degrees, of vectors as short and as long as can be.
    for (name, length) in
        [("all directions", 1.0), ("of length 1e-37", 1e-37), ("of length 3e38", 3e38)]
    {
        let rows = Tensor::from_fn([288, 6], |i| {
            let angle = (i / 6) as f64 * 1.25f64.to_radians();
            match i % 6 {
                0 => (angle.cos() * length) as f32,
                1 => (angle.sin() * length) as f32,
                _ => (i % 13) as f32 - 6.0,
            }
        });
        cases.push(Case::new(name, op, vec![rows.into(), count(288)]));
    }
    for (seed, n) in [(10, 63), (20, 64), (30, 65)] {
        let mut rows = random(seed, [n, 6]);
        rows.data_mut().iter_mut().for_each(|x| *x *= 8.0);
        let inputs = vec![rows.into(), count(n as u32)];
        cases.push(Case::new(format!("{n} detections"), op, inputs));
    }
    let inputs = vec![one_way(1000, [100, 6]).into(), count(100)];
    cases.push(Case::new("the detections", op, inputs).in_network());
    cases
}
