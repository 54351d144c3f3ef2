//! The whole network on a device, against the f64 reference.
//!
//! Three things are compared, each by what can be promised of it:
//!
//! 1. **Each operation, on the device's own inputs.** The reference takes what the device computed
//!    before, so an operation answers for its own error alone, and [`Op::tolerance`] bounds it element
//!    by element. What is chosen by comparing (top-k, non-maximum suppression, gathering) must be
//!    equal to the bit: the inputs are. Sums of products may be off to either side, but not all to
//!    one ([`TensorComparison::bias`]): a layer that is scaled by 1.0001 fails where each of its
//!    elements would pass.
//! 2. **What comes out**, against the reference that saw the picture alone. Detections are matched by
//!    the anchor and the class that they come from. Scores may be [`SCORE_BOUND`] apart and corners
//!    [`CORNER_BOUND`]: half a unit of the last digit that `smr-gpu detect` prints.
//! 3. **What was chosen**, by both non-maximum suppressions, likewise. Rounding may decide a comparison
//!    either way, and then a proposal or a detection is on one side alone, or two change places. That
//!    is excused only where the comparison came as close to its threshold as the two sides' values
//!    are to each other, measured on the same picture and never more than the bounds of 2.
//!
//! An excuse hides no fault: whatever it excuses was made from inputs by operations that passed 1.
//! The drift of a stage from the reference's own chain says how far errors have grown. It has no
//! verdict, because it tells more of the picture than of the device: on the same weights float32 in
//! PyTorch drifts as far.

mod choice;
#[cfg(all(test, feature = "picture"))]
mod faults;
mod tensor;

#[cfg(feature = "cpu")]
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::time::Duration;

pub use choice::ChoiceComparison;
pub(crate) use tensor::larger;
pub use tensor::{TensorComparison, relative_l2};

#[cfg(feature = "cpu")]
use crate::engine::cpu::CpuPlan;
use crate::engine::graph::{Step, TensorId, Values};
use crate::engine::kernels;
use crate::engine::ops::op::Tolerance;
use crate::engine::precision::Precision;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};
use crate::smr::{ModelConfig, Network};
#[cfg(feature = "cpu")]
use crate::verify::rounded::multiplied;
use choice::{Id, Moved, Side};

#[cfg(doc)]
use crate::engine::ops::Op;

/// Scores of a detection may be so far apart: half of the third decimal.
pub const SCORE_BOUND: f64 = 0.0005;
/// Corners of a detection may be so far apart, in pixels of the picture: half of the first decimal.
/// On the sensor's 1000 × 1000 pixels that is 0.002 mm.
pub const CORNER_BOUND: f64 = 0.05;
/// [`SCORE_BOUND`] where maps and weights are stored in f16.
pub const HALF_SCORE_BOUND: f64 = 0.005;
/// [`CORNER_BOUND`] where maps and weights are stored in f16.
pub const HALF_CORNER_BOUND: f64 = 0.25;

/// [`SCORE_BOUND`] and [`CORNER_BOUND`] for what a GPU stored, or cores multiplied, in `precision`. But for f32
/// they are no promise of a digit: each map is off by up to 2⁻¹¹ of itself in f16, 2⁻⁹ in bf16, 2⁻⁹ of its range in
/// products of 8 bits, and they are ten times what `smr-gpu compare samples/*.png` shows of corners.
pub fn seen_bounds(precision: Precision) -> [f64; 2] {
    match precision {
        Precision::F32 => [SCORE_BOUND, CORNER_BOUND],
        Precision::F16 => [HALF_SCORE_BOUND, HALF_CORNER_BOUND],
        Precision::Bf16 => [0.007, 2.0],
        Precision::Int8 => [0.011, 5.0],
    }
}

/// How far a score's logit may move at most for that to excuse another choice. A logit that moves by 4δ moves its
/// score by at most δ; but proposals of which nobody sees the scores move further in bf16 and in products of 8 bits:
/// ten times what `smr-gpu compare samples/*.png` shows.
fn most_moved(precision: Precision) -> f64 {
    match precision {
        Precision::F32 | Precision::F16 => 4.0 * seen_bounds(precision)[0],
        Precision::Bf16 => 1.0,
        Precision::Int8 => 6.0,
    }
}

