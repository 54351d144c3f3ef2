//! A detector's own network under the instruments of [`crate::verify`]: compared with the reference, timed,
//! tuned, and every stage's tensor.

use std::sync::Arc;
use std::time::Duration;

use web_time::Instant;

use crate::detector::input::Input;
use crate::detector::session::Session;
use crate::detector::{Detections, GpuDetector, compiled};
use crate::engine::gpu::{Deadline, Gpu, Inputs};
use crate::engine::graph::{Graph, TensorId, Values};
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::engine::tuned::Tuned;
use crate::error::{Error, Result};
use crate::sensor::frame::Frame;
use crate::sensor::pixel_format::PixelFormat;
use crate::verify::comparison::{self, ChoiceComparison, How, Shift, StageComparison, larger};
use crate::verify::profile::{self, CommandTime};
use crate::verify::tune;

#[cfg(doc)]
use crate::detector::{Config, Device};

/// Tensors of every stage, by the PyTorch reference's names.
pub type Stages = Vec<(String, Value)>;

/// Finds the snaps in a frame, with the tensor of every stage, cut to the rows that a count made valid. Needs
/// [`Config::keep_stages`].
///
/// # Errors
/// As [`GpuDetector::detect`]; [`Error::Param`] without `keep_stages`.
pub fn stages(detector: &GpuDetector, frame: &Frame) -> Result<(Detections, Stages)> {
    check_keeps_stages(detector)?;
    let deadline = Deadline::after(detector.config().timeout);
    let input = detector.input(frame)?;
    let session = detector.session();
    let (mut values, detections) = match run(&session, &input, deadline) {
        Err(e) => {
            let session = pollster::block_on(detector.recover(&session, e))?;
            run(&session, &input, deadline)?
        }
        found => found?,
    };
    let compiled = pollster::block_on(detector.session().one(input.geometry.size))?;
    let graph = &compiled.network.graph;
    let named = |id: TensorId| Some((graph.name(id).to_owned(), values.remove(&id)?));
    Ok((detections, graph.computed().into_iter().filter_map(named).collect()))
}

/// Runs the network over a whole picture, once more in f32 where f16 does not reach. The values are those of
/// every stage, cut to their valid rows.
fn run(session: &Session, input: &Input<'_>, deadline: Deadline) -> Result<(Values, Detections)> {
    let run_in = |precision: Precision| {
        let compiled =
            pollster::block_on(session.compiled(session.whole(input.geometry.size, precision)))?;
        let network = &compiled.network;
        let inputs = input.inputs(network);
        let (mut values, times) = pollster::block_on(compiled.run(&inputs, deadline))?;
        network.graph.truncate(&inputs, &mut values);
        let found = input.detections(network, &values, times)?;
        Ok((values, Detections { precision, ..found }))
    };
    match run_in(session.precision()) {
        Err(Error::NotFinite { .. }) if session.precision() == Precision::F16 => {
            run_in(Precision::F32)
        }
        found => found,
    }
}

/// Runs a picture on the device and with the f64 reference, and compares every operation and what comes out:
/// see [`comparison`]. Needs [`Config::keep_stages`].
///
/// # Errors
/// As [`GpuDetector::detect`]; [`Error::Param`] without `keep_stages` and for the reference; [`Error::Overflow`] where the
/// device's numbers overflow and those of the reference do not.
pub fn compare(detector: &GpuDetector, frame: &Frame) -> Result<Comparison> {
    let mut input = detector.input(frame)?;
    let compiled = pollster::block_on(detector.session().one(input.geometry.size))?;
    check_keeps_stages(detector)?;
    let network = &compiled.network;
    let precision = detector.session().precision();
    let how = How { precision, ..How::default() };
    let how = match compiled.program() {
        Some(program) => How { kernels: program.kernels(), written: Some(program.stored()), ..how },
        #[cfg(feature = "cpu")]
        None if compiled.plan().is_some() => How { plan: compiled.plan(), ..how },
        None => {
            return Err(Error::param("compare", "device", "a GPU or cores", "the reference"));
        }
    };
    let deadline = Deadline::after(detector.config().timeout);
    let (got, times) = pollster::block_on(compiled.run(&input.inputs(network), deadline))?;
    let found = input.detections(network, &got, times);
    input.start = Instant::now();
    let inputs = input.inputs(network);
    let (want, times) = network.graph.reference(&inputs, &network.graph.computed())?;
    let expected = input.detections(network, &want, times)?;
    let found = match found {
        Err(Error::NotFinite { stage, count }) => {
            return Err(Error::Overflow { stage, count, precision: precision.to_string() });
        }
        found => Detections { precision, ..found? },
    };
    let scale = input.scale().into_iter().map(f64::from).fold(0.0, f64::max);
    let outcome = comparison::compare(network, &inputs, [&got, &want], scale, how)?;
    let time = |stage: &str| found.stages.iter().find(|t| t.stage == stage).map(|t| t.time);
    let stages = expected.stages.iter().zip(outcome.stages);
    let stages = stages.map(|(reference, tensors)| StageComparison {
        stage: reference.stage.clone(),
        time: time(&reference.stage),
        reference_time: reference.time,
        tensors,
    });
    let mm_per_pixel = f64::from(input.view.scale.mm_per_pixel);
    Ok(Comparison {
        stages: stages.collect(),
        proposals: outcome.proposals,
        detections: outcome.detections,
        shift: outcome.shift,
        shift_mm: outcome.shift.pixels * mm_per_pixel,
        found,
        expected,
    })
}

