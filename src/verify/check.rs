//! Holds a device's kernels to the references.
//!
//! Tests run these, and so may anyone who replaces a shader or brings a new driver: [`rows`] is what
//! `smr-gpu check` prints and what the tests of operations assert.

#[cfg(feature = "cpu")]
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

#[cfg(feature = "cpu")]
use crate::engine::cpu::{CpuPlan, multiplies};
use crate::engine::gpu::{Deadline, Gpu, Poison, Profile, Program, ProgramOptions, Slot};
use crate::engine::graph::{Graph, TensorId};
use crate::engine::kernels::{self, Kernel, Layout, Work};
use crate::engine::lower::{KernelChoice, Lowered, Request, lower};
use crate::engine::ops::case::WEIGHTS;
use crate::engine::ops::op::Tolerance;
use crate::engine::ops::{Case, Entry, Expected, OPS, Op, Report, TopK};
use crate::engine::precision::Precision;
use crate::engine::shape::{Extent, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};
use crate::verify::rounded::in_half;
#[cfg(feature = "cpu")]
use crate::verify::rounded::multiplied;

/// What is held to the references.
#[derive(Clone, Debug)]
pub enum Target {
    /// Each kernel that fits on a device.
    Gpu(Arc<Gpu>),
    /// This machine's CPU, in f32 and, where it has them, bf16 and int8; as a kernel it is called [`CPU`].
    #[cfg(feature = "cpu")]
    Cpu,
}

/// The name under which the CPU's kernels are listed.
pub const CPU: &str = "cpu";

/// Which cases are run, and by which kernels; each `None` stands for all.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// The operation of this name alone.
    pub operation: Option<String>,
    /// The kernel of this name alone, or [`CPU`].
    pub kernel: Option<String>,
    /// The case of this name alone.
    pub case: Option<String>,
    /// This precision alone.
    pub precision: Option<Precision>,
}

impl Selection {
    /// One operation.
    pub fn of(operation: &str) -> Self {
        Self { operation: Some(operation.into()), ..Self::default() }
    }

    /// The operations of the selection: those that have the kernel, if one is named.
    ///
    /// # Errors
    /// [`Error::Param`] for an operation or a kernel that there is none of.
    pub fn entries(&self) -> Result<Vec<&'static Entry>> {
        let is = |wanted: &Option<String>, name: &str| wanted.as_deref().is_none_or(|w| w == name);
        let of = |entry: &&&Entry| is(&self.operation, entry.name);
        let named: Vec<&Entry> = OPS.iter().filter(of).copied().collect();
        let unknown = |what: &str, known: Vec<&str>, got: &Option<String>| {
            let got = format!("`{}`", got.as_deref().unwrap_or_default());
            Error::param("check", what, format!("one of {}", known.join(", ")), got)
        };
        if named.is_empty() {
            let known = OPS.iter().map(|entry| entry.name).collect();
            return Err(unknown("operation", known, &self.operation));
        }
        let ids = |entry: &Entry| kernels::named(entry.name).iter().map(|k| k.id());
        let has =
            |entry: &&Entry| is(&self.kernel, CPU) || ids(entry).any(|id| is(&self.kernel, id));
        let found: Vec<&Entry> = named.iter().copied().filter(has).collect();
        if found.is_empty() {
            let known = named.iter().flat_map(|entry| ids(entry)).chain([CPU]).collect();
            return Err(unknown("kernel", known, &self.kernel));
        }
        Ok(found)
    }
}

/// A kernel, in one precision, held to the cases of its operation.
#[derive(Clone, Debug)]
pub struct Row {
    /// The operation.
    pub operation: &'static str,
    /// The kernel, or [`CPU`].
    pub kernel: &'static str,
    /// How it stores maps and weights.
    pub precision: Precision,
    /// Cases that it fits; in f16, of those whose numbers f16 can hold.
    pub cases: usize,
    /// Largest error / bound; at most 1 where nothing failed, 0 where only equal bits
    /// will do.
    pub share: f64,
    /// The case of that error; one that failed, if any did.
    pub nearest: String,
    /// What failed, in words.
    pub failures: Vec<String>,
    /// Where numbers overflowed on the device and not in the reference, as [`Report::overflows`].
    pub overflows: Vec<String>,
}

