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
//! were looked at. A second table has the time of each way by what pictures show: each folder, and those
//! with one snap or several. `--margin` is [`Scene::margin_mm`]. `--large WEIGHTS` gives times as shares of another network's; `--once` looks
//! once instead of twice, where the first of a size also builds what it needs: for what does not depend on
//! time.

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

/// Pictures that show something alike, by their numbers.
struct Group {
    name: String,
    pictures: Vec<usize>,
}

impl Group {
    fn new(name: &str) -> Self {
        Self { name: name.to_owned(), pictures: Vec::new() }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let large = match args.iter().position(|arg| arg == "--large") {
        Some(at) if at + 1 < args.len() => args.drain(at..at + 2).nth(1),
        _ => None,
    };
    let margin = match args.iter().position(|arg| arg == "--margin") {
        Some(at) if at + 1 < args.len() => Some(args.drain(at..at + 2).nth(1)),
        _ => None,
    };
    let margin_mm = match margin.flatten() {
        Some(text) => text.parse()?,
        None => Scene::FULL.margin_mm,
    };
    let looks = match args.iter().position(|arg| arg == "--once") {
        Some(at) => {
            args.remove(at);
            1
        }
        None => 2,
    };
    let [device, weights, folders @ ..] = &args[..] else {
        return Err(
            "expected DEVICE WEIGHTS FOLDER… [--large WEIGHTS] [--margin MM] [--once]".into()
        );
    };
    let device: Device = device.parse()?;
    let way = |name: &'static str, weights: &str, scene: Scene| -> Result<Way, Box<dyn Error>> {
        let config = Config::new(weights).device(device.clone()).scene(scene).score(SCORE);
        let detector = GpuDetector::new(config)?;
        Ok(Way { name, detector, pictures: Vec::new(), snaps: Vec::new() })
    };
    let full = Scene { margin_mm, ..Scene::FULL };
    let mut ways = vec![
        way("whole", weights, full)?,
        way("no contact, no network", weights, Scene { contact: true, ..full })?,
        way("parts in contact", weights, Scene { regions: true, ..full })?,
        way("live proposals", weights, Scene { proposals: true, ..full })?,
        way("all savings", weights, Scene { margin_mm, ..Scene::SAVING })?,
    ];
    if let Some(large) = &large {
        ways.push(way("the other network, whole", large, full)?);
    }
    let mut truths = Vec::new();
    let mut groups: Vec<Group> = vec![Group::new("one snap"), Group::new("several snaps")];
    for folder in folders {
        let folder = Path::new(folder);
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        groups.push(Group::new(&name));
        let data = coco::parse(&std::fs::read(folder.join("annotations.json"))?)?;
        for picture in &data.pictures {
            let number = ways[0].pictures.len();
            let before = truths.len();
            look(&mut ways, folder, picture, &data.categories, &mut truths, looks)?;
            match truths.len() - before {
                0 => {}
                1 => groups[0].pictures.push(number),
                _ => groups[1].pictures.push(number),
            }
            if let Some(own) = groups.last_mut() {
                own.pictures.push(number);
            }
        }
    }
    print(&ways, &truths, large.is_some());
    print_groups(&ways, &groups, large.is_some());
    Ok(())
}

/// Looks at a picture in all ways; `truths` gets the centre of each of its snaps in millimetres.
fn look(
    ways: &mut [Way],
    folder: &Path,
    labelled: &Picture,
    categories: &[String],
    truths: &mut Vec<[f64; 2]>,
    looks: usize,
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
        // Of two looks the faster one counts: the first of a size builds what it needs.
        let mut found = way.detector.detect_frame(&frame)?;
        for _ in 1..looks {
            let again = way.detector.detect_frame(&frame)?;
            found.wall = found.wall.min(again.wall);
        }
        let ms = found.wall.as_secs_f64() * 1e3;
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

/// The time of each way by what pictures show.
fn print_groups(ways: &[Way], groups: &[Group], other: bool) {
    let base = if other { &ways[ways.len() - 1] } else { &ways[0] };
    let names: Vec<&str> = ways.iter().map(|way| way.name).collect();
    println!("\n| | pictures | {} |", names.join(" | "));
    println!("|---|---|{}", "---|".repeat(ways.len()));
    for group in groups.iter().filter(|group| !group.pictures.is_empty()) {
        let ratio = |way: &Way| {
            let of = |i: &usize| way.pictures[*i].0 / base.pictures[*i].0;
            format!("{:.3}", median(group.pictures.iter().map(of)))
        };
        let ratios: Vec<String> = ways.iter().map(ratio).collect();
        println!("| {} | {} | {} |", group.name, group.pictures.len(), ratios.join(" | "));
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(&values.collect::<Vec<_>>(), 0.5).unwrap_or(f64::NAN)
}
