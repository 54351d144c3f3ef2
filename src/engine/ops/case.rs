//! Cases and bounds as data.
//!
//! Tests run these, and so may anyone who replaces a shader or brings a new driver.

use rand::{RngExt, SeedableRng};

pub use crate::engine::ops::op::Case;
use crate::engine::ops::op::Tolerance;
use crate::engine::shape::Shape;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// What a check measured.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Largest absolute error of the shader against the reference.
    pub max_error: f64,
    /// Largest error / bound; at most 1 in a case that passes.
    pub max_share: f64,
    /// What failed, in words; empty in a case that passes.
    pub failures: Vec<String>,
    /// Where a device's numbers overflowed within their bound, which is infinite there, and the
    /// reference, whose sums are in f64, hides it, in words.
    pub overflows: Vec<String>,
}

impl Report {
    /// Takes in another.
    pub(crate) fn add(&mut self, other: Self) {
        self.max_error = self.max_error.max(other.max_error);
        self.max_share = self.max_share.max(other.max_share);
        self.failures.extend(other.failures);
        self.overflows.extend(other.overflows);
    }
}

/// A case with what must come of it, to check several devices or shaders.
#[derive(Debug)]
pub struct Expected<'a> {
    case: &'a Case,
    pub(crate) reference: Vec<Value>,
    bounds: Vec<Tolerance>,
    pub(crate) defined: Vec<usize>,
}

impl<'a> Expected<'a> {
    /// Runs the case's reference.
    ///
    /// # Errors
    /// What the operation returns.
    pub fn of(case: &'a Case) -> Result<Self> {
        let inputs: Vec<&Value> = case.inputs.iter().collect();
        let reference = case.op.reference(&inputs)?;
        let bounds = match case.exact {
            true => vec![Tolerance::Exact; reference.len()],
            false => case.op.tolerance(&inputs, &reference)?,
        };
        let defined = case.op.defined(&reference.iter().collect::<Vec<_>>(), &inputs);
        Ok(Self { case, reference, bounds, defined })
    }

    /// The case itself.
    pub fn case(&self) -> &'a Case {
        self.case
    }

    /// Holds `outputs` to the reference, within `bounds` of their own where there are some; where there
    /// are outputs by hand, to those too.
    pub fn judge(&self, outputs: &[Value], bounds: Option<Vec<Tolerance>>) -> Report {
        let bounds = bounds.as_ref().unwrap_or(&self.bounds);
        let mut report = Report::default();
        for (i, name) in self.case.op.outputs().into_iter().enumerate() {
            let what = format!("{} / {} / {name}", self.case.op.name(), self.case.name);
            let (n, bound, got) = (self.defined[i], &bounds[i], &outputs[i]);
            compare(&what, "kernel", got, &self.reference[i], bound, n, &mut report);
            report.overflows.extend(hidden(&what, got, &self.reference[i], n));
            if let Some(hand) = &self.case.by_hand {
                compare(&what, "kernel by hand", got, &hand[i], bound, n, &mut report);
            }
        }
        report
    }
}

/// Inputs that are known when a network is built; the others change with each picture.
pub(crate) const WEIGHTS: [&str; 6] =
    ["weight", "bias", "fc1_weight", "fc1_bias", "fc2_weight", "fc2_bias"];

/// Says where a device's number is not finite and the reference's is.
fn hidden(what: &str, got: &Value, want: &Value, defined: usize) -> Option<String> {
    let (Value::F32(got), Value::F32(want)) = (got, want) else { return None };
    let pairs = got.data().iter().zip(want.data()).take(defined).enumerate();
    let mut lost = pairs.filter(|(_, (got, want))| !got.is_finite() && want.is_finite());
    let (first, (got, want)) = lost.next()?;
    let count = lost.count() + 1;
    Some(format!(
        "{what}: {count} of {defined} overflow, which f64 hides; element {first}: {got:e} instead of \
         {want:e}"
    ))
}

