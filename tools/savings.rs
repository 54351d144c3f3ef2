//! What each saving of a [`Savings`] costs and gains over labelled pictures, beside the whole network.
//!
//! ```sh
//! smr-gpu simulate --out out/mixed --count 60 --seed 2003 --kind mixed
//! smr-gpu simulate --out out/bare --count 60 --seed 2005 --kind bare
//! cargo run --release --example savings -- --device cpu out/mixed out/bare
//! ```
//!
//! Prints a Markdown table, a row a way to look, all of them at each picture in turn: the median of the times
//! as a share of the whole network's at the same pictures, snaps found (a box of their class above a score of
//! 0.5 that overlaps by at least half), lost and gained against the whole network, the mean overlap with the
//! labels, where a miss counts 0, the centre error and the shift of the centres against the whole network's,
//! both medians, the shift's 95th percentile too; then shares of the pictures without contact, of those of
//! which parts were looked at, of those whose deepest scale was left out, and of those that were looked at
//! again. A second table has how much higher the boxes of those pictures score that were looked at in parts,
//! the mean over the boxes above 0.05 that the whole network has too, by whether they are right. A third has
//! the time of each way by what pictures show: each folder, those with one snap or several, and those with one
//! snap of which parts, or one part, were looked at; a fourth the stages of the last. Then the snaps that each way loses.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use clap::Parser;
use smr_gpu::evaluation::coco::{self, Picture};
use smr_gpu::evaluation::metrics::{box_iou, center, quantile};
use smr_gpu::evaluation::{Found, LEAST_SCORE, RIGHT_IOU, Seen, Snap};
use smr_gpu::{Config, Detections, Device, Frame, GpuDetector, Savings, picture};

/// Scores above this count.
const SCORE: f32 = 0.5;

#[derive(Parser)]
struct Args {
    /// COCO folders.
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    #[arg(long, default_value = "gpu")]
    device: Device,
    #[arg(long, default_value = "weights/smrnet.safetensors")]
    weights: PathBuf,
    /// Times are shares of this other network's, all of it.
    #[arg(long)]
    beside: Option<PathBuf>,
    /// [`Savings::margin_mm`], one or several.
    #[arg(long, value_delimiter = ',', default_values_t = [Savings::NONE.margin_mm])]
    margin: Vec<f32>,
    /// Of the ways to save those whose names begin so; all of them by default.
    #[arg(long)]
    way: Vec<String>,
    /// [`Savings::most_proposals`].
    #[arg(long, default_value_t = Savings::NONE.most_proposals)]
    most_proposals: usize,
    /// [`Savings::doubt`].
    #[arg(long, default_value_t = Savings::NONE.doubt)]
    doubt: f32,
    /// Of each folder the first so many.
    #[arg(long, default_value_t = usize::MAX, hide_default_value = true)]
    limit: usize,
    /// Look once, not twice, of which the faster counts: for what does not depend on time, since the first
    /// look of a size builds what it needs.
    #[arg(long)]
    once: bool,
}

/// A labelled snap.
struct Truth {
    /// Folder and file.
    picture: String,
    center_mm: [f64; 2],
}

/// One way to look, and what came of it so far.
struct Way {
    name: String,
    detector: GpuDetector,
    looks: Vec<Look>,
    snaps: Vec<Best>,
    raised: Vec<Raised>,
}

/// How much higher a box scores that was seen in a part than the whole network's box there.
struct Raised {
    right: bool,
    by: f64,
}

/// What a way found of a snap.
struct Best {
    /// Overlap of the best box of its class, 0 without one.
    iou: f64,
    /// From the snap's centre to the box's in millimetres, where the box is right.
    off_mm: Option<[f64; 2]>,
}

/// One look at a picture.
struct Look {
    ms: f64,
    untouched: bool,
    /// How many parts were looked at; `None` for the whole.
    parts: Option<usize>,
    /// Whether the deepest scale was left out, to the end.
    without_deepest: bool,
    /// Whether it was the second.
    again: bool,
    /// Milliseconds of each stage.
    stages: Vec<(String, f64)>,
}

