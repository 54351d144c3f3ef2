//! `smr-gpu eval`: how good the detections are on labelled pictures.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use smr_gpu::coco::{self, Picture};
use smr_gpu::files;
use smr_gpu::metrics::{
    self, Areas, PictureBoxes, ScoredBox, Truth, average_precision, average_precision_50_95,
    quantile,
};
use smr_gpu::{Detections, Frame, GpuDetector};

use super::detector::{self, DetectorArgs, fraction};
use super::exit::{Exit, Failure};
use super::output::{count, json_line, line, tell};
use super::picture;
use super::source::Source;

/// Average precision looks at detections down to this score, the convention of Faster R-CNN.
const LEAST_SCORE: f32 = 0.05;
/// Longest annotations.json: COCO's own of 118 thousand pictures is half as long.
const MAX_ANNOTATIONS: u64 = 1 << 30;
/// A box is right if it overlaps the truth by this much.
const RIGHT_IOU: f64 = 0.5;
/// The paper's results by class, in percent: mean IoU and mean average precision.
const PAPER: [(&str, f64, f64); 2] = [("A", 91.78, 99.3), ("B", 92.12, 99.4)];

/// Measure the detections against labelled pictures
///
/// Reads DIR/annotations.json (COCO) and the pictures it names, in DIR or DIR/images. For each
/// class: mean best-box IoU (a miss counts 0), AP50, AP50:95 as the COCO evaluation defines them,
/// and the centre error of the right boxes. Crowds are ignored, and so is what is found there.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with annotations.json and the pictures.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,

    /// Best boxes, centre errors and false alarms are of detections with a score above this (0 to
    /// 1). Average precision looks at all above 0.05.
    #[arg(long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    conf: f32,

    /// Look at the N pictures with the lowest ids alone.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,

    /// Show the paper's figures beside those of the classes A and B.
    #[arg(long)]
    paper: bool,

    /// Take no notice of the scale that the labels state for a picture.
    #[arg(long)]
    unstated: bool,

    /// Print one JSON object.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    detector: DetectorArgs,
}

/// A labelled picture: where it is, and what it shows, by class.
pub(super) struct Labelled {
    pub source: Source,
    pub picture: Picture,
    pub truths: Vec<Vec<Truth>>,
}

/// What a picture shows of a class and what was found, in pixels, and how large a pixel is.
struct Seen {
    boxes: Vec<PictureBoxes>,
    mm_per_pixel: Vec<f64>,
}

/// Figures of one class, or of all together.
#[derive(Serialize)]
struct Row {
    class: String,
    snaps: usize,
    mean_best_iou: Option<f64>,
    ap50: Option<f64>,
    ap50_95: Option<f64>,
    center_error_mm: CenterError,
    /// Snaps with a right box above the threshold.
    right: usize,
    /// Boxes above the threshold that are on no snap.
    false_alarms: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    paper: Option<Paper>,
}

#[derive(Serialize)]
struct CenterError {
    median: Option<f64>,
    percentile_95: Option<f64>,
}

#[derive(Serialize)]
struct Paper {
    mean_iou: f64,
    map: f64,
}

