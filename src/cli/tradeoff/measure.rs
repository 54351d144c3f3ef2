//! Runs setups on the same pictures in turn, and holds what they find to f64 and to the labels.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use image::DynamicImage;
use indicatif::ProgressBar;
use smr_gpu::engine::tensor::Value;
use smr_gpu::evaluation::metrics::box_iou;
use smr_gpu::evaluation::tradeoff::{Measured, Quality, Setup, Shift, Spread, StageError, Table};
use smr_gpu::evaluation::{LEAST_SCORE, Seen, figures};
use smr_gpu::verify::comparison::relative_l2;
use smr_gpu::verify::{self, Stages};
use smr_gpu::{Config, Detection, Detections, Frame, GpuDetector};

use super::super::detector;
use super::super::eval::Labelled;
use super::super::exit::{Exit, Failure};
use super::super::message::remark;
use super::super::output;
use super::super::source::Source;
use super::setups::{BATCH, Plan, configured, weights_of};
use super::{SCORE, peak};

/// Two boxes are of the same snap if they overlap by this much.
const SAME: f64 = 0.5;
/// Pictures whose stages are compared.
const STAGE_PICTURES: usize = 2;
/// Of the pictures, the share after which combinations join.
const FIRST: usize = 4;

/// A picture, and what the base finds in it in f64.
struct Sample<'a> {
    labelled: &'a Labelled,
    picture: DynamicImage,
    base: Detections,
}

/// A setup at work.
struct Runner {
    setup: Setup,
    detector: GpuDetector,
    peak_bytes: Option<u64>,
    stages: Vec<StageError>,
    wall_ms: Vec<f64>,
    device_ms: Vec<f64>,
    /// By picture.
    found: Vec<Detections>,
}

/// Measures the plan's setups on the pictures, until all have seen all or `stopped` is set.
///
/// # Errors
/// What a setup's detector returns, and a picture that cannot be read.
pub(super) fn measure(
    plan: &Plan,
    pictures: &[Labelled],
    classes: &[String],
    stopped: &AtomicBool,
) -> Result<Table, Failure> {
    let stop = || stopped.load(Ordering::Relaxed);
    let progress = bar(pictures.len(), "the base in f64");
    let reference = build(&Setup { device: "reference".into(), ..plan.base.clone() }, false)?;
    let mut samples = Vec::new();
    for labelled in pictures {
        if stop() {
            break;
        }
        let picture = labelled
            .source
            .picture()
            .map_err(|e| Failure::new(Exit::Inputs, format!("{}: {e}", labelled.source)))?;
        let base = detect_one(&reference, labelled, &picture)?;
        samples.push(Sample { labelled, picture, base });
        progress.inc(1);
    }
    drop(reference);
    progress.finish_and_clear();

    // As many as run at a time, where there are so many.
    let first = samples.len().div_ceil(FIRST).max(BATCH).min(samples.len());
    let mut runners = Vec::new();
    let mut goldens = HashMap::new();
    prepare(&plan.single, &samples, &mut goldens, &mut runners, &stop)?;
    run(&mut runners, &samples[..first], &stop);
    let (rows, seen) = judged(&mut runners, &samples, classes);
    let before = plan.table(rows, seen, stop());
    if before.stopped {
        return Ok(before);
    }
    let mut joined = Vec::new();
    prepare(&plan.combinations(&before), &samples, &mut goldens, &mut joined, &stop)?;
    // They see what the others have seen, side by side with them.
    runners.append(&mut joined);
    runners.iter_mut().for_each(Runner::forget);
    run(&mut runners, &samples, &stop);
    let (rows, seen) = judged(&mut runners, &samples, classes);
    // Stopped soon after, the first round says more.
    match seen < before.pictures {
        true => Ok(Table { stopped: true, ..before }),
        false => Ok(plan.table(rows, seen, stop())),
    }
}

/// A row each, on the pictures that all have seen: a setup that was stopped on its way saw fewer.
fn judged(
    runners: &mut [Runner],
    samples: &[Sample],
    classes: &[String],
) -> (Vec<Measured>, usize) {
    let seen = runners.iter().map(|r| r.found.len()).min().unwrap_or(0);
    runners.iter_mut().for_each(|r| r.found.truncate(seen));
    let rows = runners.iter().filter(|_| seen > 0).map(|r| row(r, samples, classes));
    (rows.collect(), seen)
}