impl Row {
    fn add(&mut self, case: &Case, report: Report) {
        let Report { max_share: share, failures, overflows, .. } = report;
        let first = self.cases == 0 || (self.failures.is_empty() && !failures.is_empty());
        let as_bad = self.failures.is_empty() || !failures.is_empty();
        if first || (as_bad && share > self.share) {
            self.nearest.clone_from(&case.name);
        }
        self.cases += 1;
        self.share = self.share.max(share);
        self.failures.extend(failures);
        self.overflows.extend(overflows);
    }
}

/// Runs the selected cases of an operation: a row for each kernel that fits any, in each precision.
///
/// # Errors
/// [`Error::Param`] for a case that the operation does not have, and what ends the device. What an
/// operation refuses or gets wrong is a failure in its row.
pub fn rows(target: &Target, entry: &Entry, selection: &Selection) -> Result<Vec<Row>> {
    pollster::block_on(rows_async(target, entry, selection))
}

/// [`rows`] for callers with an executor of their own.
///
/// # Errors
/// As [`rows`].
pub async fn rows_async(target: &Target, entry: &Entry, selection: &Selection) -> Result<Vec<Row>> {
    let mut cases = (entry.cases)();
    if let Some(wanted) = &selection.case {
        let known: Vec<String> = cases.iter().map(|case| format!("`{}`", case.name)).collect();
        cases.retain(|case| case.name == *wanted);
        if cases.is_empty() {
            let expected = format!("one of {}", known.join(", "));
            return Err(Error::param("check", "case", expected, format!("`{wanted}`")));
        }
    }
    rows_of(target, entry.name, &cases, selection).await
}

/// [`rows_async`] of these cases of an operation: for callers that show each as it comes.
///
/// # Errors
/// What ends the device.
pub async fn rows_of(
    target: &Target,
    operation: &'static str,
    cases: &[Case],
    selection: &Selection,
) -> Result<Vec<Row>> {
    let mut rows: Vec<Row> = Vec::new();
    for case in cases {
        for Outcome { kernel, precision, report } in outcomes(target, case, selection).await? {
            let report = match report {
                Ok(report) => report,
                Err(e @ (Error::DeviceLost(_) | Error::Timeout { .. } | Error::Driver { .. })) => {
                    return Err(e);
                }
                Err(e) => Report {
                    max_share: f64::INFINITY,
                    failures: vec![format!("{kernel} / {}: {e}", case.name)],
                    ..Report::default()
                },
            };
            let same = |row: &Row| row.kernel == kernel && row.precision == precision;
            let at = rows.iter().position(same).unwrap_or_else(|| {
                rows.push(Row {
                    operation,
                    kernel,
                    precision,
                    cases: 0,
                    share: 0.0,
                    nearest: String::new(),
                    failures: Vec::new(),
                    overflows: Vec::new(),
                });
                rows.len() - 1
            });
            rows[at].add(case, report);
        }
    }
    Ok(rows)
}

/// What a kernel makes of a case.
struct Outcome {
    kernel: &'static str,
    precision: Precision,
    report: Result<Report>,
}