fn compare(
    what: &str,
    whose: &str,
    got: &Value,
    want: &Value,
    bound: &Tolerance,
    defined: usize,
    report: &mut Report,
) {
    if got.spec() != want.spec() {
        let line = format!("{what}: {whose}: {} instead of {}", got.spec(), want.spec());
        report.failures.push(line);
        return;
    }
    let mut bad = 0;
    let mut first = None;
    for i in 0..defined {
        let (error, limit) = bound.judge(got, want, i);
        if whose == "kernel" {
            report.max_error = report.max_error.max(error);
            if limit > 0.0 {
                report.max_share = report.max_share.max(error / limit);
            }
        }
        // Not `error > limit`: a NaN must fail.
        let within = error <= limit;
        if !within {
            bad += 1;
            first.get_or_insert_with(|| {
                let (got, want) = (got.show(i), want.show(i));
                format!("element {i}: {got} instead of {want} ± {limit:.3e}")
            });
        }
    }
    if let Some(first) = first {
        let line = format!("{what}: {whose}: {bad} of {defined} wrong; {first}");
        report.failures.push(line);
    }
}

/// Uniform values in [-1, 1), the same for the same seed on every machine.
pub fn random(seed: u64, shape: impl Into<Shape>) -> Tensor {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    Tensor::from_fn(shape, |_| rng.random_range(-1.0..1.0))
}

/// A map whose quads, one below the other, are more rows than a texture has (for two pictures than any
/// has), so that they stand side by side.
pub const STACKED: [usize; 3] = [1024, 65, 3];

/// Channels and edge of each map that passes through a CBAM of the network.
pub const GATED_MAPS: [(usize, usize); 7] =
    [(64, 160), (64, 80), (128, 40), (256, 20), (512, 10), (256, 40), (256, 10)];

/// Positive values that f16 rounds all one way: a power of two from 1/8 to 1, times 1 + 2⁻¹² give or
/// take half of the 2⁻¹², of which f16 leaves 1.
pub fn one_way(seed: u64, shape: impl Into<Shape>) -> Tensor {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    Tensor::from_fn(shape, |_| {
        let part: f32 = rng.random_range(0.5..1.5);
        let power = 1u32 << rng.random_range(0..4);
        (1.0 + part / 4096.0) / power as f32
    })
}

/// [`one_way`] values times a power of two, at least as large as a sum of `terms` products of them.
pub fn one_way_sum(seed: u64, shape: impl Into<Shape>, terms: usize) -> Value {
    let mut tensor = one_way(seed, shape);
    let scale = terms.next_power_of_two() as f32;
    tensor.data_mut().iter_mut().for_each(|x| *x *= scale);
    tensor.into()
}

/// Two vectors of `n` numbers whose dot product has about this condition number: Σ|xᵢyᵢ| is so many times
/// the sum itself (Ogita, Rump and Oishi, "Accurate Sum and Dot Product", SIAM J. Sci. Comput. 26, 2005,
/// algorithm 6.1, in f32). The first half has exponents at random, the second brings the sum down.
pub fn stiff_dot(seed: u64, n: usize, condition: f64) -> [Vec<f32>; 2] {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let half_log = condition.log2() / 2.0;
    let (mut x, mut y) = (Vec::with_capacity(n), Vec::with_capacity(n));
    let free = n / 2;
    for i in 0..n {
        let exponent: f64 = match i {
            0 => half_log,
            i if i < free => rng.random_range(0.0..=half_log),
            i => half_log * (1.0 - (i - free) as f64 / (n - 1 - free).max(1) as f64),
        };
        let mut number = || {
            let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            sign * rng.random_range(0.5..1.0) * exponent.round().exp2()
        };
        let (a, b) = (number() as f32, number());
        let sum = if i < free { 0.0 } else { exact_dot(&x, &y) };
        let b = if i < free { b } else { (b - sum) / f64::from(a) };
        x.push(a);
        y.push(b as f32);
    }
    [x, y]
}

/// Σ xᵢyᵢ as exact as an f64 tells: products of two f32 are exact there, and their sum is kept in parts
/// that do not overlap (Shewchuk, "Adaptive Precision Floating-Point Arithmetic", 1997).
pub fn exact_dot(x: &[f32], y: &[f32]) -> f64 {
    let mut parts: Vec<f64> = Vec::new();
    for (x, y) in x.iter().zip(y) {
        let mut term = f64::from(*x) * f64::from(*y);
        let mut kept = 0;
        for i in 0..parts.len() {
            let sum = term + parts[i];
            let of_part = sum - term;
            let lost = (term - (sum - of_part)) + (parts[i] - of_part);
            if lost != 0.0 {
                parts[kept] = lost;
                kept += 1;
            }
            term = sum;
        }
        parts.truncate(kept);
        parts.push(term);
    }
    parts.iter().sum()
}

