//! Cases and bounds as data, and the check that holds a shader to them.
//!
//! Tests run these, and so may anyone who replaces a shader or brings a new driver.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};

use crate::error::{Error, Result};
use crate::gpu::{Gpu, Plan, PlanOptions, Poison, Recording, Role, TensorId};
use crate::ops::op::{Op, Tolerance};
use crate::shape::Shape;
use crate::tensor::{Tensor, Value};

/// One input for one operation.
#[derive(Debug)]
pub struct Case {
    /// What is special about it.
    pub name: String,
    /// The operation with its parameters.
    pub op: Arc<dyn Op>,
    /// Input tensors in the operation's order.
    pub inputs: Vec<Value>,
    /// The outputs, computed by hand from the definition; `None` to trust the reference.
    pub by_hand: Option<Vec<Value>>,
    /// Whether every step of it is exact in f32, so that all outputs must be equal to the bit.
    pub exact: bool,
    /// Whether it has a size of the network, and inputs that f16 cannot hold: rounding any of them
    /// to f16 must fail.
    pub network: bool,
}

impl Case {
    /// A case that is compared with the CPU reference.
    pub fn new(name: impl Into<String>, op: impl Op + 'static, inputs: Vec<Value>) -> Self {
        Self {
            name: name.into(),
            op: Arc::new(op),
            inputs,
            by_hand: None,
            exact: false,
            network: false,
        }
    }

    /// The same with outputs computed by hand, to which the reference is held too.
    pub fn by_hand(mut self, outputs: Vec<Value>) -> Self {
        self.by_hand = Some(outputs);
        self
    }

    /// The same without a bound: nothing in it rounds.
    pub fn exact(mut self) -> Self {
        self.exact = true;
        self
    }

    /// The same as a case of the network's size whose inputs f16 cannot hold.
    pub fn in_network(mut self) -> Self {
        self.network = true;
        self
    }
}

/// What a check measured.
#[derive(Clone, Debug)]
pub struct Report {
    /// Largest absolute error of the shader against the reference.
    pub max_error: f64,
    /// Largest error as a share of its bound; at most 1 in a case that passes.
    pub max_share: f64,
    /// What failed, in words; empty in a case that passes.
    pub failures: Vec<String>,
}

/// Runs `case` on `gpu` with poisoned, guarded buffers and holds it to the reference within the
/// operation's bound; where there are outputs by hand, holds both to those.
///
/// # Errors
/// What the operation or the device returns. Wrong values are no error, but failures in the
/// report.
pub fn check(gpu: &Arc<Gpu>, case: &Case) -> Result<Report> {
    Expected::of(case)?.check(gpu)
}

/// A case with what must come of it, to check several devices or shaders.
#[derive(Debug)]
pub struct Expected<'a> {
    case: &'a Case,
    reference: Vec<Value>,
    bounds: Vec<Tolerance>,
    defined: Vec<usize>,
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

    /// Holds `outputs` that something else than a shader computed to the reference, within `bounds`
    /// of its own where it has some; where there are outputs by hand, to those too.
    pub fn judge(&self, outputs: &[Value], bounds: Option<Vec<Tolerance>>) -> Report {
        let bounds = bounds.as_ref().filter(|_| !self.case.exact).unwrap_or(&self.bounds);
        let mut report = Report { max_error: 0.0, max_share: 0.0, failures: Vec::new() };
        for (i, name) in self.case.op.outputs().into_iter().enumerate() {
            let what = format!("{} / {} / {name}", self.case.op.name(), self.case.name);
            let (n, bound, got) = (self.defined[i], &bounds[i], &outputs[i]);
            compare(&what, "kernel", got, &self.reference[i], bound, n, &mut report);
            if let Some(hand) = &self.case.by_hand {
                compare(&what, "kernel by hand", got, &hand[i], bound, n, &mut report);
            }
        }
        report
    }

    /// As [`check`].
    ///
    /// # Errors
    /// As [`check`].
    pub fn check(&self, gpu: &Arc<Gpu>) -> Result<Report> {
        self.check_inputs(gpu, &self.case.inputs)
    }

    /// Runs the shader on other `inputs` and holds it to what the case's own would give.
    ///
    /// # Errors
    /// As [`check`].
    pub fn check_inputs(&self, gpu: &Arc<Gpu>, inputs: &[Value]) -> Result<Report> {
        let case = self.case;
        let runs = run_guarded(gpu, case.op.as_ref(), inputs)?;
        let mut report = Report { max_error: 0.0, max_share: 0.0, failures: Vec::new() };
        for (i, name) in case.op.outputs().into_iter().enumerate() {
            let (n, bound, want) = (self.defined[i], &self.bounds[i], &self.reference[i]);
            let what = format!("{} / {} / {name}", case.op.name(), case.name);
            let shader = &runs[0].values[i];
            compare(&what, "shader", shader, want, bound, n, &mut report);
            if let Some(hand) = &case.by_hand {
                let mut by_hand = Report { failures: Vec::new(), ..report };
                compare(&what, "reference", want, &hand[i], bound, n, &mut by_hand);
                compare(&what, "shader by hand", shader, &hand[i], bound, n, &mut by_hand);
                report.failures.append(&mut by_hand.failures);
            }
            runs.iter().for_each(|run| run.check_untouched(&what, i, n, &mut report));
            let [a, b] = [0, 1].map(|run| &runs[run].values[i].bytes()[..4 * n]);
            if a != b {
                let line = format!("{what}: depends on what its buffers held before");
                report.failures.push(line);
            }
        }
        Ok(report)
    }
}