/// What each selected kernel makes of a case, in each selected precision.
async fn outcomes(target: &Target, case: &Case, selection: &Selection) -> Result<Vec<Outcome>> {
    let wanted = |id: &str| selection.kernel.as_deref().is_none_or(|kernel| kernel == id);
    let stored = |precision| selection.precision.is_none_or(|wanted| wanted == precision);
    let mut found = Vec::new();
    match target {
        Target::Gpu(gpu) => {
            if stored(Precision::F32) {
                found.extend(singles(gpu, &Expected::of(case)?, &case.inputs, wanted).await?);
            }
            if stored(Precision::F16) {
                found.extend(halves(gpu, case, wanted).await?);
            }
        }
        #[cfg(feature = "cpu")]
        Target::Cpu if !wanted(CPU) => {}
        #[cfg(feature = "cpu")]
        Target::Cpu => {
            for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
                let Some(case) = on_cores(case, precision).filter(|_| stored(precision)) else {
                    continue;
                };
                let report = check_on_cores(&Expected::of(&case)?, precision).transpose();
                found.extend(report.map(|report| Outcome { kernel: CPU, precision, report }));
            }
        }
    }
    Ok(found)
}

/// Runs `case` by each kernel that fits and in each [`Precision`], on `gpu` with poisoned, guarded
/// buffers, and holds it to the reference within the kernel's bound; where there are outputs by hand, to
/// those too.
///
/// # Errors
/// What the operation or the device returns. Wrong values are no error, but failures in the
/// report.
pub fn check(gpu: &Arc<Gpu>, case: &Case) -> Result<Report> {
    let mut report = check_expected(gpu, &Expected::of(case)?, &case.inputs)?;
    for outcome in pollster::block_on(halves(gpu, case, |_| true))? {
        report.add(outcome.report?);
    }
    Ok(report)
}

/// [`check`] in f32 of a case whose reference has run, on other `inputs` than its own.
///
/// # Errors
/// As [`check`].
pub fn check_expected(gpu: &Arc<Gpu>, expected: &Expected, inputs: &[Value]) -> Result<Report> {
    let mut report = Report::default();
    for outcome in pollster::block_on(singles(gpu, expected, inputs, |_| true))? {
        report.add(outcome.report?);
    }
    Ok(report)
}

/// What each wanted kernel makes of a case in f32.
async fn singles(
    gpu: &Arc<Gpu>,
    expected: &Expected<'_>,
    inputs: &[Value],
    wanted: impl Fn(&str) -> bool,
) -> Result<Vec<Outcome>> {
    let precision = Precision::F32;
    let mut found = Vec::new();
    for (kernel, _) in fitting(gpu, expected.case(), precision)? {
        if wanted(kernel.id()) {
            let report = check_kernel(gpu, expected, inputs, (kernel, precision)).await;
            let outcome = |report| Outcome { kernel: kernel.id(), precision, report };
            found.extend(report.transpose().map(outcome));
        }
    }
    Ok(found)
}

/// What each wanted kernel makes of a case in f16; nothing where nothing is stored so, or an input
/// overflows.
async fn halves(
    gpu: &Arc<Gpu>,
    case: &Case,
    wanted: impl Fn(&str) -> bool,
) -> Result<Vec<Outcome>> {
    let precision = Precision::F16;
    // By which inputs are stored in f16, the kernels that read those so: they share a reference.
    let mut kernels: BTreeMap<Vec<bool>, Vec<&'static dyn Kernel>> = BTreeMap::new();
    for (kernel, stored) in fitting(gpu, case, precision)? {
        if wanted(kernel.id()) {
            kernels.entry(stored).or_default().push(kernel);
        }
    }
    let mut found = Vec::new();
    for (stored, kernels) in kernels {
        let round = |index: usize, tensor: &Tensor| match stored[index] {
            true => in_half(tensor, precision),
            false => Some(tensor.clone()),
        };
        let Some(case) = rounded(case, precision, round) else { continue };
        let expected = Expected::of(&case)?;
        for kernel in kernels {
            let report = check_kernel(gpu, &expected, &case.inputs, (kernel, precision)).await;
            if let Some(report) = report.transpose() {
                found.push(Outcome { kernel: kernel.id(), precision, report });
            }
        }
    }
    Ok(found)
}

