//! `smr-gpu compare`: holds the whole network on a device to the f64 reference.

use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;
use smr_gpu::verify::{self, Comparison};
use smr_gpu::{Frame, GpuDetector, Savings, Scale};

use super::detector::{self, Assumed, BoxArgs, DeviceArgs, NetworkArgs, fraction};
use super::exit::{Exit, Failure};
use super::message::{remark, tell};
use super::output::{count, json_line, line};
use super::printable::printable;
use super::source::{Source, column_width, expand_all};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu compare picture.png
  smr-gpu compare in/ --device cpu --precision int8
  smr-gpu compare picture.png --weights small --json";

/// Is the whole network right on my pictures? Compare it with its f64 reference
///
/// Each operation is compared on the device's own inputs, within its error bound. The detections are compared with
/// those that the reference finds in the picture by itself. Prints a line for each stage of one picture, or a line for
/// each of several pictures. Fails if a bound is passed or rounding does not explain a difference.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Pictures, folders of pictures, patterns such as 'in/*.png', or `-` for one picture on stdin.
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<PathBuf>,

    /// Print one line of JSON for each picture.
    #[arg(help_heading = "Output", long)]
    json: bool,

    /// Compare the detections with a score above this (0 to 1).
    #[arg(help_heading = "Output", long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    #[arg(allow_negative_numbers = true)]
    conf: f32,

    #[command(flatten)]
    network: NetworkArgs,

    #[command(flatten)]
    boxes: BoxArgs,

    #[command(flatten)]
    device: DeviceArgs,
}

/// One picture's comparison, as `--json` prints it. An infinite number is null.
#[derive(Serialize)]
struct Record<'a> {
    file: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    file_base64: Option<String>,
    #[serde(flatten)]
    scale: Scale,
    adapter: String,
    ok: bool,
    stages: Vec<Stage<'a>>,
    snaps: usize,
    expected_snaps: usize,
    score_shift: f64,
    pixel_shift: f64,
    mm_shift: f64,
    excused: Vec<&'a str>,
    failures: Vec<&'a str>,
}

#[derive(Serialize)]
struct Stage<'a> {
    stage: &'a str,
    ms: Option<f64>,
    reference_ms: f64,
    share: f64,
    bias: Option<f64>,
    drift: Option<f64>,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let device = args.device.but_the_reference()?;
    let (sources, mut exit) = expand_all(&args.sources, false)?;
    let mut config = args.network.config(Savings::NONE)?;
    config.device = device;
    if sources.is_empty() {
        return Ok(exit);
    }
    config.score = args.conf;
    config.iou = args.boxes.iou;
    config.keep_stages = true;
    let detector = detector::open(config)?;
    remark(format!("{} against the f64 reference", detector.adapter()));
    let alone = sources.len() == 1;
    if !alone && !args.json {
        heading(&sources)?;
    }
    let mut assumed = Assumed::default();
    for source in &sources {
        let comparison = match compare(&detector, source) {
            Ok(comparison) => comparison,
            Err(failure) if failure.is_of_one_picture() => {
                exit = exit.max(failure.told().exit);
                continue;
            }
            Err(failure) => return Err(failure.told()),
        };
        for what in assumed.remarks(source, &comparison.found) {
            remark(what);
        }
        match (args.json, alone) {
            (true, _) => json_line(&record(source, &detector, &comparison))?,
            (false, true) => report(&comparison)?,
            (false, false) => summary(source, &sources, &comparison)?,
        }
        for failure in comparison.failures() {
            tell(format!("{source}: {failure}"));
            exit = exit.max(Exit::Inputs);
        }
    }
    Ok(exit)
}