/// One stage on the device and in the reference.
#[derive(Clone, Debug)]
pub struct StageComparison {
    /// Stage name.
    pub stage: String,
    /// Time on the device; `None` where it has no timestamps.
    pub time: Option<Duration>,
    /// Time of the reference.
    pub reference_time: Duration,
    /// What the stage computed, in order.
    pub tensors: Vec<TensorComparison>,
}

impl StageComparison {
    /// The largest error / bound of an element.
    pub fn share(&self) -> f64 {
        self.tensors.iter().map(|t| t.share).fold(0.0, f64::max)
    }

    /// The largest bias / bound, not a number if one is not; `None` where no operation is a sum
    /// of products.
    pub fn bias(&self) -> Option<f64> {
        self.tensors.iter().filter_map(|t| t.bias).reduce(larger)
    }

    /// The largest drift; not a number if one is not.
    pub fn drift(&self) -> Option<f64> {
        self.tensors.iter().filter_map(|t| t.drift).reduce(larger)
    }
}

/// What a user sees of two results.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shift {
    /// The largest difference of the scores of a detection that both found.
    pub score: f64,
    /// The same of a corner, in pixels of the picture.
    pub pixels: f64,
}

/// All comparisons of one run, but for the times.
#[derive(Clone, Debug)]
pub(crate) struct Outcome {
    /// By stage, what it computed.
    pub stages: Vec<Vec<TensorComparison>>,
    pub proposals: ChoiceComparison,
    pub detections: ChoiceComparison,
    pub shift: Shift,
}

/// How a device ran a network: what its bounds depend on.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct How<'a> {
    /// How maps and weights are stored, or what cores multiply.
    pub precision: Precision,
    /// The kernel of each operation on a GPU, in order.
    pub kernels: &'a [&'static str],
    /// How each tensor is stored there; those that are not named, in f32.
    pub written: Option<&'a HashMap<TensorId, Precision>>,
    /// The kernels of cores, in place of a GPU's.
    #[cfg(feature = "cpu")]
    pub plan: Option<&'a CpuPlan>,
}

impl How<'_> {
    /// What the reference makes of what an operation read, the graph's `index`th, and how far the device may be
    /// from it.
    fn expected(&self, index: usize, step: &Step) -> Result<(Vec<Value>, Vec<Tolerance>)> {
        #[cfg(feature = "cpu")]
        if let Some(plan) = self.plan {
            return on_cores(plan, index, step);
        }
        let expected = step.op.reference(&step.read)?;
        let kernel = self.kernels.get(index).and_then(|id| kernels::find(id));
        let written = |id| self.written.and_then(|all| all.get(id).copied()).unwrap_or_default();
        let written: Vec<Precision> = step.outputs.iter().map(written).collect();
        let values = (&step.read[..], &expected[..]);
        let tolerances = kernels::bounds(kernel, step.op, values, self.precision, &written)?;
        Ok((expected, tolerances))
    }
}

/// [`How::expected`] of cores: of what was read as they multiply it.
#[cfg(feature = "cpu")]
fn on_cores(plan: &CpuPlan, index: usize, step: &Step) -> Result<(Vec<Value>, Vec<Tolerance>)> {
    let precision = plan.precision(index);
    let read = step.read.iter().enumerate().map(|(at, value)| match value {
        Value::F32(tensor) if precision != Precision::F32 => {
            let rounded = multiplied(step.op, at, tensor, precision);
            rounded.map_or(Cow::Borrowed(*value), |tensor| Cow::Owned(tensor.into()))
        }
        _ => Cow::Borrowed(*value),
    });
    let read: Vec<Cow<Value>> = read.collect();
    let read: Vec<&Value> = read.iter().map(Cow::as_ref).collect();
    let expected = step.op.reference(&read)?;
    let tolerances = match plan.tolerance(index, &read)? {
        Some(bounds) => vec![Tolerance::Each(bounds)],
        None => step.op.tolerance(&read, &expected)?,
    };
    Ok((expected, tolerances))
}