impl Look {
    fn of(found: &Detections) -> Self {
        let ms = |time: std::time::Duration| time.as_secs_f64() * 1e3;
        let stage = |t: &smr_gpu::engine::graph::StageTime| (t.stage.clone(), ms(t.time));
        Self {
            ms: ms(found.wall),
            untouched: found.contact == Some(false),
            parts: found.regions.as_ref().map(Vec::len).filter(|parts| *parts > 0),
            without_deepest: found.without_deepest,
            again: found.looked_again,
            stages: found.stages.iter().map(stage).collect(),
        }
    }
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
    let args = Args::parse();
    let way = |name: &str, weights: &Path, savings: Savings| -> Result<Way, Box<dyn Error>> {
        let (most_proposals, doubt) = (args.most_proposals, args.doubt);
        let savings = Savings { most_proposals, doubt, ..savings };
        let config = Config { device: args.device.clone(), savings, ..Config::new(weights) };
        let config = Config { score: LEAST_SCORE as f32, counts_above: Some(SCORE), ..config };
        let detector = GpuDetector::new(config)?;
        let (looks, snaps, raised) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Way { name: name.to_owned(), detector, looks, snaps, raised })
    };
    let own = &args.weights;
    let mut ways = vec![
        way("nothing left out", own, Savings::NONE)?,
        way("`contact`", own, Savings { contact: true, ..Savings::NONE })?,
        way("`proposals`", own, Savings { proposals: true, ..Savings::NONE })?,
        way("`scales`", own, Savings { scales: true, ..Savings::NONE })?,
        way("default", own, Savings::default())?,
        way("default and `scales`", own, Savings { scales: true, ..Savings::default() })?,
    ];
    for margin_mm in &args.margin {
        let [parts, all] = ["`regions`", "all four"].map(|name| format!("{name}, {margin_mm} mm"));
        ways.push(way(
            &parts,
            own,
            Savings { margin_mm: *margin_mm, regions: true, ..Savings::NONE },
        )?);
        ways.push(way(&all, own, Savings { margin_mm: *margin_mm, ..Savings::ALL })?);
    }
    let wanted = |name: &str| args.way.iter().any(|way| name.trim_matches('`').starts_with(way));
    let mut number = 0;
    ways.retain(|way| {
        number += 1;
        number == 1 || args.way.is_empty() || wanted(&way.name)
    });
    if let Some(other) = &args.beside {
        ways.push(way("the other network, nothing left out", other, Savings::NONE)?);
    }
    let base = if args.beside.is_some() { ways.len() - 1 } else { 0 };
    let mut truths = Vec::new();
    let names = ["one snap", "several snaps", "one snap, in parts", "one snap, in one part"];
    let mut groups: Vec<Group> = names.into_iter().map(Group::new).collect();
    for folder in &args.folders {
        groups.push(Group::new(&folder.file_name().unwrap_or_default().to_string_lossy()));
        let data = coco::parse(&std::fs::read(folder.join("annotations.json"))?)?;
        let data = data.of_classes(&ways[0].detector.model().classes)?;
        eprintln!("{}: {} pictures", folder.display(), data.pictures.len().min(args.limit));
        for picture in data.pictures.iter().take(args.limit) {
            let number = ways[0].looks.len();
            let before = truths.len();
            look(&mut ways, folder, picture, &mut truths, args.once)?;
            let parts = ways.iter().find_map(|way| way.looks[number].parts);
            let shows: &[usize] = match (truths.len() - before, parts) {
                (0, _) => &[],
                (1, None) => &[0],
                (1, Some(1)) => &[0, 2, 3],
                (1, Some(_)) => &[0, 2],
                _ => &[1],
            };
            shows.iter().for_each(|group| groups[*group].pictures.push(number));
            if let Some(own) = groups.last_mut() {
                own.pictures.push(number);
            }
        }
    }
    print(&ways, &truths, base);
    print_raised(&ways);
    print_groups(&ways, &groups, base);
    print_stages(&ways, &groups[3]);
    print_lost(&ways, &truths);
    Ok(())
}