#[derive(Serialize)]
struct Report<'a> {
    pictures: usize,
    failed: usize,
    conf: f32,
    iou: f32,
    adapter: &'a str,
    seconds_per_picture: f64,
    classes: Vec<Row>,
    all: Row,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let mut config = args.detector.config()?;
    config.score = args.conf.min(LEAST_SCORE);
    let nms_iou = config.iou;
    let detector = detector::open(config)?;
    let classes = detector.model().classes.clone();
    let mut pictures = read_labels(&args.data, &classes)?;
    pictures.truncate(args.limit.map_or(usize::MAX, |n| n as usize));

    let mut seen: Vec<Seen> =
        classes.iter().map(|_| Seen { boxes: vec![], mm_per_pixel: vec![] }).collect();
    let (mut failed, mut seconds) = (0, 0.0);
    let progress = ProgressBar::new(pictures.len() as u64).with_style(style());
    for labelled in &pictures {
        match look(&detector, labelled, args.unstated) {
            Ok(found) => {
                seconds += found.wall.as_secs_f64();
                let mm_per_pixel = f64::from(found.mm_per_pixel);
                for ((seen, class), truths) in seen.iter_mut().zip(&classes).zip(&labelled.truths) {
                    seen.boxes.push(of_class(class, truths, &found));
                    seen.mm_per_pixel.push(mm_per_pixel);
                }
            }
            Err(Failure { exit: Exit::Inputs, message }) => {
                progress.suspend(|| message.into_iter().for_each(tell));
                failed += 1;
            }
            Err(failure) => return Err(failure.told()),
        }
        progress.inc(1);
    }
    progress.finish_and_clear();

    let conf = f64::from(args.conf);
    let paper = |class: &str| PAPER.iter().find(|(c, ..)| args.paper && *c == class);
    let rows: Vec<Row> = classes
        .iter()
        .zip(&seen)
        .map(|(class, seen)| {
            let paper =
                paper(class).map(|(_, iou, map)| Paper { mean_iou: iou / 100.0, map: map / 100.0 });
            Row { paper, ..row(class, std::slice::from_ref(seen), conf) }
        })
        .collect();
    let all = row("all", &seen, conf);
    let looked_at = pictures.len() - failed;
    let report = Report {
        pictures: looked_at,
        failed,
        conf: args.conf,
        iou: nms_iou,
        adapter: detector.adapter(),
        seconds_per_picture: seconds / looked_at.max(1) as f64,
        classes: rows,
        all,
    };
    match args.json {
        true => json_line(&report)?,
        false => print(&report)?,
    }
    Ok(if failed > 0 { Exit::Inputs } else { Exit::Done })
}