/// The case with what cores multiply in `precision` rounded to it, so that its reference multiplies the same;
/// `None` if they multiply nothing in it.
#[cfg(feature = "cpu")]
fn on_cores(case: &Case, precision: Precision) -> Option<Cow<'_, Case>> {
    if precision == Precision::F32 {
        return Some(Cow::Borrowed(case));
    }
    if !["conv2d", "linear"].contains(&case.op.name()) || !multiplies(precision) {
        return None;
    }
    let rounded = rounded(case, precision, |index, tensor| {
        // Twice: where no number of 8 bits that is left is negative, the scale is another.
        let once = multiplied(case.op.as_ref(), index, tensor, precision)?;
        multiplied(case.op.as_ref(), index, &once, precision)
    });
    rounded.map(Cow::Owned)
}

/// Runs a case by the kernels of this machine's cores and holds it to its reference; `None` if they multiply
/// nothing in `precision`.
///
/// # Errors
/// What the operation refuses. Wrong values are no error, but failures in the report.
#[cfg(feature = "cpu")]
fn check_on_cores(expected: &Expected, precision: Precision) -> Result<Option<Report>> {
    let case = expected.case();
    let mut graph = Graph::default();
    let mut given = Vec::new();
    let mut inputs = Vec::new();
    for (value, name) in case.inputs.iter().zip(case.op.inputs()) {
        inputs.push(match WEIGHTS.contains(&name) {
            true => graph.constant(name, value.clone()),
            false => {
                let id = graph.input(name, value.spec(), Extent::Exact);
                given.push((id, value));
                id
            }
        });
    }
    let outputs = graph.apply_shared(&case.name, case.op.clone(), &inputs)?;
    outputs.iter().for_each(|id| graph.mark_output(*id));
    let plan = CpuPlan::new(&graph, &[], None, precision)?;
    if plan.precision(0) != precision {
        return Ok(None);
    }
    plan.poison();
    let (mut values, _) = plan.run(&graph, &given)?;
    let known: Vec<Value> = outputs.iter().filter_map(|id| values.remove(id)).collect();
    let inputs: Vec<&Value> = case.inputs.iter().collect();
    let own = plan.tolerance(0, &inputs)?.map(|bounds| vec![Tolerance::Each(bounds)]);
    Ok(Some(expected.judge(&known, own.filter(|_| !case.exact))))
}

/// The kernels that can run a case on a device in a precision, each with the inputs that it does not read
/// planar, which are stored in that precision.
fn fitting(
    gpu: &Gpu,
    case: &Case,
    precision: Precision,
) -> Result<Vec<(&'static dyn Kernel, Vec<bool>)>> {
    let specs: Vec<TensorSpec> = case.inputs.iter().map(Value::spec).collect();
    let outputs = case.op.infer(&specs)?;
    let known: Vec<bool> = case.op.inputs().iter().map(|n| WEIGHTS.contains(n)).collect();
    let op = case.op.as_ref();
    let (inputs, outputs, caps) = (&specs[..], &outputs[..], gpu.caps());
    let work = Work { node: 0, op, inputs, known: &known, outputs, batch: 1, precision, caps };
    let fitting = kernels::of(op)?.iter().copied().filter(|k| k.fits(&work));
    let stored = |kernel: &dyn Kernel| {
        let layouts = (0..specs.len()).map(|i| kernel.reads(&work, i));
        layouts.map(|layout| layout != Layout::Planar).collect()
    };
    Ok(fitting.map(|kernel| (kernel, stored(kernel))).collect())
}

/// The case with each input of floats `round`ed to a precision before, so that storing or multiplying it in that
/// changes nothing; `None` if one cannot be.
fn rounded(
    case: &Case,
    precision: Precision,
    round: impl Fn(usize, &Tensor) -> Option<Tensor>,
) -> Option<Case> {
    let mut inputs = Vec::with_capacity(case.inputs.len());
    for (index, input) in case.inputs.iter().enumerate() {
        inputs.push(match input {
            Value::F32(tensor) => round(index, tensor)?.into(),
            other => other.clone(),
        });
    }
    let same = inputs == case.inputs;
    Some(Case {
        name: format!("{} in {precision}", case.name),
        op: case.op.clone(),
        inputs,
        by_hand: case.by_hand.clone().filter(|_| same),
        exact: case.exact,
        network: case.network,
    })
}