fn compare(detector: &GpuDetector, source: &Source) -> Result<Comparison, Failure> {
    let picture = source
        .picture()
        .map_err(|message| Failure::new(Exit::Inputs, format!("{source}: {message}")))?;
    verify::compare(detector, &Frame::from(&picture)).map_err(|e| Failure::about(source, &e))
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

fn record<'a>(
    source: &Source,
    detector: &'a GpuDetector,
    comparison: &'a Comparison,
) -> Record<'a> {
    let failures: Vec<_> = comparison.failures().collect();
    let stages = comparison.stages.iter().map(|stage| Stage {
        stage: &stage.stage,
        ms: stage.time.map(milliseconds),
        reference_ms: milliseconds(stage.reference_time),
        share: stage.share(),
        bias: stage.bias(),
        drift: stage.drift(),
    });
    Record {
        file: source.to_string(),
        file_base64: source.base64(),
        scale: comparison.found.scale,
        adapter: detector.adapter(),
        ok: failures.is_empty(),
        stages: stages.collect(),
        snaps: comparison.found.detections.len(),
        expected_snaps: comparison.expected.detections.len(),
        score_shift: comparison.shift.score,
        pixel_shift: comparison.shift.pixels,
        mm_shift: comparison.shift_mm,
        excused: comparison.excused().collect(),
        failures,
    }
}

/// The table of one picture: a line a stage.
fn report(comparison: &Comparison) -> Result<(), Failure> {
    let [stage, device, reference] = ["stage", "ms", "f64 ms"];
    line(format!(
        "{stage:<20}  {device:>8}  {reference:>8}  {:>8}  {:>8}  {:>8}",
        "error", "bias", "drift"
    ))?;
    let number = |value: Option<f64>, digits: usize| match value {
        Some(value) => format!("{value:.digits$}"),
        None => "-".into(),
    };
    for stage in &comparison.stages {
        let verdict = match stage.tensors.iter().any(|t| t.failure.is_some()) {
            true => "  FAILED",
            false => "",
        };
        line(format!(
            "{:<20}  {:>8}  {:>8.1}  {:>8.4}  {:>8}  {:>8}{verdict}",
            stage.stage,
            number(stage.time.map(milliseconds), 1),
            milliseconds(stage.reference_time),
            stage.share(),
            number(stage.bias(), 4),
            stage.drift().map_or("-".into(), |d| format!("{d:.1e}")),
        ))?;
    }
    let [wall, reference] = [&comparison.found, &comparison.expected].map(|d| milliseconds(d.wall));
    line(format!("{:<20}  {wall:>8.1}  {reference:>8.1}", "all"))?;
    let (found, expected) = (&comparison.found.detections, &comparison.expected.detections);
    let shift = comparison.shift;
    line(format!(
        "{}, the reference {}; scores within {:.1e}, corners within {:.1e} px, {:.1e} mm",
        count(found.len(), "snap"),
        expected.len(),
        shift.score,
        shift.pixels,
        comparison.shift_mm
    ))?;
    for excuse in comparison.excused() {
        line(format!("rounding: {excuse}"))?;
    }
    Ok(())
}

fn heading(sources: &[Source]) -> Result<(), Failure> {
    let width = column_width(sources);
    let [file, error, bias, drift] = ["file", "error", "bias", "drift"];
    line(format!(
        "{file:width$}  {error:>7}  {bias:>7}  {drift:>7}  snaps  {:>7}  {:>7}  {:>7}  rounding",
        "score", "px", "mm"
    ))
}

fn summary(source: &Source, sources: &[Source], comparison: &Comparison) -> Result<(), Failure> {
    let shift = comparison.shift;
    let verdict = if comparison.failures().next().is_some() { "  FAILED" } else { "" };
    line(format!(
        "{:w$}  {:>7.4}  {:>7.4}  {:>7.1e}  {:>5}  {:>7.1e}  {:>7.1e}  {:>7.1e}  {:>8}{verdict}",
        printable(source),
        comparison.share(),
        comparison.bias(),
        comparison.drift(),
        comparison.found.detections.len(),
        shift.score,
        shift.pixels,
        comparison.shift_mm,
        comparison.excused().count(),
        w = column_width(sources)
    ))
}