/// Looks at a picture in all ways; `truths` gets each of its snaps.
fn look(
    ways: &mut [Way],
    folder: &Path,
    labelled: &Picture,
    truths: &mut Vec<Truth>,
    once: bool,
) -> Result<(), Box<dyn Error>> {
    let decoded = picture::read(labelled.find_in(folder))?;
    let frame = labelled.state(Frame::from(&decoded));
    let mut whole = Vec::new();
    for (number, way) in ways.iter_mut().enumerate() {
        let mut found = way.detector.detect(&frame)?;
        if !once {
            let again = way.detector.detect(&frame)?;
            if again.wall < found.wall {
                found = again;
            }
        }
        way.looks.push(Look::of(&found));
        let seen = Seen::new(labelled, &found);
        for (iou, right) in seen.best(SCORE.into()) {
            way.snaps.push(Best { iou, off_mm: right.map(|right| right.off_mm) });
        }
        if way.looks.last().is_some_and(|look| look.parts.is_some()) {
            way.raised.extend(whole.iter().filter_map(|own: &Found| {
                let overlaps = |other: &&Found| {
                    other.class == own.class
                        && box_iou(own.scored.bbox, other.scored.bbox) >= RIGHT_IOU
                };
                let score = |found: &Found| found.scored.score;
                let there = seen
                    .found
                    .iter()
                    .filter(overlaps)
                    .max_by(|a, b| score(a).total_cmp(&score(b)))?;
                let right = |snap: &Snap| {
                    snap.class == own.class && snap.truth.overlap(own.scored.bbox) >= RIGHT_IOU
                };
                Some(Raised { right: seen.snaps.iter().any(right), by: score(there) - score(own) })
            }));
        }
        if number == 0 {
            whole.clone_from(&seen.found);
            let snaps = seen.snaps.iter().filter(|snap| !snap.truth.crowd);
            truths.extend(snaps.map(|snap| Truth {
                picture: folder.join(&labelled.file).display().to_string(),
                center_mm: center(snap.truth.bbox).map(|x| x * seen.mm_per_pixel),
            }));
        }
    }
    Ok(())
}

fn print(ways: &[Way], truths: &[Truth], base: usize) {
    let (whole, base) = (&ways[0], &ways[base]);
    println!(
        "{} pictures, {} snaps, on {}; {:.1} ms is 1\n",
        whole.looks.len(),
        truths.len(),
        whole.detector.adapter(),
        median(base.looks.iter().map(|look| look.ms)),
    );
    println!(
        "| | time | no contact | in parts | two scales | again | found | lost | gained | IoU, % | centre, mm | \
         shift, mm | shift, 95 % |"
    );
    println!("|---|{}", "--:|".repeat(12));
    for way in ways {
        let ratios = way.looks.iter().zip(&base.looks).map(|(own, base)| own.ms / base.ms);
        let share = |of: fn(&Look) -> bool| {
            way.looks.iter().filter(|look| of(look)).count() as f64 / way.looks.len() as f64
        };
        let both = || way.snaps.iter().zip(&whole.snaps);
        let lost = both().filter(|(own, all)| own.off_mm.is_none() && all.off_mm.is_some()).count();
        let gained =
            both().filter(|(own, all)| own.off_mm.is_some() && all.off_mm.is_none()).count();
        let overlap: f64 = way.snaps.iter().map(|best| best.iou).sum();
        let found = || way.snaps.iter().filter_map(|best| best.off_mm);
        let errors = found().map(|[x, y]| x.hypot(y));
        let shifts = both().filter_map(|(own, all)| Some((own.off_mm?, all.off_mm?)));
        let shifts = shifts.map(|([x, y], [u, v])| (u - x).hypot(v - y));
        let shifts: Vec<f64> = shifts.collect();
        println!(
            "| {} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {} | {lost} | {gained} | {:.2} | {:.3} | {:.3} | {:.3} |",
            way.name,
            median(ratios),
            share(|look| look.untouched),
            share(|look| look.parts.is_some()),
            share(|look| look.without_deepest),
            share(|look| look.again),
            found().count(),
            100.0 * overlap / way.snaps.len().max(1) as f64,
            median(errors),
            median(shifts.iter().copied()),
            quantile(&shifts, 0.95).unwrap_or(f64::NAN),
        );
    }
}

