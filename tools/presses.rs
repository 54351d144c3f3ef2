//! Whether a snap that is pressed deeper and deeper is found once and stays found, and whether a direction
//! that the picture does not show is said to be unknown.
//!
//! ```sh
//! weights/presses.sh out/presses
//! cargo run --release --example presses -- --device cpu --weights weights/smrnet.safetensors out/presses/*
//! ```
//!
//! A folder holds a simulated set a depth, `0.05` to `1.50`, all of one seed, so that the same picture of
//! each shows the same snaps, and what is nearest to a snap of the deepest is that snap. Prints a Markdown
//! table, a row a folder: the presses; at how many millimetres a snap is first found (a box of its class above
//! a score of 0.5 that overlaps by at least half), the median; the share of the steps after that in which it is
//! found; the directions that are more than 30° off, and the share of them that the network gives no direction
//! to, or a standard deviation of 60° or more.

use std::error::Error;
use std::path::{Path, PathBuf};

use clap::Parser;
use smr_gpu::evaluation::Seen;
use smr_gpu::evaluation::coco::{self, Dataset};
use smr_gpu::evaluation::metrics::{center, quantile};
use smr_gpu::{Config, Device, Frame, GpuDetector, picture};

/// Scores above this count.
const SCORE: f64 = 0.5;
/// From the centre of what touches in a shallow press to that in the deepest: less than half a hook's length,
/// and less than what lies between two snaps.
const SAME_MM: f64 = 6.0;
/// A direction further off is wrong.
const WRONG_DEG: f64 = 30.0;
/// A direction of this standard deviation is said to be unknown.
const UNKNOWN_DEG: f64 = 60.0;

#[derive(Parser)]
struct Args {
    /// Folders of presses.
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    #[arg(long, default_value = "gpu")]
    device: Device,
    #[arg(long, default_value = "weights/smrnet.safetensors")]
    weights: PathBuf,
    /// Of each folder the first so many presses.
    #[arg(long, default_value_t = usize::MAX, hide_default_value = true)]
    limit: usize,
}

/// One step of a press in which its snap was found.
struct Found {
    off_deg: Option<f64>,
    std_deg: Option<f64>,
}

/// A press, from shallow to deep.
#[derive(Default)]
struct Press {
    depths_mm: Vec<f64>,
    /// `None` where its snap was not found.
    steps: Vec<Option<Found>>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let detector = GpuDetector::new(Config { device: args.device, ..Config::new(&args.weights) })?;
    println!("| | presses | first at, mm | found after | wrong yaws | said to be unknown |");
    println!("|---|{}", "--:|".repeat(5));
    for folder in &args.folders {
        let presses = presses(&detector, folder, args.limit)?;
        print(&folder.display().to_string(), &presses);
    }
    Ok(())
}

/// The folder's sets in the order of their depths.
fn depths(folder: &Path) -> Result<Vec<(f64, PathBuf)>, Box<dyn Error>> {
    let mut depths = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let depth: f64 =
            name.parse().map_err(|_| format!("{}: expected a depth", path.display()))?;
        depths.push((depth, path));
    }
    depths.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(depths)
}

fn presses(
    detector: &GpuDetector,
    folder: &Path,
    limit: usize,
) -> Result<Vec<Press>, Box<dyn Error>> {
    let sets = depths(folder)?;
    let mut data: Vec<(f64, &Path, Dataset)> = Vec::new();
    for (depth, path) in &sets {
        let set = coco::parse(&std::fs::read(path.join("annotations.json"))?)?;
        data.push((*depth, path, set.of_classes(&detector.model().classes)?));
    }
    let Some((_, _, deepest)) = data.last() else {
        return Err(format!("{}: expected a set for each depth", folder.display()).into());
    };
    let mut presses = Vec::new();
    for i in 0..deepest.pictures.len() {
        let mm = f64::from(deepest.pictures[i].mm_per_pixel.unwrap_or(1.0));
        let middle = |label: &coco::Label| center(label.truth.bbox).map(|x| x * mm);
        let snaps = &deepest.pictures[i].labels;
        let mut of_snaps: Vec<Press> = snaps.iter().map(|_| Press::default()).collect();
        for (depth, path, set) in &data {
            let labelled = &set.pictures[i];
            let decoded = picture::read(labelled.find_in(path))?;
            let found = detector.detect(labelled.state(Frame::from(&decoded)))?;
            let seen = Seen::new(labelled, &found);
            for (label, (_, right)) in labelled.labels.iter().zip(seen.best(SCORE)) {
                let [x, y] = middle(label);
                let from = |snap: &coco::Label| {
                    let [u, v] = middle(snap);
                    if snap.category == label.category { (u - x).hypot(v - y) } else { f64::MAX }
                };
                let nearest = (0..snaps.len())
                    .min_by(|a, b| from(&snaps[*a]).total_cmp(&from(&snaps[*b])))
                    .filter(|nearest| from(&snaps[*nearest]) < SAME_MM);
                let Some(nearest) = nearest else { continue };
                let press = &mut of_snaps[nearest];
                press.depths_mm.push(*depth);
                press.steps.push(right.map(|right| Found {
                    off_deg: right.off_deg,
                    std_deg: right.found.yaw_std_deg,
                }));
            }
        }
        presses.extend(of_snaps);
    }
    presses.truncate(limit);
    Ok(presses)
}

fn print(name: &str, presses: &[Press]) {
    let (mut first, mut later, mut stayed, mut wrong, mut unknown) = (Vec::new(), 0, 0, 0, 0);
    for Press { depths_mm, steps } in presses {
        if let Some(start) = steps.iter().position(Option::is_some) {
            first.push(depths_mm[start]);
            later += steps.len() - start - 1;
            stayed += steps[start + 1..].iter().flatten().count();
        }
        for found in steps.iter().flatten() {
            if found.off_deg.is_some_and(|off| off.abs() > WRONG_DEG) {
                wrong += 1;
                unknown += usize::from(found.std_deg.is_none_or(|std| std >= UNKNOWN_DEG));
            }
        }
    }
    let share = |part: usize, of: usize| match of {
        0 => String::new(),
        _ => format!("{:.1} %", 100.0 * part as f64 / of as f64),
    };
    println!(
        "| {name} | {} of {} | {:.2} | {} | {wrong} | {} |",
        first.len(),
        presses.len(),
        quantile(&first, 0.5).unwrap_or(f64::NAN),
        share(stayed, later),
        share(unknown, wrong),
    );
}
