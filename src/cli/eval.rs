//! `smr-gpu eval`: how good the detections are on labelled pictures.

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use smr_gpu::metrics::{
    self, PictureBoxes, ScoredBox, average_precision, average_precision_50_95, quantile,
};
use smr_gpu::model::ModelConfig;
use smr_gpu::{Detections, GpuDetector};

use super::detector::{self, DetectorArgs, fraction};
use super::exit::{Exit, Failure};
use super::output::{json_line, line, tell};
use super::picture;
use super::source::Source;

/// Average precision looks at detections down to this score, the convention of Faster R-CNN.
const LEAST_SCORE: f32 = 0.05;
/// A box is right if it overlaps the truth by this much.
const RIGHT_IOU: f64 = 0.5;
/// The paper's results by class, in percent: mean IoU and mean average precision.
const PAPER: [(&str, f64, f64); 2] = [("A", 91.78, 99.3), ("B", 92.12, 99.4)];

/// Measure the detections against labelled pictures
///
/// Reads DIR/annotations.json (COCO) and the pictures it names, in DIR or DIR/images. For each
/// class: mean best-box IoU (a miss counts 0), AP50, AP50:95 as the COCO evaluation defines them,
/// and the centre error of the right boxes.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with annotations.json and the pictures.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,

    /// Best boxes, centre errors and false alarms are of detections with a score above this (0 to
    /// 1). Average precision looks at all above 0.05.
    #[arg(long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    conf: f32,

    /// Look at the first N pictures alone.
    #[arg(long, value_name = "N")]
    limit: Option<NonZeroUsize>,

    /// Print one JSON object.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    detector: DetectorArgs,
}

#[derive(Deserialize)]
struct Coco {
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
    categories: Vec<CocoCategory>,
}

#[derive(Deserialize)]
struct CocoImage {
    id: u64,
    file_name: String,
    width: Option<u32>,
    height: Option<u32>,
}

#[derive(Deserialize)]
struct CocoAnnotation {
    image_id: u64,
    category_id: u64,
    /// Left, top, width, height in pixels.
    bbox: [f64; 4],
}

#[derive(Deserialize)]
struct CocoCategory {
    id: u64,
    name: String,
}

/// A labelled picture: its file and the boxes in it, each with the index of its class.
struct Labelled {
    source: Source,
    size: Option<(u32, u32)>,
    truths: Vec<(usize, [f64; 4])>,
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
    pictures.truncate(args.limit.map_or(usize::MAX, NonZeroUsize::get));

