//! Runs the whole network on extreme pictures and weights and prints what comes of each, device by device.
//!
//! ```sh
//! cargo run --release --example extremes -- --device gpu --device cpu --device reference
//! ```
//!
//! A cell has the number of detections above the score, and how far their corners and scores are from
//! those of the last device, or the first stage in which a value was not finite.

#[path = "../tests/support/extremes.rs"]
mod extremes;

use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Parser;
use extremes::{Outcome, apart, changed, extremes, outcome, pixels};
use smr_gpu::{Config, Device, GpuDetector, Savings};

#[derive(Parser)]
struct Args {
    /// A column; may be repeated. The others are compared with the last.
    #[arg(long, default_values = ["gpu", "cpu", "reference"])]
    device: Vec<Device>,
    /// The weights from which all others are made.
    #[arg(long, default_value = "weights/smrnet-s.safetensors")]
    weights: PathBuf,
    /// Side of the network's input, where an extreme has none of its own.
    #[arg(long)]
    size: Option<usize>,
    /// Leave out what takes seconds.
    #[arg(long)]
    quick: bool,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let weights = std::fs::read(root.join(&args.weights))?;
    let usual = image::open(root.join("samples/mixed.png"))?.to_rgb8();
    let heads: Vec<String> = args.device.iter().map(ToString::to_string).collect();
    println!("| | {} |\n|---|{}", heads.join(" | "), "---|".repeat(heads.len()));
    for extreme in extremes().iter().filter(|extreme| !(args.quick && extreme.slow)) {
        let (pixels, size) = pixels(extreme.picture, &usual);
        let bytes = changed(&weights, extreme.weights);
        let look = |device: &Device| -> Result<Outcome, Box<dyn Error>> {
            let mut config = Config {
                score: 0.5,
                device: device.clone(),
                ..Config::from_bytes(extreme.name, bytes.clone())
            };
            config.input_size = extreme.size.or(args.size);
            // Nothing touches a black picture.
            config.savings = Savings::NONE;
            Ok(outcome(&GpuDetector::new(config)?, &pixels, size))
        };
        let outcomes: Vec<Outcome> = args.device.iter().map(look).collect::<Result<_, _>>()?;
        let Some((last, others)) = outcomes.split_last() else { continue };
        let mut cells: Vec<String> = others.iter().map(|o| cell(o, Some(last))).collect();
        cells.push(cell(last, None));
        println!("| {} | {} |", extreme.name, cells.join(" | "));
        std::io::stdout().flush()?;
    }
    Ok(())
}

fn cell(outcome: &Outcome, beside: Option<&Outcome>) -> String {
    match outcome {
        Outcome::NotFinite(stage) => format!("not finite: {stage}"),
        Outcome::Other(words) => format!("WRONG: {words}"),
        Outcome::Finite(found) => {
            let number = match found.detections.len() {
                0 => "finite, none found".into(),
                n => format!("finite, {n} found"),
            };
            match beside {
                Some(Outcome::Finite(other)) => match apart(found, other) {
                    None => format!("{number}, not the {} of the last", other.detections.len()),
                    Some(_) if found.detections.is_empty() => number,
                    Some([corner, score]) => {
                        format!("{number}, {corner:.0e} px, {score:.0e} in score")
                    }
                },
                _ => number,
            }
        }
    }
}
