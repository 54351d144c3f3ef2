//! `smr-gpu simulate`: data sets of simulated pictures.

use std::path::PathBuf;
use std::sync::Once;

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use smr_gpu::sensor::Error;
use smr_gpu::sensor::dataset::{self, Progress, Settings, Step};
use smr_gpu::sensor::scene::Mix;

use super::exit::{Exit, Failure};
use super::output::tell;

/// Simulate pictures of snaps pressed into the sensor's gel
///
/// Writes DIR/images/000000.png and so on, 1000×1000 pixels, and DIR/annotations.json (COCO). The
/// same seed gives the same pictures, whatever the number of threads. Different seeds share no
/// scene: give training, validation and test sets each their own. Called again with the same
/// options, a run that was cut off goes on where it stopped.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder to write to.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Number of pictures.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,

    /// Seed of the data set.
    #[arg(long, value_name = "S")]
    seed: u64,

    /// Which snaps the pictures show.
    #[arg(long, value_enum, default_value_t = Kind::Mixed)]
    kind: Kind,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// Cantilever hooks alone, at least one a picture.
    A,
    /// Split-ring studs alone, at least one a picture.
    B,
    /// Both kinds, several or none.
    Mixed,
    /// No snaps: other things, or an untouched gel.
    None,
}

impl From<Kind> for Mix {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::A => Self::A,
            Kind::B => Self::B,
            Kind::Mixed => Self::Mixed,
            Kind::None => Self::None,
        }
    }
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let Args { out, count, seed, kind } = args;
    let settings = Settings { out, count: count as usize, seed, mix: kind.into() };
    let bar = ProgressBar::new(count.into());
    let style = ProgressStyle::with_template("{msg} {bar:40} {pos}/{len} pictures, {eta} left");
    bar.set_style(style.map_err(|e| Failure::new(Exit::Output, e))?);
    let rendering = Once::new();
    let result = dataset::simulate(&settings, &|Progress { step, done, all }| {
        match step {
            Step::Check => bar.set_message("checking"),
            // The time left is of this step alone.
            Step::Render => rendering.call_once(|| {
                bar.reset();
                bar.set_message("rendering");
                bar.set_position(done as u64);
                bar.reset_eta();
            }),
        }
        bar.set_length(all as u64);
        // Threads report out of order.
        bar.set_position(bar.position().max(done as u64));
    });
    bar.finish_and_clear();
    let summary = result.map_err(|error| Failure::new(exit_of(&error), error))?;
    tell(format!(
        "{}: {count} pictures ({} new), {} snaps",
        settings.out.join("annotations.json").display(),
        summary.rendered,
        summary.snaps
    ));
    Ok(Exit::Done)
}

fn exit_of(error: &Error) -> Exit {
    match error {
        Error::OtherDataset { .. } => Exit::Usage,
        // The simulator reads nothing but what it wrote, and another run may write there.
        _ => Exit::Output,
    }
}