/// Compares `got`, every tensor that a device computed from `inputs`, with the references, of which
/// `want` are the tensors of the chain. `scale` is the pixels of the picture for one of the network's
/// input.
///
/// # Errors
/// [`Error::Tensor`] if a tensor is missing or has another type than the graph says.
pub(crate) fn compare(
    network: &Network,
    inputs: &[(TensorId, &Value)],
    [got, want]: [&Values; 2],
    scale: f64,
    how: How,
) -> Result<Outcome> {
    let (device, reference) = (Choices::read(network, got)?, Choices::read(network, want)?);
    let mut stages = vec![Vec::new(); network.graph.stages().len()];
    for (index, step) in network.graph.steps(inputs, got).enumerate() {
        let step = step?;
        let (expected, tolerances) = how.expected(index, &step)?;
        let defined = step.op.defined(&expected.iter().collect::<Vec<_>>(), &step.read);
        // Rows that a count limits are those of the count.
        let ids = step.outputs.iter().chain(step.inputs).find(|id| device.ids.contains_key(*id));
        for (i, (id, got)) in step.outputs.iter().zip(&step.wrote).enumerate() {
            let name = network.graph.name(*id);
            let (want_here, tolerance) = (&expected[i], &tolerances[i]);
            let mut tensor = TensorComparison::new(
                name,
                step.op,
                how.precision,
                got,
                want_here,
                tolerance,
                defined[i],
            );
            let want =
                want.get(id).ok_or_else(|| Error::tensor("compare", name, "a value", "none"))?;
            if let (Value::F32(got), Value::F32(want)) = (got, want) {
                tensor.drift = Some(match ids {
                    None => tensor::drift(got.data(), want.data()),
                    Some(count) => {
                        let ids = &device.ids[count];
                        let (ours, theirs) = shared(ids, &reference.ids[count]);
                        let (mut got, mut want) = (pick(got, &ours), pick(want, &theirs));
                        if network.pose == Some(*id) {
                            let classes = ours.iter().map(|row| ids[*row].1);
                            align_yaws(&network.config, classes, &mut got, &mut want);
                        }
                        tensor::drift(&got, &want)
                    }
                });
            }
            stages[step.stage].push(tensor);
        }
    }

    let [score_bound, corner_bound] = seen_bounds(how.precision);
    // An excuse reaches no further than what a user sees may be off.
    let capped = |moved: Moved| Moved {
        score: moved.score.min(score_bound),
        order: moved.order.min(most_moved(how.precision)),
        side: moved.side.min(corner_bound / scale),
    };
    let moved = choice::moved(&device.proposals, &reference.proposals);
    let [ours, theirs] = [got, want].map(|values| float(network, values, network.objectness));
    let moved = Moved { order: moved.order.max(largest_difference(ours?, theirs?)), ..moved };
    let moved = capped(moved);
    let proposals =
        choice::compare(&device.proposals, &reference.proposals, moved, &HashSet::new());
    let moved = choice::moved(&device.detections, &reference.detections);
    let moved = capped(moved);
    let [ours, theirs]: [HashSet<_>; 2] = [&device, &reference]
        .map(|c| c.proposals.chosen.iter().map(|(anchor, _)| *anchor).collect());
    let classes = 1..=network.config.classes.len() as u32;
    let upstream = ours
        .symmetric_difference(&theirs)
        .flat_map(|anchor| classes.clone().map(move |class| (*anchor, class)))
        .collect();
    let mut detections =
        choice::compare(&device.detections, &reference.detections, moved, &upstream);
    let shift = shift(network, [got, want], [&device, &reference], scale)?;
    let seen = [
        ("a score", shift.score, score_bound, ""),
        ("a corner", shift.pixels, corner_bound, " px"),
    ];
    for (what, off, bound, unit) in seen {
        // Not `off > bound`: a NaN must fail.
        let within = off <= bound;
        if !within {
            let line = format!("{what} is {off:.1e}{unit} off, expected at most {bound}{unit}");
            detections.failures.push(line);
        }
    }
    Ok(Outcome { stages, proposals, detections, shift })
}

