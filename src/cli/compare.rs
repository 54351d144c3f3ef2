//! `smr-gpu compare`: holds the whole network on a device, stage by stage, to the f64 reference.

use std::path::PathBuf;

use smr_gpu::comparison::STAGE_BOUND;
use smr_gpu::{Comparison, GpuDetector};

use super::detector::{DetectorArgs, fraction, gpu_only};
use super::exit::{Exit, Failure};
use super::output::{line, tell};
use super::picture;
use super::source::Source;

/// Hold the whole network to its f64 reference on one picture, stage by stage
///
/// Prints each stage's time on the device and in the reference, and its largest relative L2 error;
/// fails past 1e-5, or if the two find other snaps or the same in another order.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A picture, or `-` for one on stdin.
    picture: PathBuf,

    /// Compare the detections with a score above this (0 to 1).
    #[arg(long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    conf: f32,

    #[command(flatten)]
    detector: DetectorArgs,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let source = Source::from(args.picture.as_path());
    let picture = picture::read(&source)
        .map_err(|message| Failure::new(Exit::Inputs, format!("{source}: {message}")))?;
    let mut config = args.detector.config()?;
    gpu_only(&config.device)?;
    config.score = args.conf;
    config.keep_stages = true;
    let detector = GpuDetector::new(config)?;
    tell(format!("{} against the CPU reference (f64)", detector.adapter()));
    let result = detector.compare(&picture);
    let comparison = result.map_err(|e| Failure::about(&source, &e).told())?;
    report(&comparison)
}

fn report(comparison: &Comparison) -> Result<Exit, Failure> {
    line(format!("{:<20}  {:>9}  {:>9}  {:>10}", "stage", "GPU ms", "CPU ms", "error"))?;
    let milliseconds = |d: std::time::Duration| d.as_secs_f64() * 1e3;
    let mut exit = Exit::Done;
    for stage in &comparison.stages {
        let error = stage.error();
        // Not `error > bound`: a NaN must fail.
        let within = error <= STAGE_BOUND;
        let verdict = if within { "" } else { "  FAILED" };
        let time = stage.time.map_or("-".into(), |t| format!("{:.1}", milliseconds(t)));
        let reference = milliseconds(stage.reference_time);
        line(format!("{:<20}  {time:>9}  {reference:>9.1}  {error:>10.1e}{verdict}", stage.stage))?;
        if !within {
            exit = Exit::Inputs;
        }
    }
    let [wall, reference] = [&comparison.found, &comparison.expected].map(|d| milliseconds(d.wall));
    line(format!("{:<20}  {wall:>9.1}  {reference:>9.1}", "all"))?;
    match comparison.differences() {
        Some((score, pixels)) => {
            let snaps = comparison.found.detections.len();
            line(format!(
                "{snaps} snaps, scores within {score:.1e}, corners within {pixels:.1e} px"
            ))?;
        }
        None => {
            let (found, expected) = (&comparison.found.detections, &comparison.expected.detections);
            let (found, expected) = (found.len(), expected.len());
            line(format!(
                "FAILED: {found} snaps, expected the reference's {expected} in its order"
            ))?;
            exit = Exit::Inputs;
        }
    }
    Ok(exit)
}