/// Builds the setups' detectors, and measures what takes a process or a build of its own. A setup that
/// cannot run here is left out, with a line that says why.
///
/// # Errors
/// What the reference of a network returns.
fn prepare(
    setups: &[Setup],
    samples: &[Sample],
    goldens: &mut HashMap<String, Vec<Stages>>,
    runners: &mut Vec<Runner>,
    stop: &dyn Fn() -> bool,
) -> Result<(), Failure> {
    let progress = bar(setups.len(), "making ready");
    for setup in setups {
        if stop() || samples.is_empty() {
            break;
        }
        let few = &samples[..samples.len().min(STAGE_PICTURES)];
        let golden = match goldens.get(&setup.what()) {
            // Where less is computed there are other stages.
            _ if !setup.leave_out.is_empty() => &[][..],
            Some(golden) => golden,
            None => {
                let reference =
                    build(&Setup { device: "reference".into(), ..setup.clone() }, true)?;
                let golden: Result<Vec<_>, _> = few.iter().map(|s| stages(&reference, s)).collect();
                goldens.entry(setup.what()).or_insert(golden?)
            }
        };
        progress.set_message(format!("making ready: {}", setup.name()));
        match Runner::new(setup, few, golden) {
            Ok(runner) => runners.push(runner),
            Err(e) => left_out(setup, &e),
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

/// A bar of so many steps of something.
fn bar(steps: usize, what: &str) -> ProgressBar {
    let bar = output::bar(steps as u64, "{pos}/{len} {msg} {wide_bar} {eta} left");
    bar.with_message(what.to_owned())
}

fn left_out(setup: &Setup, why: &Failure) {
    let why = why.message.as_deref().unwrap_or("no reason");
    remark(format!("left out: {}: {why}", setup.name()));
}

/// Each picture by each setup in turn, so that a machine that changes its speed does so for all. A setup
/// that fails on one is left out from there on.
fn run(runners: &mut Vec<Runner>, samples: &[Sample], stop: &dyn Fn() -> bool) {
    let progress = bar(samples.len(), "pictures");
    for at in 0..samples.len() {
        runners.retain_mut(|runner| {
            let reached = if stop() { Ok(()) } else { runner.reach(at, samples) };
            reached.inspect_err(|e| left_out(&runner.setup, e)).is_ok()
        });
        progress.inc(1);
    }
    progress.finish_and_clear();
}

impl Runner {
    /// A setup made ready. Its stages are compared on `few` pictures with those of the f64 reference,
    /// `golden`.
    fn new(setup: &Setup, few: &[Sample], golden: &[Stages]) -> Result<Self, Failure> {
        let stages = if golden.is_empty() {
            Vec::new()
        } else {
            let keeping = build(setup, true)?;
            let got: Result<Vec<_>, _> = few.iter().map(|s| stages(&keeping, s)).collect();
            stage_errors(&got?, golden)
        };
        let detector = build(setup, false)?;
        // Warm: compiled, uploaded, its buffers there.
        detect_one(&detector, few[0].labelled, &few[0].picture)?;
        let peak_bytes = match &few[0].labelled.source {
            Source::File(file) => peak::of(setup, file)
                .inspect_err(|e| remark(format!("no peak memory of {}: {e}", setup.name())))
                .ok()
                .flatten(),
            _ => None,
        };
        let (wall_ms, device_ms, found) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { setup: setup.clone(), detector, peak_bytes, stages, wall_ms, device_ms, found })
    }

    fn forget(&mut self) {
        self.wall_ms.clear();
        self.device_ms.clear();
        self.found.clear();
    }

    /// Looks at picture `at`, or with several at a time at those up to it when they are together.
    fn reach(&mut self, at: usize, samples: &[Sample]) -> Result<(), Failure> {
        let batch = self.setup.batch.max(1);
        let last = at + 1 == samples.len();
        if !(at + 1).is_multiple_of(batch) && !last {
            return Ok(());
        }
        let group = &samples[self.found.len()..=at];
        if !self.setup.leave_out.is_empty() {
            // What a part's size needs is built once, at its first look.
            for sample in group {
                detect_one(&self.detector, sample.labelled, &sample.picture)?;
            }
        }
        let frames = group.iter().map(|s| frame(s.labelled, &s.picture));
        let start = Instant::now();
        let found: Vec<_> = match group {
            [_] => frames.map(|f| self.detector.detect(&f)).collect(),
            _ => self.detector.detect_many(frames.collect::<Vec<_>>()).collect(),
        };
        let ms = start.elapsed().as_secs_f64() * 1e3 / group.len() as f64;
        for (found, sample) in found.into_iter().zip(group) {
            let found = found.map_err(|e| Failure::about(&sample.labelled.source, &e))?;
            // The host brings the frame.
            let stages = found.stages.iter().filter(|s| s.stage != "frame");
            let device: f64 = stages.map(|s| s.time.as_secs_f64() * 1e3).sum();
            self.device_ms.extend((device > 0.0).then_some(device));
            // The last of the pictures may be fewer.
            self.wall_ms.extend((group.len() == batch).then_some(ms));
            self.found.push(found);
        }
        Ok(())
    }
}

fn build(setup: &Setup, keep_stages: bool) -> Result<GpuDetector, Failure> {
    let (config, _) = configured(setup, Config::with_weights(weights_of(setup)?))?;
    // What is doubtful depends on the score that counts.
    let counts_above = Some(SCORE);
    detector::open(Config { score: LEAST_SCORE as f32, counts_above, keep_stages, ..config })
}

fn frame<'a>(labelled: &Labelled, picture: &'a DynamicImage) -> Frame<'a> {
    labelled.picture.state(Frame::from(picture))
}