/// What looking at parts does to scores.
fn print_raised(ways: &[Way]) {
    println!("\n| | right boxes | score | other boxes | score |\n|---|{}", "--:|".repeat(4));
    for way in ways.iter().filter(|way| !way.raised.is_empty()) {
        let mean = |right: bool| {
            let by: Vec<f64> =
                way.raised.iter().filter(|r| r.right == right).map(|r| r.by).collect();
            format!("{} | {:+.3}", by.len(), by.iter().sum::<f64>() / by.len() as f64)
        };
        println!("| {} | {} | {} |", way.name, mean(true), mean(false));
    }
}

/// The time of each way by what pictures show, as a share and in milliseconds.
fn print_groups(ways: &[Way], groups: &[Group], base: usize) {
    let names: Vec<&str> = ways.iter().map(|way| way.name.as_str()).collect();
    println!("\n| | pictures | {} |", names.join(" | "));
    println!("|---|--:|{}", "--:|".repeat(ways.len()));
    for group in groups.iter().filter(|group| !group.pictures.is_empty()) {
        let times = |way: &Way| {
            let pictures = || group.pictures.iter();
            let ratio = median(pictures().map(|i| way.looks[*i].ms / ways[base].looks[*i].ms));
            format!("{ratio:.3} ({:.1} ms)", median(pictures().map(|i| way.looks[*i].ms)))
        };
        let times: Vec<String> = ways.iter().map(times).collect();
        println!("| {} | {} | {} |", group.name, group.pictures.len(), times.join(" | "));
    }
}

/// The median milliseconds of each stage, of the pictures of a group.
fn print_stages(ways: &[Way], group: &Group) {
    let of = |way: &Way| {
        let mut stages: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for (stage, ms) in group.pictures.iter().flat_map(|i| &way.looks[*i].stages) {
            stages.entry(stage.clone()).or_default().push(*ms);
        }
        stages
    };
    let stages: Vec<_> = ways.iter().map(of).collect();
    let names: Vec<&str> = ways.iter().map(|way| way.name.as_str()).collect();
    println!("\n| {}, ms | {} |", group.name, names.join(" | "));
    println!("|---|{}", "--:|".repeat(ways.len()));
    let mut all: Vec<&String> = stages.iter().flat_map(BTreeMap::keys).collect();
    all.sort();
    all.dedup();
    for stage in all {
        let ms = |of: &BTreeMap<String, Vec<f64>>| match of.get(stage) {
            Some(times) => format!("{:.1}", median(times.iter().copied())),
            None => String::new(),
        };
        let ms: Vec<String> = stages.iter().map(ms).collect();
        println!("| {stage} | {} |", ms.join(" | "));
    }
}

/// The snaps that the first way finds and another does not.
fn print_lost(ways: &[Way], truths: &[Truth]) {
    println!("\n| lost by | picture | centre, mm |\n|---|---|---|");
    for way in &ways[1..] {
        for ((own, all), truth) in way.snaps.iter().zip(&ways[0].snaps).zip(truths) {
            if all.off_mm.is_some() && own.off_mm.is_none() {
                let [x, y] = truth.center_mm;
                println!("| {} | {} | {x:.1}, {y:.1} |", way.name, truth.picture);
            }
        }
    }
}

/// NaN of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(&values.collect::<Vec<_>>(), 0.5).unwrap_or(f64::NAN)
}