/// [`check`] of one kernel in one precision; `None` if that stores nothing in f16.
async fn check_kernel(
    gpu: &Arc<Gpu>,
    expected: &Expected<'_>,
    inputs: &[Value],
    (kernel, precision): (&dyn Kernel, Precision),
) -> Result<Option<Report>> {
    let case = expected.case();
    let op = case.op.as_ref();
    let mut single = Single::new(gpu, &case.op, inputs, (kernel.id(), precision), 1, true).await?;
    if precision.is_half() && !single.has_halves {
        return Ok(None);
    }
    // What one kind of poison hides the other shows.
    let nan = single.run_poisoned(Poison::Nan).await?;
    let finite = single.run_poisoned(Poison::Finite).await?;
    let case_inputs: Vec<&Value> = case.inputs.iter().collect();
    let values = (&case_inputs[..], &expected.reference[..]);
    let bounds = match case.exact {
        true => {
            let outputs = expected.reference.iter().zip(&single.written);
            outputs.map(|(value, written)| Tolerance::Exact.stored(value, *written)).collect()
        }
        false => kernels::bounds(Some(kernel), op, values, precision, &single.written)?,
    };
    let mut report = expected.judge(&nan, Some(bounds));
    for (i, name) in op.outputs().into_iter().enumerate() {
        let what = format!("{} / {} / {name}", kernel.id(), case.name);
        let n = expected.defined[i];
        for (poison, values) in [(Poison::Nan, &nan), (Poison::Finite, &finite)] {
            single.check_untouched(&what, i, (poison, &values[i]), n, &mut report);
        }
        if nan[i].bytes()[..4 * n] != finite[i].bytes()[..4 * n] {
            let line = format!("{what}: depends on what its buffers held before");
            report.failures.push(line);
        }
    }
    if kernel.batched() {
        check_batch(gpu, expected, inputs, (kernel, precision), &nan, &mut report).await?;
    }
    let in_quads = single.poisoned.iter().all(Option::is_none);
    if in_quads && !precision.is_half() && !case.network {
        check_planar(gpu, expected, inputs, kernel, &nan[0], &mut report).await?;
    }
    Ok(Some(report))
}

/// The next operation reads of a map what the host reads, also where it reads it planar: the highest values of
/// the map and their places are those of `alone`.
async fn check_planar(
    gpu: &Arc<Gpu>,
    expected: &Expected<'_>,
    inputs: &[Value],
    kernel: &dyn Kernel,
    alone: &Value,
    report: &mut Report,
) -> Result<()> {
    let case = expected.case();
    let how = (kernel.id(), Precision::F32);
    let mut single = Single::then(gpu, &case.op, Some(HIGHEST), inputs, how, 1, true).await?;
    let got = single.run_poisoned(Poison::Nan).await?;
    for (got, want) in got.iter().zip(HIGHEST.reference(&[alone])?) {
        let n = want.spec().shape.elements();
        let equal = Tolerance::Each(vec![0.0; n]);
        let differs = |i: &usize| equal.judge(got, &want, *i) != (0.0, 0.0);
        if let Some(i) = (0..n).find(differs) {
            let (got, want) = (got.show(i), want.show(i));
            let what = format!("{} / {}", kernel.id(), case.name);
            report.failures.push(format!("{what}: read planar: {got} instead of {want}"));
        }
    }
    Ok(())
}