pub(super) fn style() -> ProgressStyle {
    ProgressStyle::with_template("{pos}/{len} pictures {wide_bar} {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// The pictures of a folder, by their ids, with what they show of the weights' `classes`.
pub(super) fn read_labels(folder: &Path, classes: &[String]) -> Result<Vec<Labelled>, Failure> {
    let file = folder.join("annotations.json");
    let failed =
        |message: String| Failure::new(Exit::Inputs, format!("{}: {message}", file.display()));
    let bytes = files::read(&file, MAX_ANNOTATIONS).map_err(|e| failed(e.to_string()))?;
    let dataset = coco::parse(&bytes).map_err(|e| failed(e.to_string()))?;
    let class_of: Vec<Option<usize>> = dataset
        .categories
        .iter()
        .map(|name| classes.iter().position(|class| class.to_lowercase() == name.to_lowercase()))
        .collect();
    let mut image_of = HashMap::new();
    let labelled = dataset.pictures.into_iter().map(|picture| {
        let mut truths = vec![Vec::new(); classes.len()];
        for label in &picture.labels {
            // Tools list categories that no annotation uses.
            let class = class_of[label.category].ok_or_else(|| {
                let (expected, got) = (classes.join(", "), &dataset.categories[label.category]);
                failed(format!("category: expected one of the weights' {expected}; got `{got}`"))
            })?;
            truths[class].push(label.truth);
        }
        let direct = folder.join(&picture.file);
        let path = if direct.exists() { direct } else { folder.join("images").join(&picture.file) };
        // One file may have two names; where there is none, reading tells.
        if let Ok(one) = path.canonicalize()
            && let Some(other) = image_of.insert(one, picture.id)
        {
            let (id, path) = (picture.id, path.display());
            return Err(failed(format!(
                "image {id}: expected a file of its own, got {path}, which is image {other}'s"
            )));
        }
        Ok(Labelled { source: Source::File(path), picture, truths })
    });
    labelled.collect()
}

fn look(
    detector: &GpuDetector,
    labelled: &Labelled,
    unstated: bool,
) -> Result<Detections, Failure> {
    let source = &labelled.source;
    let failed = |message| Failure::new(Exit::Inputs, format!("{source}: {message}"));
    let picture = picture::read(source).map_err(failed)?;
    let checked = labelled.picture.check_size(picture.width(), picture.height());
    checked.map_err(|e| failed(e.to_string()))?;
    let mut frame = Frame::from(&picture);
    frame.mm_per_pixel = labelled.picture.mm_per_pixel.filter(|_| !unstated);
    detector.detect_frame(&frame).map_err(|e| Failure::about(source, &e))
}

/// What a picture shows of a class, and what was found of it.
fn of_class(class: &str, truths: &[Truth], found: &Detections) -> PictureBoxes {
    let found = found.detections.iter().filter(|d| d.class == class);
    let found = found.map(|d| ScoredBox { bbox: d.bbox.map(f64::from), score: d.score.into() });
    PictureBoxes { truths: truths.to_vec(), found: found.collect() }
}

/// Figures over the classes of `seen`: overlaps and errors over all their snaps, average precision
/// as the mean of theirs.
fn row(class: &str, seen: &[Seen], conf: f64) -> Row {
    let (mut overlaps, mut errors, mut false_alarms) = (Vec::new(), Vec::new(), 0);
    for (picture, mm) in seen.iter().flat_map(|s| s.boxes.iter().zip(&s.mm_per_pixel)) {
        for (truth, best) in picture.best(conf) {
            overlaps.push(best.map_or(0.0, |(_, iou)| iou));
            if let Some((found, _)) = best.filter(|(_, iou)| *iou >= RIGHT_IOU) {
                let ([x, y], [u, v]) = (metrics::center(truth.bbox), metrics::center(found.bbox));
                errors.push((x - u).hypot(y - v) * mm);
            }
        }
        false_alarms += picture.false_alarms(conf, RIGHT_IOU);
    }
    let mean = |values: Vec<f64>| {
        let n = values.len();
        (n > 0).then(|| values.into_iter().sum::<f64>() / n as f64)
    };
    // Whatever `--conf` is.
    let above = |picture: &PictureBoxes| picture.above(LEAST_SCORE.into());
    let scored: Vec<Vec<_>> = seen.iter().map(|s| s.boxes.iter().map(above).collect()).collect();
    let over_classes = |ap: &dyn Fn(&[PictureBoxes]) -> Option<f64>| {
        mean(scored.iter().filter_map(|b| ap(b)).collect())
    };
    Row {
        class: class.into(),
        snaps: overlaps.len(),
        ap50: over_classes(&|b| average_precision(b, RIGHT_IOU, Areas::ALL)),
        ap50_95: over_classes(&|b| average_precision_50_95(b, Areas::ALL)),
        center_error_mm: CenterError {
            median: quantile(&errors, 0.5),
            percentile_95: quantile(&errors, 0.95),
        },
        right: errors.len(),
        false_alarms,
        mean_best_iou: mean(overlaps),
        paper: None,
    }
}

fn print(report: &Report) -> Result<(), Failure> {
    let number = |value: Option<f64>, digits: usize| match value {
        Some(v) => format!("{v:.digits$}"),
        None => "-".into(),
    };
    let percent = |value: Option<f64>| number(value.map(|v| v * 100.0), 2);
    line(format!(
        "{:<8} {:>6} {:>8} {:>8} {:>10} {:>11} {:>11} {:>7} {:>7}",
        "class",
        "snaps",
        "IoU, %",
        "AP50, %",
        "AP50:95, %",
        "median, mm",
        "95th, mm",
        "right",
        "false"
    ))?;
    for row in report.classes.iter().chain([&report.all]) {
        line(format!(
            "{:<8} {:>6} {:>8} {:>8} {:>10} {:>11} {:>11} {:>7} {:>7}",
            row.class,
            row.snaps,
            percent(row.mean_best_iou),
            percent(row.ap50),
            percent(row.ap50_95),
            number(row.center_error_mm.median, 3),
            number(row.center_error_mm.percentile_95, 3),
            row.right,
            row.false_alarms
        ))?;
        if let Some(Paper { mean_iou, map }) = &row.paper {
            let (iou, map) = (percent(Some(*mean_iou)), percent(Some(*map)));
            line(format!("{:<8} {:>6} {iou:>8} {map:>8}", "  paper", ""))?;
        }
    }
    let paper = match report.classes.iter().any(|row| row.paper.is_some()) {
        true => "; the paper's figures are its mean IoU and mAP on its own pictures",
        false => "",
    };
    tell(format!(
        "{} on {}, {:.3} s each; IoU, centre errors and false boxes of detections above a \
         score of {}, average precision above {LEAST_SCORE}{paper}",
        count(report.pictures, "picture"),
        report.adapter,
        report.seconds_per_picture,
        report.conf
    ));
    Ok(())
}