/// Measures which kernels are fastest on `gpu` for a detector's network: see [`tune::tune`]. The detector must
/// hold its weights: one with [`Device::Reference`] does.
///
/// # Errors
/// As [`tune::tune`].
pub fn tune(
    detector: &GpuDetector,
    gpu: &Arc<Gpu>,
    limit: Duration,
    progress: impl FnMut(usize, usize),
) -> Result<Tuned> {
    let precision = detector.config().precision;
    on_noise(detector, |graph, inputs| tune::tune(gpu, graph, inputs, precision, limit, progress))
}

/// Times every command of a detector's network on `gpu`: see [`profile::commands`]. The detector must hold its
/// weights: one with [`Device::Reference`] does. `remark` hears what [`GpuDetector::remarks`] would tell of one
/// on `gpu`.
///
/// # Errors
/// As [`profile::commands`].
pub fn profile(
    detector: &GpuDetector,
    gpu: &Arc<Gpu>,
    runs: usize,
    remark: impl FnMut(String),
) -> Result<Vec<CommandTime>> {
    let mut remarks = Vec::new();
    let kernels = compiled::choose(detector.config(), gpu, &mut remarks);
    remarks.into_iter().for_each(remark);
    let how = (&kernels, detector.config().precision);
    on_noise(detector, |graph, inputs| profile::commands(gpu, graph, inputs, how, runs))
}

/// Gives a detector's graph to `work`, with a picture of the sensor's size in which there is something
/// everywhere.
fn on_noise<T>(
    detector: &GpuDetector,
    work: impl FnOnce(&Graph, &Inputs<'_>) -> Result<T>,
) -> Result<T> {
    let frame = detector.config().sensor.as_ref().and_then(|sensor| sensor.frame);
    let [width, height] = frame.unwrap_or([1000, 1000]);
    let pixel = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 24) as u8;
    let pixels: Vec<u8> = (0..width as usize * height as usize).map(pixel).collect();
    let noise = Frame::new(pixels, width, height, PixelFormat::Gray8);
    let input = detector.input(&noise)?;
    let compiled = pollster::block_on(detector.session().one(input.geometry.size))?;
    let network = &compiled.network;
    work(&network.graph, &input.inputs(network))
}

fn check_keeps_stages(detector: &GpuDetector) -> Result<()> {
    match detector.config().keep_stages {
        true => Ok(()),
        false => Err(Error::param("detect", "keep_stages", true, false)),
    }
}

/// What one picture gives on a device and in the f64 reference.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The network's stages, in order.
    pub stages: Vec<StageComparison>,
    /// The kernels of the proposals.
    pub proposals: ChoiceComparison,
    /// The kernels of the detections.
    pub detections: ChoiceComparison,
    /// How far apart the detections are that both found.
    pub shift: Shift,
    /// [`Shift::pixels`] in millimetres on the gel.
    pub shift_mm: f64,
    /// What the device found.
    pub found: Detections,
    /// What the reference found.
    pub expected: Detections,
}

impl Comparison {
    /// What is wrong, a line each; empty if the device does as the reference.
    pub fn failures(&self) -> impl Iterator<Item = &str> {
        let tensors = self.stages.iter().flat_map(|s| &s.tensors);
        let tensors = tensors.filter_map(|t| t.failure.as_ref());
        let tuned_kernels = self.proposals.failures.iter().chain(&self.detections.failures);
        tensors.chain(tuned_kernels).map(String::as_str)
    }

    /// Differences that rounding excuses, a line each.
    pub fn excused(&self) -> impl Iterator<Item = &str> {
        self.proposals.excused.iter().chain(&self.detections.excused).map(String::as_str)
    }

    /// The largest error / bound of an element on its operation's own inputs.
    pub fn share(&self) -> f64 {
        self.stages.iter().map(StageComparison::share).fold(0.0, f64::max)
    }

    /// The largest bias / bound of a tensor; not a number if one is not.
    pub fn bias(&self) -> f64 {
        self.stages.iter().filter_map(StageComparison::bias).fold(0.0, larger)
    }

    /// The largest drift of a stage; not a number if one is not.
    pub fn drift(&self) -> f64 {
        self.stages.iter().filter_map(StageComparison::drift).fold(0.0, larger)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::rect::Rect;
    use crate::sensor::scale::Scale;
    use crate::verify::comparison::TensorComparison;

    #[test]
    fn a_figure_that_is_no_number_is_the_largest() {
        let stage = |value: f64| {
            let (bias, drift) = (Some(value), Some(value));
            let tensor =
                TensorComparison { name: "t".into(), share: 0.0, bias, drift, failure: None };
            let (time, reference_time) = (None, Duration::ZERO);
            StageComparison { stage: "s".into(), time, reference_time, tensors: vec![tensor] }
        };
        let found = Detections {
            detections: Vec::new(),
            width: 1,
            height: 1,
            gel: Rect { x: 0, y: 0, width: 1, height: 1 },
            gel_assumed: false,
            part: Rect { x: 0, y: 0, width: 1, height: 1 },
            scale: Scale::stated(1.0),
            precision: Precision::F32,
            contact: None,
            regions: None,
            without_deepest: false,
            looked_again: false,
            reused: false,
            proposals: 0,
            stages: Vec::new(),
            wall: Duration::ZERO,
        };
        let compared = |values: &[f64]| Comparison {
            stages: values.iter().copied().map(stage).collect(),
            proposals: ChoiceComparison::default(),
            detections: ChoiceComparison::default(),
            shift: Shift::default(),
            shift_mm: 0.0,
            found: found.clone(),
            expected: found.clone(),
        };
        let sound = compared(&[0.5, 2.0, 1.0]);
        assert_eq!((sound.bias(), sound.drift()), (2.0, 2.0));
        let broken = compared(&[0.5, f64::NAN, 1.0]);
        assert!(broken.bias().is_nan() && broken.drift().is_nan());
    }
}