/// A picture gives the same bits whatever else is in the batch.
async fn check_batch(
    gpu: &Arc<Gpu>,
    expected: &Expected<'_>,
    inputs: &[Value],
    (kernel, precision): (&dyn Kernel, Precision),
    alone: &[Value],
    report: &mut Report,
) -> Result<()> {
    let case = expected.case();
    let mut single = Single::new(gpu, &case.op, inputs, (kernel.id(), precision), 2, true).await?;
    let turned: Vec<Value> = inputs.iter().map(turned).collect();
    for order in [[inputs, &turned[..]], [&turned[..], inputs]] {
        let values = single.run_batch(&order).await?;
        let at = usize::from(!std::ptr::eq(order[0], inputs));
        for (i, name) in case.op.outputs().into_iter().enumerate() {
            let n = 4 * expected.defined[i];
            if values[at][i].bytes()[..n] != alone[i].bytes()[..n] {
                let what = format!("{} / {} / {name}", kernel.id(), case.name);
                report.failures.push(format!("{what}: depends on the rest of its batch"));
            }
        }
    }
    Ok(())
}

/// Other values of the same kind: floats from the last to the first.
fn turned(value: &Value) -> Value {
    match value {
        Value::F32(t) => {
            let data = t.data();
            Tensor::from_fn(t.shape().clone(), |i| data[data.len() - 1 - i]).into()
        }
        Value::U32(_) => value.clone(),
    }
}

/// Runs one operation on the device by its preferred kernel.
///
/// # Errors
/// What the operation or the device returns.
pub fn run_op(gpu: &Arc<Gpu>, op: &Arc<dyn Op>, inputs: &[Value]) -> Result<Vec<Value>> {
    pollster::block_on(run_alone(gpu, op, inputs, ("", Precision::F32)))
}

/// Runs a case on the device by each kernel that fits: the kernels' names, and what they gave.
///
/// # Errors
/// As [`run_op`].
pub fn run_each(gpu: &Arc<Gpu>, case: &Case) -> Result<Vec<(&'static str, Vec<Value>)>> {
    let precision = Precision::F32;
    let run = |(kernel, _): (&dyn Kernel, _)| {
        let how = (kernel.id(), precision);
        Ok((kernel.id(), pollster::block_on(run_alone(gpu, &case.op, &case.inputs, how))?))
    };
    fitting(gpu, case, precision)?.into_iter().map(run).collect()
}

async fn run_alone(
    gpu: &Arc<Gpu>,
    op: &Arc<dyn Op>,
    inputs: &[Value],
    how: (&str, Precision),
) -> Result<Vec<Value>> {
    Single::new(gpu, op, inputs, how, 1, false).await?.run().await
}

/// What reads a map planar, and tells of its values.
const HIGHEST: TopK = TopK { k: 1024, count: false };

/// An operation alone on a device, or with one behind it.
struct Single {
    slot: Slot,
    /// What each run is given: weights are known to the program.
    given: Vec<(TensorId, Value)>,
    /// The places of those among the inputs.
    indices: Vec<usize>,
    outputs: Vec<TensorId>,
    names: Vec<&'static str>,
    /// How the outputs are stored.
    written: Vec<Precision>,
    /// Whether anything is stored in f16.
    has_halves: bool,
    /// The recording's tensors of the outputs, for those that are planar.
    poisoned: Vec<Option<TensorId>>,
}

impl Single {
    async fn new(
        gpu: &Arc<Gpu>,
        op: &Arc<dyn Op>,
        inputs: &[Value],
        how: (&str, Precision),
        batch: u32,
        guard: bool,
    ) -> Result<Self> {
        Self::then(gpu, op, None, inputs, how, batch, guard).await
    }

