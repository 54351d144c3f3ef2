//! `smr-gpu tradeoff`: error against run time of the ways to run the networks, on this machine.

mod measure;
mod peak;
mod plot;
mod report;
mod setups;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use smr_gpu::evaluation::tradeoff::{Limit, Table};
use smr_gpu::files::Outputs;
use smr_gpu::{Config, Device, WeightSource};

pub(super) use peak::{Args as PeakArgs, run as run_peak};
pub(super) use setups::configured;

use super::detector::{DetectorArgs, exact_fraction, known, number, open_gpu};
use super::eval::read_labels;
use super::exit::{Exit, Failure, as_typed};
use super::message::remark;
use super::output::line;

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu tradeoff --data test --out out
  smr-gpu tradeoff --data test --out out --limit 20 --device cpu
  smr-gpu detect picture.png --tradeoff out/tradeoff.json --max-shift-mm 0.1";

/// How fast can it be, for how much error? Measure the ways to run the networks
///
/// Runs each configuration on the same pictures, in turns, so that all meet the same machine: first those that differ
/// from the base by one thing (network, size of the input, what is left out, device, precision, kernels, pictures at
/// a time), then
/// combinations of the best. Writes tradeoff.json, tradeoff.csv, tradeoff.md, tradeoff.png and tradeoff.svg. The last
/// line recommends a configuration for one picture at a time; `smr-gpu detect --tradeoff tradeoff.json` uses it.
/// Ctrl-C keeps what was measured.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folder with annotations.json and the pictures.
    #[arg(help_heading = "Input", long, value_name = "DIR")]
    data: PathBuf,

    /// Folder for the tables and plots; made if missing.
    #[arg(help_heading = "Output", long, value_name = "DIR")]
    out: PathBuf,

    /// Look only at the N pictures with the lowest ids.
    #[arg(help_heading = "Input", long, default_value_t = 100, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    #[arg(allow_negative_numbers = true)]
    limit: u32,

    /// The networks, the base first [default: those of `large` and `small` that there are].
    #[arg(
        help_heading = "Model",
        long,
        value_name = "large|small|NAME|FILE",
        value_delimiter = ','
    )]
    weights: Vec<String>,

    /// Longer sides of the gel in the network's input, in pixels, multiples of 32, beside the scale that
    /// the weights know.
    #[arg(
        help_heading = "Model",
        long,
        value_name = "PIXELS",
        value_delimiter = ',',
        default_value = "160,192,224,256,288,384"
    )]
    #[arg(value_parser = super::detector::input_size, allow_negative_numbers = true)]
    sizes: Vec<usize>,

    /// Recommend the fastest configuration with 95 % of its boxes within this distance of those of the base in
    /// f64.
    #[arg(help_heading = "Output", long, value_name = "MM", conflicts_with = "min_iou", value_parser = millimetres)]
    #[arg(allow_negative_numbers = true)]
    max_shift_mm: Option<f64>,

    /// Recommend the fastest configuration whose mean overlap with the labels is at least this.
    #[arg(help_heading = "Output", long, value_name = "IOU", value_parser = exact_fraction)]
    #[arg(allow_negative_numbers = true)]
    min_iou: Option<f64>,

    /// The adapter to measure beside the CPU: `auto` for the best, including software renderers; its index in
    /// `smr-gpu devices`, or part of its name; `cpu` for none.
    #[arg(
        help_heading = "Device",
        long,
        default_value = "auto",
        value_name = "auto|INDEX|NAME|cpu"
    )]
    #[arg(value_parser = known::<Device>, allow_negative_numbers = true)]
    device: Device,
}

/// Boxes that count have a score above this.
const SCORE: f32 = 0.5;
/// What is recommended where nothing else is asked for: a tenth of a millimetre.
pub(super) const SHIFT_MM: f64 = 0.1;