/// Runs one operation on the device: every input is known when recording.
///
/// # Errors
/// What the operation or the device returns.
pub fn run_op(gpu: &Arc<Gpu>, op: &dyn Op, inputs: &[Value]) -> Result<Vec<Value>> {
    let (mut plan, outputs) = plan_op(gpu, op, inputs, false)?;
    run_plan(&mut plan, op, &outputs)
}

/// The outputs of a run whose buffers held `poison`.
struct GuardedRun {
    poison: Poison,
    ids: Vec<TensorId>,
    values: Vec<Value>,
}

impl GuardedRun {
    /// What lies behind the defined elements must still be the poison: nobody wrote it.
    fn check_untouched(&self, what: &str, output: usize, defined: usize, report: &mut Report) {
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(self.values[output].bytes());
        let poison = |at: usize| self.poison.word(self.ids[output], at);
        if let Some(at) = (defined..words.len()).find(|at| words[*at] != poison(*at)) {
            let line = format!("{what}: wrote element {at} behind the count {defined}");
            report.failures.push(line);
        }
    }
}

/// Runs an operation once for each kind of poison: what one hides the other shows.
fn run_guarded(gpu: &Arc<Gpu>, op: &dyn Op, inputs: &[Value]) -> Result<[GuardedRun; 2]> {
    let (mut plan, ids) = plan_op(gpu, op, inputs, true)?;
    let mut run = |poison| -> Result<GuardedRun> {
        plan.poison_with(poison);
        Ok(GuardedRun { poison, values: run_plan(&mut plan, op, &ids)?, ids: ids.clone() })
    };
    Ok([run(Poison::Nan)?, run(Poison::Finite)?])
}

fn plan_op(
    gpu: &Arc<Gpu>,
    op: &dyn Op,
    inputs: &[Value],
    guard: bool,
) -> Result<(Plan, Vec<TensorId>)> {
    let out_specs = op.check(&inputs.iter().collect::<Vec<_>>())?;
    let mut recording = Recording::default();
    recording.begin_stage(op.name());
    let names = op.inputs();
    let ids: Vec<_> =
        inputs.iter().zip(names).map(|(v, n)| recording.constant(n, v.clone())).collect();
    let outs: Vec<_> = out_specs
        .into_iter()
        .zip(op.outputs())
        .map(|(spec, name)| recording.tensor(name, spec, Role::Output))
        .collect();
    op.record(&mut recording, &ids, &outs)?;
    let options = PlanOptions { reuse: true, guard, profile: false };
    Ok((pollster::block_on(Plan::new(gpu, &recording, options))?, outs))
}

fn run_plan(plan: &mut Plan, op: &dyn Op, outputs: &[TensorId]) -> Result<Vec<Value>> {
    let mut run = plan.run(&[])?;
    outputs
        .iter()
        .zip(op.outputs())
        .map(|(id, name)| {
            run.values
                .remove(id)
                .ok_or_else(|| Error::tensor(op.name(), name, "an output", "nothing read back"))
        })
        .collect()
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
        if matches!(whose, "shader" | "kernel") {
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
    use crate::ops::OPS;

    /// Without a device: each reference runs on each case and meets the outputs by hand.
    #[test]
    fn references_meet_the_outputs_by_hand() {
        let mut report = Report { max_error: 0.0, max_share: 0.0, failures: Vec::new() };
        let mut compared = 0;
        for case in OPS.iter().flat_map(|entry| (entry.cases)()) {
            let expected = Expected::of(&case).expect("a reference");
            let Some(hand) = &case.by_hand else { continue };
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

    #[test]
    fn a_nan_is_only_equal_to_a_nan() {
        let (nan, two) = (values([2], &[f32::NAN, 1.0]), values([2], &[2.0, 1.0]));
        let failures = |got: &Value, want: &Value, bound: Tolerance| {
            let mut report = Report { max_error: 0.0, max_share: 0.0, failures: Vec::new() };
            compare("case", "shader", got, want, &bound, 2, &mut report);
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
