//! What each saving of a [`Scene`] costs and gains over labelled pictures, beside the whole network.
//!
//! ```sh
//! smr-gpu simulate --out out/mixed --count 60 --seed 2003 --kind mixed
//! smr-gpu simulate --out out/bare --count 60 --seed 2005 --kind none --conditions wide --part nothing
//! cargo run --release --example savings -- cpu weights/smrnet.safetensors out/mixed out/bare
//! ```
//!
//! Prints a Markdown table, a row a way to look, all of them at each picture in turn: the median of the
//! times as a share of the whole network's at the same pictures, snaps found (a box of their class above a
//! score of 0.5 that overlaps by at least half), lost and gained against the whole network, the mean
//! overlap with the labels, where a miss counts 0, the centre error and the shift of the centres against the
//! whole network's, both medians; then shares of the pictures without contact, and of those of which parts
//! were looked at. `--large WEIGHTS` gives times as shares of another network's.

use std::error::Error;
use std::path::{Path, PathBuf};

use smr_gpu::coco::{self, Picture};
use smr_gpu::metrics::{box_iou, center, quantile};
use smr_gpu::{Config, Detections, Device, Frame, GpuDetector, Scene, picture};

/// Scores above this count.
const SCORE: f32 = 0.5;
/// A box with this overlap finds its snap.
const RIGHT: f64 = 0.5;

/// One way to look, and what came of it so far.
struct Way {
    name: &'static str,
    detector: GpuDetector,
    /// Of each picture: milliseconds, whether nothing touches, whether parts were looked at.
    pictures: Vec<(f64, bool, bool)>,
    /// Of each snap the best box of its class: its overlap, and its centre in millimetres.
    snaps: Vec<Option<(f64, [f64; 2])>>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let large = match args.iter().position(|arg| arg == "--large") {
        Some(at) if at + 1 < args.len() => args.drain(at..at + 2).nth(1),
        _ => None,
    };
    let [device, weights, folders @ ..] = &args[..] else {
        return Err("expected DEVICE WEIGHTS FOLDER… [--large WEIGHTS]".into());
    };
    let device: Device = device.parse()?;
    let way = |name: &'static str, weights: &str, scene: Scene| -> Result<Way, Box<dyn Error>> {
        let config = Config::new(weights).device(device.clone()).scene(scene).score(SCORE);
        let detector = GpuDetector::new(config)?;
        Ok(Way { name, detector, pictures: Vec::new(), snaps: Vec::new() })
    };
    let full = Scene::FULL;
    let mut ways = vec![
        way("whole", weights, full)?,
        way("no contact, no network", weights, Scene { contact: true, ..full })?,
        way("parts in contact", weights, Scene { regions: true, ..full })?,
        way("live proposals", weights, Scene { proposals: true, ..full })?,
        way("all savings", weights, Scene::SAVING)?,
    ];
    if let Some(large) = &large {
        ways.push(way("the other network, whole", large, full)?);
    }
    let mut truths = Vec::new();
    for folder in folders {
        let folder = Path::new(folder);
        let data = coco::parse(&std::fs::read(folder.join("annotations.json"))?)?;
        for picture in &data.pictures {
            look(&mut ways, folder, picture, &data.categories, &mut truths)?;
        }
    }
    print(&ways, &truths, large.is_some());
    Ok(())
}