    // By class, then by picture.
    let mut boxes: Vec<Vec<PictureBoxes>> = vec![Vec::new(); classes.len()];
    let (mut failed, mut seconds) = (0, 0.0);
    let progress = ProgressBar::new(pictures.len() as u64).with_style(style());
    for labelled in &pictures {
        match look(&detector, labelled) {
            Ok(found) => {
                seconds += found.wall.as_secs_f64();
                for (index, boxes) in boxes.iter_mut().enumerate() {
                    boxes.push(of_class(index, detector.model(), labelled, &found));
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
    let rows: Vec<Row> = classes.iter().zip(&boxes).map(|(c, b)| row(c, &[b], conf)).collect();
    let all = row("all", &boxes.iter().collect::<Vec<_>>(), conf);
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

fn style() -> ProgressStyle {
    ProgressStyle::with_template("{pos}/{len} pictures {wide_bar} {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

fn read_labels(folder: &Path, classes: &[String]) -> Result<Vec<Labelled>, Failure> {
    let file = folder.join("annotations.json");
    let failed =
        |message: String| Failure::new(Exit::Inputs, format!("{}: {message}", file.display()));
    let text = std::fs::read(&file).map_err(|e| failed(e.to_string()))?;
    let coco: Coco = serde_json::from_slice(&text)
        .map_err(|e| failed(format!("expected COCO annotations, got an error: {e}")))?;
    let mut class_of = HashMap::new();
    for category in &coco.categories {
        let index = classes.iter().position(|c| c.eq_ignore_ascii_case(&category.name));
        class_of.insert(category.id, index.ok_or(&category.name));
    }
    if coco.images.is_empty() {
        return Err(failed("images: expected at least one, got none".into()));
    }
    let mut pictures: Vec<Labelled> = Vec::with_capacity(coco.images.len());
    let mut position_of = HashMap::new();
    for image in coco.images {
        if position_of.insert(image.id, pictures.len()).is_some() {
            return Err(failed(format!("image: expected each id once, got {} twice", image.id)));
        }
        let direct = folder.join(&image.file_name);
        let path =
            if direct.exists() { direct } else { folder.join("images").join(&image.file_name) };
        pictures.push(Labelled {
            source: Source::File(path),
            size: image.width.zip(image.height),
            truths: Vec::new(),
        });
    }
    for annotation in coco.annotations {
        let CocoAnnotation { image_id, category_id, bbox: [x, y, width, height] } = annotation;
        let position = position_of.get(&image_id);
        let position = position
            .ok_or_else(|| failed(format!("annotation: no image has the id {image_id}")))?;
        let class = class_of.get(&category_id);
        let class = class
            .ok_or_else(|| failed(format!("annotation: no category has the id {category_id}")))?;
        // Tools list categories that no annotation uses.
        let class = class.map_err(|got| {
            let expected = classes.join(", ");
            failed(format!("category: expected one of the weights' {expected}; got `{got}`"))
        })?;
        pictures[*position].truths.push((class, [x, y, x + width, y + height]));
    }
    Ok(pictures)
}

fn look(detector: &GpuDetector, labelled: &Labelled) -> Result<Detections, Failure> {
    let Labelled { source, size, .. } = labelled;
    let failed = |message| Failure::new(Exit::Inputs, format!("{source}: {message}"));
    let picture = picture::read(source).map_err(failed)?;
    let (w, h) = (picture.width(), picture.height());
    match size {
        Some((x, y)) if (*x, *y) != (w, h) => {
            return Err(failed(format!("expected {x} × {y} pixels as labelled, got {w} × {h}")));
        }
        _ => {}
    }
    detector.detect(&picture).map_err(|e| Failure::about(source, &e))
}

/// The boxes of one class in millimetres: overlaps do not depend on the unit, centre errors do.
fn of_class(
    index: usize,
    model: &ModelConfig,
    labelled: &Labelled,
    found: &Detections,
) -> PictureBoxes {
    let class = &model.classes[index];
    let mm = f64::from(model.mm_per_pixel_of(found.width.min(found.height)));
    let truths =
        labelled.truths.iter().filter(|(c, _)| *c == index).map(|(_, b)| b.map(|x| x * mm));
    let found = found
        .detections
        .iter()
        .filter(|d| d.class == *class)
        .map(|d| ScoredBox { bbox: d.bbox.map(|x| f64::from(x) * mm), score: f64::from(d.score) });
    PictureBoxes { truths: truths.collect(), found: found.collect() }
}

/// Figures over the classes of `boxes`: overlaps and errors over all their snaps, average
/// precision as the mean of theirs.
fn row(class: &str, boxes: &[&Vec<PictureBoxes>], conf: f64) -> Row {
    let (mut overlaps, mut errors, mut false_alarms) = (Vec::new(), Vec::new(), 0);
    for picture in boxes.iter().copied().flatten() {
        for (truth, best) in picture.truths.iter().zip(picture.best(conf)) {
            overlaps.push(best.map_or(0.0, |(_, iou)| iou));
            if let Some((found, _)) = best.filter(|(_, iou)| *iou >= RIGHT_IOU) {
                let ([x, y], [u, v]) = (metrics::center(*truth), metrics::center(found.bbox));
                errors.push((x - u).hypot(y - v));
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
    let scored: Vec<Vec<_>> = boxes.iter().map(|b| b.iter().map(above).collect()).collect();
    let over_classes = |ap: &dyn Fn(&[PictureBoxes]) -> Option<f64>| {
        mean(scored.iter().filter_map(|b| ap(b)).collect())
    };
    Row {
        class: class.into(),
        snaps: overlaps.len(),
        ap50: over_classes(&|b| average_precision(b, RIGHT_IOU)),
        ap50_95: over_classes(&|b| average_precision_50_95(b)),
        center_error_mm: CenterError {
            median: quantile(&errors, 0.5),
            percentile_95: quantile(&errors, 0.95),
        },
        right: errors.len(),
        false_alarms,
        mean_best_iou: mean(overlaps),
        paper: PAPER
            .iter()
            .find(|(c, ..)| c.eq_ignore_ascii_case(class))
            .map(|(_, mean_iou, map)| Paper { mean_iou: mean_iou / 100.0, map: map / 100.0 }),
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
    tell(format!(
        "{} pictures on {}, {:.3} s each; IoU, centre errors and false boxes of detections above a \
         score of {}, average precision above {LEAST_SCORE}; the paper's figures are its mean IoU \
         and mAP on its own pictures",
        report.pictures, report.adapter, report.seconds_per_picture, report.conf
    ));
    Ok(())
}