fn detect_one(
    detector: &GpuDetector,
    labelled: &Labelled,
    picture: &DynamicImage,
) -> Result<Detections, Failure> {
    let found = detector.detect(frame(labelled, picture));
    found.map_err(|e| Failure::about(&labelled.source, &e))
}

fn stages(detector: &GpuDetector, sample: &Sample) -> Result<Stages, Failure> {
    let found = verify::stages(detector, &frame(sample.labelled, &sample.picture));
    Ok(found.map_err(|e| Failure::about(&sample.labelled.source, &e))?.1)
}

/// The first tensor whose rows are chosen: near enough scores change places, and rows of other boxes say
/// nothing of an error.
const CHOSEN: &str = "proposals";

/// The largest errors of the maps that stages hand on, by their names, up to the choice of proposals.
fn stage_errors(got: &[Stages], want: &[Stages]) -> Vec<StageError> {
    let mut errors: Vec<StageError> = Vec::new();
    for (got, want) in got.iter().zip(want) {
        for (name, want) in want.iter().take_while(|(name, _)| name != CHOSEN) {
            // A stage is called as its last tensor; what lies between has a layer's name.
            let is_stage = name.split('.').count() <= 2 && !name.ends_with("not_finite");
            let got = got.iter().find(|(n, _)| n == name).map(|(_, value)| value);
            let (true, Some(Value::F32(got)), Value::F32(want)) = (is_stage, got, want) else {
                continue;
            };
            // Rows that a count limits may be more or fewer.
            if got.shape() != want.shape() {
                continue;
            }
            let pairs = got.data().iter().zip(want.data());
            let largest = pairs.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
            let relative_l2 = relative_l2(got.data(), want.data());
            match errors.iter_mut().find(|e| e.stage == *name) {
                Some(e) => {
                    e.relative_l2 = e.relative_l2.max(relative_l2);
                    e.largest = e.largest.max(largest);
                }
                None => errors.push(StageError { stage: name.clone(), relative_l2, largest }),
            }
        }
    }
    errors
}

fn row(runner: &Runner, samples: &[Sample], classes: &[String]) -> Measured {
    let none = Spread { median: f64::INFINITY, percentile_95: f64::INFINITY, worst: f64::INFINITY };
    Measured {
        setup: runner.setup.clone(),
        wall_ms: Spread::of(&runner.wall_ms).unwrap_or(none),
        device_ms: Spread::of(&runner.device_ms),
        peak_bytes: runner.peak_bytes,
        stages: runner.stages.clone(),
        shift: shift(&runner.found, samples),
        quality: quality(&runner.found, samples, classes),
    }
}

fn shown(found: &Detections) -> impl Iterator<Item = &Detection> {
    found.detections.iter().filter(|d| d.score > SCORE)
}

fn iou(a: &Detection, b: &Detection) -> f64 {
    box_iou(a.bbox.map(f64::from), b.bbox.map(f64::from))
}

/// What was found against what the base finds.
fn shift(found: &[Detections], samples: &[Sample]) -> Shift {
    let (mut mm, mut score, mut total) = (Vec::new(), Vec::new(), Shift::default());
    for (found, sample) in found.iter().zip(samples) {
        let mut free: Vec<&Detection> = shown(found).collect();
        for base in shown(&sample.base) {
            total.boxes += 1;
            let same = free.iter().enumerate().filter(|(_, d)| d.class == base.class);
            let best = same.map(|(i, d)| (i, iou(d, base))).max_by(|a, b| a.1.total_cmp(&b.1));
            match best.filter(|(_, iou)| *iou >= SAME) {
                Some((i, _)) => {
                    let other = free.swap_remove(i);
                    let [x, y] = [0, 1].map(|k| f64::from(other.center_mm[k] - base.center_mm[k]));
                    mm.push(x.hypot(y));
                    score.push(f64::from((other.score - base.score).abs()));
                }
                None => {
                    mm.push(f64::INFINITY);
                    total.lost += 1;
                }
            }
        }
        total.gained += free.len();
    }
    Shift { mm: Spread::of(&mm), score: Spread::of(&score), ..total }
}

/// What was found against the labels; `None` without any.
fn quality(found: &[Detections], samples: &[Sample], classes: &[String]) -> Option<Quality> {
    let seen: Vec<Seen> =
        found.iter().zip(samples).map(|(f, s)| Seen::new(&s.labelled.picture, f)).collect();
    let every: Vec<usize> = (0..classes.len()).collect();
    let figures = figures(&seen, &every, SCORE.into());
    Some(Quality {
        iou: figures.mean_best_iou?,
        ap50: figures.ap50?,
        center_error_mm: figures.center_error_mm.median.unwrap_or(f64::INFINITY),
        iou_95: figures.interval_95.mean_best_iou,
        center_error_95_mm: figures.interval_95.center_median_mm,
    })
}
