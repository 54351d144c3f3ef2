//! `smr-gpu tune`: measures which kernels are fastest here, and keeps the choice.

use std::path::PathBuf;
use std::time::Duration;

use smr_gpu::engine::tuned::{Place, Tuned};
use smr_gpu::files::Outputs;
use smr_gpu::verify::laboratory;
use smr_gpu::{Device, GpuDetector, Savings};

use super::detector::{AdapterArgs, NetworkArgs};
use super::exit::{Exit, Failure};
use super::folders::{self, CACHE_VARIABLE};
use super::message::remark;
use super::output::{self, line};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu tune
  smr-gpu tune --weights small --precision f16
  smr-gpu tune --seconds 60 --out choice.json";

/// Which kernels are fastest here? Measure them, and keep the choice
///
/// Runs each operation with each kernel that fits, for about ten seconds in all. The choice is kept in the user's
/// cache folder, by adapter, driver and version, beside those of other networks, sizes and precisions. Detections use
/// it from then on.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Time limit in seconds; a measurement that has begun is finished.
    #[arg(long, default_value_t = 10, value_name = "SECONDS")]
    #[arg(value_parser = clap::value_parser!(u64).range(1..=3600))]
    #[arg(allow_negative_numbers = true)]
    seconds: u64,

    /// Write the choice to this file instead; a choice that was measured here too is kept beside it.
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,

    #[command(flatten)]
    network: NetworkArgs,

    #[command(flatten)]
    device: AdapterArgs,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let mut config = args.network.config(Savings::NONE)?;
    let gpu = args.device.open(&args.network)?;
    let mut files = Outputs::default();
    args.network.spare(&mut files, &config);
    config.device = Device::Reference;
    let detector = GpuDetector::new(config)?;
    let path = match args.out {
        Some(path) => path,
        None => {
            let folder = folders::tuned().ok_or_else(|| {
                let message = format!("no cache folder: name one in {CACHE_VARIABLE}, or --out");
                Failure::usage(message)
            })?;
            std::fs::create_dir_all(&folder)
                .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", folder.display())))?;
            folder.join(Place::of(&gpu).file_name())
        }
    };
    files.check(&path)?;
    let bar = output::bar(0, "{bar:40} {pos} of {len} kernels a layer {elapsed}");
    let limit = Duration::from_secs(args.seconds);
    let tuned = laboratory::tune(&detector, &gpu, limit, |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    let mut kept = tuned.clone();
    // Else it is not there, or of no use here.
    if let Ok(earlier) = Tuned::read(&path, &gpu) {
        kept = kept.beside(earlier);
    }
    // First of all: stdout's reader may go away.
    files.write(&path, kept.to_json().as_bytes())?;
    remark(format!("{} ({}): kept in {}", gpu.info().name, gpu.info().backend, path.display()));
    for (key, kernel) in &tuned.kernels.by_shape {
        line(format!("{kernel:<28} {key}"))?;
    }
    Ok(Exit::Done)
}