/// Looks at a picture in all ways; `truths` gets the centre of each of its snaps in millimetres.
fn look(
    ways: &mut [Way],
    folder: &Path,
    labelled: &Picture,
    categories: &[String],
    truths: &mut Vec<[f64; 2]>,
) -> Result<(), Box<dyn Error>> {
    let file: PathBuf = match folder.join(&labelled.file) {
        file if file.exists() => file,
        _ => folder.join("images").join(&labelled.file),
    };
    let picture = picture::read(&file)?;
    let mut frame = Frame::from(&picture);
    frame.mm_per_pixel = labelled.mm_per_pixel;
    let snaps: Vec<_> = labelled.labels.iter().filter(|label| !label.truth.crowd).collect();
    for (number, way) in ways.iter_mut().enumerate() {
        // Twice, as the first of a size builds what it needs; the faster one counts.
        let found = [way.detector.detect_frame(&frame)?, way.detector.detect_frame(&frame)?];
        let ms = found.iter().map(|f| f.wall.as_secs_f64() * 1e3).fold(f64::INFINITY, f64::min);
        let [found, _] = found;
        way.pictures.push((ms, found.contact == Some(false), found.regions.is_some()));
        let mm = f64::from(found.mm_per_pixel);
        for label in &snaps {
            if number == 0 {
                truths.push(center(label.truth.bbox).map(|x| x * mm));
            }
            way.snaps.push(best(&found, &categories[label.category], label.truth.bbox, mm));
        }
    }
    Ok(())
}

/// The box of a class that overlaps a label most, and its centre in millimetres.
fn best(found: &Detections, class: &str, truth: [f64; 4], mm: f64) -> Option<(f64, [f64; 2])> {
    let of_class = found.detections.iter().filter(|d| d.class.eq_ignore_ascii_case(class));
    let boxes = of_class.map(|d| d.bbox.map(f64::from));
    let judged = boxes.map(|b| (box_iou(truth, b), center(b).map(|x| x * mm)));
    judged.filter(|(iou, _)| *iou > 0.0).max_by(|a, b| a.0.total_cmp(&b.0))
}

fn print(ways: &[Way], truths: &[[f64; 2]], other: bool) {
    let right = |best: &Option<(f64, [f64; 2])>| best.is_some_and(|(iou, _)| iou >= RIGHT);
    let base = if other { &ways[ways.len() - 1] } else { &ways[0] };
    let whole = &ways[0];
    println!(
        "{} pictures, {} snaps, on {}; {:.1} ms is 1\n",
        whole.pictures.len(),
        truths.len(),
        whole.detector.adapter(),
        median(base.pictures.iter().map(|p| p.0)),
    );
    println!(
        "| | time | no contact | in parts | found | lost | gained | IoU, % | centre, mm | shift, mm | \
         shift, 95 % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for way in ways {
        let ratios = way.pictures.iter().zip(&base.pictures).map(|(own, base)| own.0 / base.0);
        let share = |of: fn(&(f64, bool, bool)) -> bool| {
            way.pictures.iter().filter(|p| of(p)).count() as f64 / way.pictures.len() as f64
        };
        let both = || way.snaps.iter().zip(&whole.snaps);
        let lost = both().filter(|(own, all)| !right(own) && right(all)).count();
        let gained = both().filter(|(own, all)| right(own) && !right(all)).count();
        let overlap: f64 = way.snaps.iter().map(|best| best.map_or(0.0, |b| b.0)).sum();
        let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let found = way.snaps.iter().zip(truths).filter(|(best, _)| right(best));
        let errors = found.filter_map(|(best, truth)| best.map(|b| distance(b.1, *truth)));
        let shifts: Vec<f64> = both()
            .filter(|(own, all)| right(own) && right(all))
            .filter_map(|(own, all)| Some(distance(own.as_ref()?.1, all.as_ref()?.1)))
            .collect();
        println!(
            "| {} | {:.3} | {:.2} | {:.2} | {} | {lost} | {gained} | {:.2} | {:.3} | {:.3} | {:.3} |",
            way.name,
            median(ratios),
            share(|p| p.1),
            share(|p| p.2),
            way.snaps.iter().filter(|best| right(best)).count(),
            100.0 * overlap / way.snaps.len().max(1) as f64,
            median(errors),
            median(shifts.iter().copied()),
            quantile(&shifts, 0.95).unwrap_or(f64::NAN),
        );
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(&values.collect::<Vec<_>>(), 0.5).unwrap_or(f64::NAN)
}