    /// With `next`, which reads the first output, what that gives takes the outputs' place.
    async fn then(
        gpu: &Arc<Gpu>,
        op: &Arc<dyn Op>,
        next: Option<TopK>,
        inputs: &[Value],
        (kernel, precision): (&str, Precision),
        batch: u32,
        guard: bool,
    ) -> Result<Self> {
        op.check(&inputs.iter().collect::<Vec<_>>())?;
        let mut graph = Graph::default();
        let (mut given, mut indices, mut ids) = (Vec::new(), Vec::new(), Vec::new());
        for (index, (value, name)) in inputs.iter().zip(op.inputs()).enumerate() {
            ids.push(match WEIGHTS.contains(&name) {
                true => graph.constant(name, value.clone()),
                false => {
                    let id = graph.input(name, value.spec(), Extent::Exact);
                    given.push((id, value.clone()));
                    indices.push(index);
                    id
                }
            });
        }
        let mut outputs = graph.apply_shared(op.name(), op.clone(), &ids)?;
        let mut names = op.outputs();
        if let Some(next) = next {
            outputs = graph.apply(next.name(), next, &outputs[..1])?;
            names = next.outputs();
        }
        outputs.iter().for_each(|id| graph.mark_output(*id));
        let kernels =
            if kernel.is_empty() { KernelChoice::default() } else { KernelChoice::force(kernel)? };
        let request = Request { keep: &[], batch, precision, caps: gpu.caps(), kernels: &kernels };
        let lowered = lower(&graph, &request)?;
        let has_halves = lowered.recording.tensors().iter().any(|t| t.precision.is_half());
        let written = outputs.iter().map(|id| lowered.stored(*id)).collect();
        let poisoned = outputs.iter().map(|id| planar(&lowered, *id)).collect();
        let options = ProgramOptions { reuse: true, guard, profile: Profile::Off };
        let program = Program::new(gpu, &lowered, None, options).await?;
        let slot = Slot::new(&Arc::new(program)).await?;
        Ok(Self { slot, given, indices, outputs, names, written, has_halves, poisoned })
    }

    async fn run_poisoned(&mut self, poison: Poison) -> Result<Vec<Value>> {
        self.slot.poison_with(poison);
        self.run().await
    }

    async fn run(&mut self) -> Result<Vec<Value>> {
        let inputs: Vec<_> = self.given.iter().map(|(id, value)| (*id, value)).collect();
        let mut run = self.slot.run_async(&inputs).await?;
        self.collect(run.first())
    }

    /// Runs a batch of pictures, each with inputs of its own.
    async fn run_batch(&mut self, pictures: &[&[Value]]) -> Result<Vec<Vec<Value>>> {
        let ids: Vec<TensorId> = self.given.iter().map(|(id, _)| *id).collect();
        let inputs: Vec<Vec<(TensorId, &Value)>> = pictures
            .iter()
            .map(|inputs| {
                ids.iter().copied().zip(self.indices.iter().map(|i| &inputs[*i])).collect()
            })
            .collect();
        let inputs: Vec<&[(TensorId, &Value)]> = inputs.iter().map(Vec::as_slice).collect();
        self.slot.submit(&inputs).await?;
        let deadline = Deadline::after(self.slot.program().gpu().timeout());
        let run = self.slot.receive(deadline).await?;
        run.values.into_iter().map(|values| self.collect(values)).collect()
    }

    fn collect(&self, mut values: HashMap<TensorId, Value>) -> Result<Vec<Value>> {
        let outputs = self.outputs.iter().zip(&self.names);
        outputs
            .map(|(id, name)| {
                let missing = || Error::tensor("check", name, "an output", "nothing read back");
                values.remove(id).ok_or_else(missing)
            })
            .collect()
    }

    /// What lies behind the defined elements must still be the poison: nobody wrote it.
    fn check_untouched(
        &self,
        what: &str,
        output: usize,
        (poison, value): (Poison, &Value),
        defined: usize,
        report: &mut Report,
    ) {
        let Some(id) = self.poisoned[output] else { return };
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(value.bytes());
        if let Some(at) = (defined..words.len()).find(|at| words[*at] != poison.word(id, *at)) {
            let line = format!("{what}: wrote element {at} behind the count {defined}");
            report.failures.push(line);
        }
    }
}

/// The recording's tensor of an output, if it is planar.
fn planar(lowered: &Lowered, id: TensorId) -> Option<TensorId> {
    let place = *lowered.places.get(&id)?;
    (lowered.recording.info(place).layout == Layout::Planar).then_some(place)
}