/// What one run chose, and what each row of a tensor with a count is about.
struct Choices {
    proposals: Side,
    detections: Side,
    /// By the tensor that holds the count.
    ids: HashMap<TensorId, Vec<Id>>,
}

impl Choices {
    fn read(network: &Network, values: &Values) -> Result<Self> {
        let value = |id: TensorId| {
            let name = network.graph.name(id);
            values.get(&id).ok_or_else(|| Error::tensor("compare", name, "a value", "nothing"))
        };
        let anchors = value(network.anchors)?.u32()?.data();
        let count = value(network.proposals.count)?.u32()?.data()[0] as usize;
        let candidates: Vec<Id> = anchors.iter().take(count).map(|a| (*a, 0)).collect();
        let proposals = Side::new(&network.proposals, &candidates, value)?;
        let classes = 1..=network.config.classes.len() as u32;
        let boxes: Vec<Id> = proposals
            .chosen
            .iter()
            .flat_map(|(anchor, _)| classes.clone().map(move |class| (*anchor, class)))
            .collect();
        let detections = Side::new(&network.detections, &boxes, value)?;
        let ids = HashMap::from([
            (network.proposals.count, candidates),
            (network.proposals.kept, proposals.chosen.clone()),
            (network.detections.count, boxes),
            (network.detections.kept, detections.chosen.clone()),
        ]);
        Ok(Self { proposals, detections, ids })
    }
}

/// The places of the rows that are on both sides.
fn shared(ours: &[Id], theirs: &[Id]) -> (Vec<usize>, Vec<usize>) {
    let places: HashMap<&Id, usize> = theirs.iter().enumerate().map(|(i, id)| (id, i)).collect();
    ours.iter().enumerate().filter_map(|(i, id)| Some((i, *places.get(id)?))).unzip()
}

fn pick(tensor: &Tensor, rows: &[usize]) -> Vec<f32> {
    let width: usize = tensor.dims().iter().skip(1).product();
    rows.iter().flat_map(|r| &tensor.data()[r * width..(r + 1) * width]).copied().collect()
}

/// Makes the yaws of poses comparable as numbers: of two the first by whole turns next to the second, so
/// that -179.9° and 179.9° are close. Those of classes without a direction are zero: nobody is told them,
/// and nothing taught the network their vectors, so rounding turns a short one by any angle.
fn align_yaws(
    config: &ModelConfig,
    classes: impl Iterator<Item = u32>,
    got: &mut [f32],
    want: &mut [f32],
) {
    let [got, want] = [got, want].map(|poses| poses.as_chunks_mut::<5>().0);
    for (([got, ..], [want, ..]), class) in got.iter_mut().zip(want).zip(classes) {
        if config.directed.contains(&config.classes[class as usize - 1]) {
            *got += 360.0 * ((*want - *got) / 360.0).round();
        } else {
            (*got, *want) = (0.0, 0.0);
        }
    }
}

fn float<'a>(network: &Network, values: &'a Values, id: TensorId) -> Result<&'a Tensor> {
    let name = network.graph.name(id);
    values.get(&id).ok_or_else(|| Error::tensor("compare", name, "a value", "nothing"))?.f32()
}

fn largest_difference(ours: &Tensor, theirs: &Tensor) -> f64 {
    let pairs = ours.data().iter().zip(theirs.data());
    pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).fold(0.0, larger)
}

/// How far apart what both detected is.
fn shift(
    network: &Network,
    values: [&Values; 2],
    choices: [&Choices; 2],
    scale: f64,
) -> Result<Shift> {
    let [ours, theirs] = choices.map(|c| &c.ids[&network.detections.kept]);
    let (ours, theirs) = shared(ours, theirs);
    let rows = [ours, theirs];
    let largest = |id: TensorId| -> Result<f64> {
        let [a, b] = [0, 1].map(|i| {
            let picked = pick(float(network, values[i], id)?, &rows[i]);
            Tensor::new([picked.len()], picked)
        });
        Ok(largest_difference(&a?, &b?))
    };
    Ok(Shift { score: largest(network.scores)?, pixels: largest(network.boxes)? * scale })
}