/// Parses a length.
///
/// # Errors
/// In words.
pub(super) fn millimetres(text: &str) -> Result<f64, String> {
    let [least, most] = [0.0, 1000.0];
    number(text, [least, most])
        .map_err(|_| format!("expected a number of millimetres from {least} to {most}"))
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let failed =
        |e: std::io::Error| Failure::new(Exit::Output, format!("{}: {e}", args.out.display()));
    std::fs::create_dir_all(&args.out).map_err(failed)?;
    let file = |extension: &str| args.out.join(format!("tradeoff.{extension}"));
    let extensions = ["json", "csv", "md", "png", "svg"];
    let weights = setups::weights(&args.weights)?;
    let mut outputs = Outputs::sparing(weights.iter().filter_map(|(_, found, _)| found.file()));
    let gpu = match &args.device {
        Device::Auto => match open_gpu(&"gpu".parse::<Device>()?) {
            Ok(gpu) => gpu,
            Err(failure) => {
                failure.told();
                None
            }
        },
        device => open_gpu(device)?,
    };
    let gpu = gpu.map(|gpu| (gpu, args.device.clone()));
    let classes = classes_of(&weights[0].1)?;
    let mut pictures = read_labels(&args.data, &classes, &mut outputs)?;
    outputs.check_all(extensions.map(file))?;
    pictures.truncate(args.limit as usize);
    if args.min_iou.is_some() && pictures.iter().all(|picture| picture.picture.labels.is_empty()) {
        let none = "--min-iou: expected pictures with labelled snaps, got none";
        return Err(Failure::new(Exit::Inputs, none));
    }

    let stopped = Arc::new(AtomicBool::new(false));
    let stop = stopped.clone();
    let handler = ctrlc::set_handler(move || stop.store(true, Ordering::Relaxed));
    if let Err(e) = handler {
        remark(format!("Ctrl-C will lose what was measured: {e}"));
    }
    let plan = setups::Plan::new(&weights, &args.sizes, gpu.as_ref(), pictures.len());
    let table = measure::measure(&plan, &pictures, &classes, &stopped)?;

    if table.stopped && table.rows.is_empty() {
        remark("Stopped before the configurations had seen a picture: nothing was measured.");
        return Ok(Exit::Interrupted);
    }
    let json = serde_json::to_vec_pretty(&table)
        .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", file("json").display())))?;
    let plots = plot::draw(&table).map_err(|e| Failure::new(Exit::Output, format!("plot: {e}")))?;
    let texts = [json, report::csv(&table).into_bytes(), report::markdown(&table).into_bytes()];
    for (extension, bytes) in extensions.iter().zip(texts.iter().chain([&plots.png, &plots.svg])) {
        outputs.write(&file(extension), bytes)?;
    }
    report::markdown(&table).trim_end().lines().try_for_each(line)?;
    if table.stopped {
        remark("Stopped: each configuration saw the same pictures, but not all of them.");
    }
    let limit = match (args.max_shift_mm, args.min_iou) {
        (Some(mm), _) => Limit::ShiftMm(mm),
        (None, Some(iou)) => Limit::Iou(iou),
        (None, None) => Limit::ShiftMm(SHIFT_MM),
    };
    line("")?;
    line(recommendation(&table, limit))?;
    Ok(if table.stopped { Exit::Interrupted } else { Exit::Done })
}

fn recommendation(table: &Table, limit: Limit) -> String {
    let asked = match limit {
        Limit::ShiftMm(mm) => format!("nineteen of twenty boxes within {mm} mm of the base"),
        Limit::Iou(iou) => format!("a mean overlap of at least {iou}"),
    };
    match table.choose(limit) {
        Ok(row) => format!(
            "Fastest with {asked}: {}, {:.1} ms a picture, {:.4} mm",
            row.setup.name(),
            row.wall_ms.median,
            row.shift_mm()
        ),
        Err(e) => format!("None with {asked}: {}", as_typed(&e)),
    }
}

/// The classes that weights know.
fn classes_of(weights: &WeightSource) -> Result<Vec<String>, Failure> {
    let weights = smr_gpu::smr::Weights::load(weights)?;
    Ok(weights.config().classes.clone())
}

/// The configuration that `detect --tradeoff` takes from a table: weights, too.
///
/// # Errors
/// [`Exit::Usage`] for a table without a setup that fits, or that was measured elsewhere.
pub(super) fn chosen(table: &Path, limit: Limit, given: &DetectorArgs) -> Result<Config, Failure> {
    let usage = |e: smr_gpu::Error| Failure::usage(format!("--tradeoff: {}", as_typed(&e)));
    let table = Table::open(table).map_err(usage)?;
    let setup = &table.choose(limit).map_err(usage)?.setup;
    let given = given.config_with(setups::weights_of(setup)?)?;
    let (config, place) = configured(setup, given)?;
    let digest = setups::digest_of(&config.weights)?;
    table.check(setup, place.as_ref(), &digest).map_err(usage)?;
    Ok(config)
}
