//! Cases and bounds as data, and the check that holds a shader to them.
//!
//! Tests run these, and so may anyone who replaces a shader or brings a new driver.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};

use crate::error::{Error, Result};
use crate::gpu::{Gpu, Plan, PlanOptions, Recording, Role};
use crate::ops::op::{Op, Tolerance};
use crate::shape::Shape;
use crate::tensor::{Tensor, Value};

/// One input for one operation.
#[derive(Debug)]
pub struct Case {
    /// What is special about it.
    pub name: String,
    /// The operation with its parameters.
    pub op: Box<dyn Op>,
    /// Input tensors in the operation's order.
    pub inputs: Vec<Value>,
    /// The outputs, computed by hand from the definition; `None` to trust the reference.
    pub by_hand: Option<Vec<Value>>,
}

impl Case {
    /// A case that is compared with the CPU reference.
    pub fn new(name: impl Into<String>, op: impl Op + 'static, inputs: Vec<Value>) -> Self {
        Self { name: name.into(), op: Box::new(op), inputs, by_hand: None }
    }

    /// The same with outputs computed by hand, to which the reference is held too.
    pub fn by_hand(mut self, outputs: Vec<Value>) -> Self {
        self.by_hand = Some(outputs);
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
    let inputs: Vec<&Value> = case.inputs.iter().collect();
    let reference = case.op.reference(&inputs)?;
    let shader = run_op(gpu, case.op.as_ref(), &case.inputs, true)?;
    let bounds = case.op.tolerance(&inputs, &reference)?;
    let defined = case.op.defined(&reference.iter().collect::<Vec<_>>(), &inputs);
    let mut report = Report { max_error: 0.0, max_share: 0.0, failures: Vec::new() };
    for (i, name) in case.op.outputs().into_iter().enumerate() {
        let n = defined[i];
        let what = format!("{} / {} / {name}", case.op.name(), case.name);
        compare(&what, "shader", &shader[i], &reference[i], &bounds[i], n, &mut report);
        if let Some(hand) = &case.by_hand {
            let mut by_hand = Report { failures: Vec::new(), ..report };
            compare(&what, "reference", &reference[i], &hand[i], &bounds[i], n, &mut by_hand);
            compare(&what, "shader by hand", &shader[i], &hand[i], &bounds[i], n, &mut by_hand);
            report.failures.append(&mut by_hand.failures);
        }
        check_untouched(&what, &shader[i], n, &mut report);
    }
    Ok(report)
}

/// Runs one operation on the device: every input is known when recording.
///
/// # Errors
/// What the operation or the device returns.
pub fn run_op(gpu: &Arc<Gpu>, op: &dyn Op, inputs: &[Value], guard: bool) -> Result<Vec<Value>> {
    let specs: Vec<_> = inputs.iter().map(Value::spec).collect();
    let out_specs = op.infer(&specs)?;
    op.check_values(&inputs.iter().collect::<Vec<_>>())?;
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
    let mut plan = pollster::block_on(Plan::new(gpu, &recording, options))?;
    let mut run = plan.run(&[])?;
    outs.iter()
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
        if whose == "shader" {
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

/// What lies behind the defined elements must still be the poison: nobody wrote it.
fn check_untouched(what: &str, got: &Value, defined: usize, report: &mut Report) {
    let words: Vec<u32> = bytemuck::pod_collect_to_vec(got.bytes());
    if let Some(word) = words[defined..].iter().position(|w| *w != POISON) {
        let line = format!("{what}: wrote element {} behind the count {defined}", defined + word);
        report.failures.push(line);
    }
}

use crate::gpu::POISON;

/// Uniform values in [-1, 1), the same for the same seed on every machine.
pub fn random(seed: u64, shape: impl Into<Shape>) -> Tensor {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    Tensor::from_fn(shape, |_| rng.random_range(-1.0..1.0))
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
