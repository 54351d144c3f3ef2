//! Softmax over rows.

use crate::engine::ops::case::{Case, integers, one_way, random, random_scaled, values};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, Shape, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "softmax",
    takes: "input [R, N] or [N]; optional: count u32 [1]",
    gives: "output like input",
    params: &[Param::optional("temperature", "1", Range::Number(1e-3, 1e3))],
    build,
    cases,
};

/// Softmax of input / temperature over the last dimension, with the row's maximum subtracted first.
///
/// Inputs: `input` f32 `[R, N]` or `[N]`, one row; `count` u32 `[1]` if `count`. Output: `output` f32 like
/// `input`; rows behind the count are not written.
#[derive(Clone, Copy, Debug)]
pub struct Softmax {
    /// What the input is divided by; 1 by default. A higher one makes the shares more even (Guo et al.,
    /// On Calibration of Modern Neural Networks, 2017).
    pub temperature: f32,
    /// Whether a count limits the rows.
    pub count: bool,
}

impl Default for Softmax {
    fn default() -> Self {
        Self { temperature: 1.0, count: false }
    }
}

impl Op for Softmax {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("temperature", self.temperature.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["input"];
        names.extend(self.count.then_some("count"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let shape = &inputs[0].shape;
        let fits = matches!(shape.rank(), 1 | 2) && inputs[0].dtype == DType::F32;
        if !fits || shape.elements() == 0 {
            let expected = "f32 [R, N] or [N] without a zero";
            return Err(Error::tensor(self.name(), "input", expected, &inputs[0]));
        }
        expect_count(self.name(), inputs.get(1))?;
        Ok(vec![inputs[0].clone()])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let input = inputs[0].f32()?;
        let [rows, columns] = rows_and_columns(input.shape());
        let rows = live(inputs.get(1).copied(), rows)?;
        let mut output = Tensor::zeros(input.shape().clone());
        let each = output.data_mut().chunks_exact_mut(columns).zip(input.data().chunks(columns));
        for (out, row) in each.take(rows) {
            out.copy_from_slice(&reference::softmax(row, self.temperature));
        }
        Ok(vec![output.into()])
    }

    /// With d = (max − xᵢ) / T: the difference, 1 / T and their product round to 3εd, which moves e^−d
    /// by that share; exp itself is off by (3 + 2d) ULP (WGSL), each at most 2ε; so e^−d is off by
    /// (6 + 7d)ε. The sum is off by
    /// n·ε and by its terms' errors, weighted with the terms; the quotient by 2.5 ULP, and the
    /// reference rounds once.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (input, output) = (inputs[0].f32()?, reference[0].f32()?);
        let [_, columns] = rows_and_columns(input.shape());
        let rows = input.data().chunks(columns).zip(output.data().chunks(columns));
        let each = rows.flat_map(|(row, shares)| {
            let highest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let distance = |x: f32| f64::from(highest) - f64::from(x);
            // A share of zero is so for certain, however wide its gap.
            let power = |x: f32| 6.0 + 7.0 * distance(x).min(1e6) / f64::from(self.temperature);
            let sum: f64 = row.iter().zip(shares).map(|(x, s)| f64::from(*s) * power(*x)).sum();
            let fixed = sum + columns as f64 + 6.0;
            row.iter()
                .zip(shares)
                .map(|(x, s)| EPS * f64::from(*s) * (power(*x) + fixed))
                // A driver may flush subnormals, in the exponential and in the quotient.
                .map(|bound| bound + 2.0 * f64::from(f32::MIN_POSITIVE))
                .collect::<Vec<_>>()
        });
        Ok(vec![Tolerance::Each(each.collect())])
    }

    fn defined(&self, reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        let [rows, columns] = rows_and_columns(&reference[0].spec().shape);
        vec![live(inputs.get(1).copied(), rows).unwrap_or(0) * columns]
    }
}

/// A vector is one row.
pub(crate) fn rows_and_columns(shape: &Shape) -> [usize; 2] {
    let columns = shape.0.last().copied().unwrap_or(1);
    [shape.elements() / columns.max(1), columns]
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    let temperature = params.take("temperature", Softmax::default().temperature)?;
    Ok(Box::new(Softmax { temperature, count: present.contains(&"count") }))
}

fn cases() -> Vec<Case> {
    let (all, counted) = (Softmax::default(), Softmax { count: true, ..Softmax::default() });
    // ln 1, ln 2, ln 5: shares 1/8, 2/8, 5/8; and the same far from zero.
    let logs = [0.0, std::f32::consts::LN_2, 1.609_438];
    let mut cases = vec![
        Case::new("by hand", all, vec![values([2, 3], &[logs, [7.0; 3]].concat())])
            .by_hand(vec![values([2, 3], &[0.125, 0.25, 0.625, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0])]),
        Case::new("a vector by hand", all, vec![values([3], &logs)])
            .by_hand(vec![values([3], &[0.125, 0.25, 0.625])]),
        Case::new(
            "extremes by hand",
            all,
            vec![values([2, 3], &[-1000.0, 1000.0, 1000.0, -3e38, 0.0, -200.0])],
        )
        .by_hand(vec![values([2, 3], &[0.0, 0.5, 0.5, 0.0, 1.0, 0.0])]),
        Case::new(
            "one row counted by hand",
            counted,
            vec![values([2, 2], &[3.0, 3.0, 1.0, 2.0]), integers([1], &[1])],
        )
        .by_hand(vec![values([2, 2], &[0.5, 0.5, 0.0, 0.0])]),
        // The highest in each lane's second column: exp would overflow with another maximum.
        Case::new(
            "the highest behind 64 columns by hand",
            all,
            vec![Tensor::from_fn([1, 70], |i| if i == 69 { 1000.0 } else { 0.0 }).into()],
        )
        .by_hand(vec![Tensor::from_fn([1, 70], |i| if i == 69 { 1.0 } else { 0.0 }).into()]),
        // Logarithms twice as large at temperature 2, and half as large at 1/2.
        Case::new(
            "a temperature by hand",
            Softmax { temperature: 2.0, ..all },
            vec![values([1, 3], &logs.map(|x| 2.0 * x))],
        )
        .by_hand(vec![values([1, 3], &[0.125, 0.25, 0.625])]),
        Case::new(
            "a low temperature by hand",
            Softmax { temperature: 0.5, ..all },
            vec![values([1, 3], &logs.map(|x| 0.5 * x))],
        )
        .by_hand(vec![values([1, 3], &[0.125, 0.25, 0.625])]),
        Case::new("nothing counted", counted, vec![random(1, [3, 5]).into(), integers([1], &[0])]),
        Case::new("past 65 535 rows", all, vec![random(2, [65_537, 2]).into()]),
    ];
    let shapes = [(1, 1), (100, 3), (7, 63), (7, 64), (7, 65), (5, 127), (3, 1000)];
    for (seed, (rows, columns)) in shapes.into_iter().enumerate() {
        let mut input = random(seed as u64 + 10, [rows, columns]);
        input.data_mut().iter_mut().for_each(|x| *x *= 20.0);
        let inputs = vec![input.into(), integers([1], &[rows as u32])];
        cases.push(Case::new(format!("{rows} × {columns}"), counted, inputs));
    }
    cases.extend(stiff());
    let mut input = random(99, [31, 7]);
    input.data_mut().iter_mut().for_each(|x| *x *= 20.0);
    let warm = Softmax { temperature: 1.37, ..all };
    cases.push(Case::new("a temperature that rounds", warm, vec![input.into()]));
    for (name, scales) in [("the scales", 3), ("the scales without the deepest", 2)] {
        cases.push(Case::new(name, all, vec![one_way(1010, [scales]).into()]).in_network());
    }
    let inputs = vec![one_way(1000, [100, 3]).into(), integers([1], &[100])];
    cases.push(Case::new("the regions' classes", counted, inputs));
    cases
}

/// Gaps of all sizes, between which exp goes from 1 to 0.
fn stiff() -> Vec<Case> {
    let all = Softmax::default();
    let row = |name: &str, x: &[f32], shares: &[f32]| {
        Case::new(name, all, vec![values([1, x.len()], x)])
            .by_hand(vec![values([1, x.len()], shares)])
    };
    let infinite = f32::NEG_INFINITY;
    let mut cases = vec![
        row("±1e4 by hand", &[1e4, -1e4, 1e4], &[0.5, 0.0, 0.5]),
        row("91 equal by hand", &[-1e4; 91], &[1.0 / 91.0; 91]),
        // From one to the other is more than f32 holds.
        row("a gap that overflows, by hand", &[3e38, -3e38, 3e38], &[0.5, 0.0, 0.5]),
        row("an infinite gap by hand", &[infinite, 1.0, 1.0], &[0.0, 0.5, 0.5]),
        // e^-80 is 1.8e-35.
        row("one by e^80, by hand", &[80.0, 0.0, 0.0], &[1.0, 1.804_851_4e-35, 1.804_851_4e-35]),
        // Where e^x turns subnormal, and where it is nothing.
        Case::new(
            "the end of exp",
            all,
            vec![values([1, 7], &[0.0, -87.0, -88.0, -103.0, -104.0, -105.0, -1e3])],
        ),
        // Numbers of which the next is 1/16 away.
        Case::new(
            "neighbours at 1e6",
            all,
            vec![Tensor::from_fn([5, 3], |i| 1e6 + (i * i % 7) as f32 / 16.0).into()],
        ),
    ];
    for (seed, columns) in [(300, 3), (301, 91)] {
        for scale in [1.0, 1e4] {
            let input = random_scaled(seed, [13, columns], scale);
            cases.push(Case::new(format!("{columns} classes to ±{scale:e}"), all, vec![input]));
        }
    }
    let cold = Softmax { temperature: 1e-3, ..all };
    let input = random_scaled(302, [7, 91], 1e4);
    cases.push(Case::new("91 classes to ±1e4 at temperature 1e-3", cold, vec![input]));
    cases
}