/// Values written out in a case, row-major.
pub fn values(shape: impl Into<Shape>, data: &[f32]) -> Value {
    Tensor::from_fn(shape, |i| data[i]).into()
}

/// [`random`] values times `scale`, for the ends of the range.
pub fn random_scaled(seed: u64, shape: impl Into<Shape>, scale: f32) -> Value {
    let mut tensor = random(seed, shape);
    tensor.data_mut().iter_mut().for_each(|x| *x *= scale);
    tensor.into()
}

/// An integer tensor of values written out in a case; `data` is as long as `shape` says.
pub fn integers(shape: impl Into<Shape>, data: &[u32]) -> Value {
    Tensor::from_fn(shape, |i| data[i]).into()
}

/// Uniform integers below `below`, the same for the same seed on every machine.
pub fn random_integers(seed: u64, shape: impl Into<Shape>, below: u32) -> Value {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    Tensor::from_fn(shape, |_| rng.random_range(0..below)).into()
}

/// `n` boxes `[n, 4]` with corners within `extent` pixels and sides up to `side`.
pub fn random_boxes(seed: u64, n: usize, extent: f32, side: f32) -> Tensor {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let mut boxes = Tensor::zeros([n, 4]);
    for b in boxes.data_mut().chunks_exact_mut(4) {
        for axis in 0..2 {
            let length = rng.random_range(0.0..side);
            b[axis] = rng.random_range(0.0..extent - length);
            b[axis + 2] = b[axis] + length;
        }
    }
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::ops::OPS;

    /// Without a device: each reference runs on each case and meets the outputs by hand.
    #[test]
    fn references_meet_the_outputs_by_hand() {
        let mut report = Report::default();
        let mut compared = 0;
        for case in OPS.iter().flat_map(|entry| (entry.cases)()) {
            let Some(hand) = &case.by_hand else { continue };
            let expected = Expected::of(&case).expect("a reference");
            for (i, name) in case.op.outputs().into_iter().enumerate() {
                let what = format!("{} / {} / {name}", case.op.name(), case.name);
                let (got, bound) = (&expected.reference[i], &expected.bounds[i]);
                compare(&what, "reference", got, &hand[i], bound, expected.defined[i], &mut report);
                compared += 1;
            }
        }
        assert!(report.failures.is_empty(), "{}", report.failures.join("\n"));
        assert!(compared > 100, "only {compared}");
    }

    /// `smr-gpu check --case` and the tests find a case by its name.
    #[test]
    fn no_two_cases_of_an_operation_share_a_name() {
        for entry in OPS {
            let mut names: Vec<String> =
                (entry.cases)().into_iter().map(|case| case.name).collect();
            names.sort();
            let twice: Vec<_> = names.windows(2).filter(|pair| pair[0] == pair[1]).collect();
            assert!(twice.is_empty(), "{}: {twice:?}", entry.name);
        }
    }

    #[test]
    fn dot_products_are_exact_and_as_stiff_as_asked() {
        // In order, f64 loses all of the small one.
        let x = [1e20, 1.0, -1e20, 0.25];
        assert_eq!(exact_dot(&x, &[1e10, 3.0, 1e10, 1.0]), 3.25);
        for condition in [1e4, 1e8, 1e12] {
            let [x, y] = stiff_dot(7, 72, condition);
            let absolute: f64 = x.iter().zip(&y).map(|(x, y)| f64::from((x * y).abs())).sum();
            let got = absolute / exact_dot(&x, &y).abs();
            assert!((condition / 100.0..condition * 100.0).contains(&got), "{got:e}");
        }
    }

    #[test]
    fn a_nan_is_only_equal_to_a_nan() {
        let (nan, two) = (values([2], &[f32::NAN, 1.0]), values([2], &[2.0, 1.0]));
        let failures = |got: &Value, want: &Value, bound: Tolerance| {
            let mut report = Report::default();
            compare("case", "kernel", got, want, &bound, 2, &mut report);
            report.failures.len()
        };
        // A bound from inputs with a NaN is none.
        let none = || Tolerance::Each(vec![f64::NAN, 1e-6]);
        assert_eq!(failures(&nan, &nan, none()), 0);
        assert_eq!(failures(&two, &nan, none()), 1);
        assert_eq!(failures(&nan, &two, none()), 1);
        assert_eq!(failures(&two, &nan, Tolerance::Uniform(f64::INFINITY)), 1);
    }
}
