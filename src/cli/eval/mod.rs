//! `smr-gpu eval`: how good the detections are on labelled pictures.

pub(super) mod print;
pub(super) mod sheet;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use serde::Serialize;
use smr_gpu::evaluation::coco::{self, Picture};
use smr_gpu::evaluation::{
    Deviations, Figures, LEAST_SCORE, Reliability, Seen, Stratum, by_condition, deviations,
    figures, reliability,
};
use smr_gpu::files::{self, Outputs};
use smr_gpu::{Detections, Frame, GpuDetector, Origin};

use super::detector::{self, Assumed, DetectorArgs, fraction};
use super::exit::{Exit, Failure, told};
use super::gallery::Gallery;
use super::message::remark;
use super::names::{base64, shown};
use super::output::{bar, folder_name, json_line};
use super::source::Source;

/// Longest annotations.json: COCO's own of 118 thousand pictures is half as long.
const MAX_ANNOTATIONS: u64 = 1 << 30;
/// The paper's results by class, in percent: mean IoU and mean average precision.
const PAPER: [(&str, f64, f64); 2] = [("A", 91.78, 99.3), ("B", 92.12, 99.4)];
/// What all sets together are called.
const TOGETHER: &str = "all";

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu eval --data test
  smr-gpu eval --data a b c --weights small --by-condition
  smr-gpu eval --data test --save worst --calibration";

/// How good is it? Measure the detections against labelled pictures
///
/// Reads DIR/annotations.json (COCO) and the pictures it names, in DIR or DIR/images. For each class: mean IoU of
/// the best box (a miss counts 0), AP50 and AP50:95 as the COCO evaluation defines them, and the centre and yaw
/// errors of the right boxes, each with its 95 % interval (bootstrap over pictures). Crowds are ignored, and so are
/// detections in them. Several folders give a Markdown table with a row for each.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folders with annotations.json and the pictures.
    #[arg(help_heading = "Input", long, value_name = "DIR", required = true, num_args = 1..)]
    data: Vec<PathBuf>,

    /// Take best boxes, errors, their stated deviations and false alarms from detections with a score above this
    /// (0 to 1). Average precision and the calibration of scores take all above 0.05.
    #[arg(help_heading = "Output", long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    #[arg(allow_negative_numbers = true)]
    conf: f32,

    /// Look only at the N pictures with the lowest ids of each folder.
    #[arg(help_heading = "Input", long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    #[arg(allow_negative_numbers = true)]
    limit: Option<u32>,

    /// Show the paper's figures beside those of the classes A and B.
    #[arg(help_heading = "Output", long)]
    paper: bool,

    /// Ignore the scale and the gel that the labels state for a picture, as with --sensor; --mm-per-pixel
    /// and --gel replace theirs.
    #[arg(help_heading = "Sensor", long)]
    unstated: bool,

    /// Print a table by what the labels state (depth, cut, markers, shadows, scale and so on), of all folders
    /// together.
    #[arg(help_heading = "Output", long)]
    by_condition: bool,

    /// Print how often boxes are right by score, and how often errors are within their stated deviations, of all
    /// folders together.
    #[arg(help_heading = "Output", long)]
    calibration: bool,

    /// Draw the ten worst pictures of each folder into one picture, in this folder.
    #[arg(help_heading = "Output", long, value_name = "DIR")]
    save: Option<PathBuf>,

    /// Print one line of JSON for each folder, with all tables; with several folders also one for all together.
    #[arg(help_heading = "Output", long)]
    json: bool,

    #[command(flatten)]
    detector: DetectorArgs,
}

/// A labelled picture: where it is, and what it shows.
pub(super) struct Labelled {
    pub source: Source,
    pub picture: Picture,
}

/// What labels state of pictures that counts: what the options say goes before.
#[derive(Clone, Copy)]
pub(super) struct Stated {
    pub scale: bool,
    pub gel: bool,
}

impl Stated {
    fn of<'a>(self, labelled: &Labelled, frame: Frame<'a>) -> Frame<'a> {
        let mut frame = labelled.picture.state(frame);
        frame.scale = frame.scale.filter(|_| self.scale);
        frame.gel = frame.gel.filter(|_| self.gel);
        frame
    }
}

/// A set of pictures as it was looked at.
pub(super) struct Set {
    name: String,
    /// Of those that could be read, each with its place in the set.
    pub seen: Vec<Seen>,
    pub places: Vec<usize>,
    /// Of how many the scale was assumed.
    assumed: usize,
    failed: usize,
    /// What the failed ones make of the exit code.
    exit: Exit,
    seconds: f64,
}

impl Set {
    fn named(name: &str) -> Self {
        let (seen, places) = (Vec::new(), Vec::new());
        Self {
            name: name.into(),
            seen,
            places,
            assumed: 0,
            failed: 0,
            exit: Exit::Done,
            seconds: 0.0,
        }
    }
}

/// Figures of one class, or of all together.
#[derive(Serialize)]
struct Row {
    class: String,
    #[serde(flatten)]
    figures: Figures,
    #[serde(skip_serializing_if = "Option::is_none")]
    paper: Option<Paper>,
}

#[derive(Serialize)]
struct Paper {
    mean_iou: f64,
    map: f64,
}

/// What the tables are made of.
#[derive(Serialize)]
struct Report {
    data: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    data_base64: Option<String>,
    pictures: usize,
    assumed_scale: usize,
    failed: usize,
    conf: f32,
    iou: f32,
    adapter: String,
    seconds_per_picture: f64,
    classes: Vec<Row>,
    all: Row,
    conditions: Vec<Stratum>,
    reliability: Reliability,
    deviations: Deviations,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let mut config = args.detector.config()?;
    config.score = args.conf.min(LEAST_SCORE as f32);
    // What is left out, and when it is looked at again, is as in `detect`.
    config.counts_above = Some(args.conf);
    let nms_iou = config.iou;
    let mut outputs = Outputs::default();
    args.detector.network.spare(&mut outputs, &config);
    each_once(&args.data)?;
    let detector = detector::open(config)?;
    let classes = detector.model().classes.clone();
    // All labels first: a mistake in the last folder's costs no hour.
    let labels = args.data.iter().map(|folder| {
        let mut pictures = read_labels(folder, &classes, &mut outputs)?;
        pictures.truncate(args.limit.map_or(usize::MAX, |n| n as usize));
        Ok((shown(folder.as_os_str()), pictures))
    });
    let labels = labels.collect::<Result<Vec<_>, Failure>>()?;
    let gallery = args.save.as_deref().map(Gallery::create).transpose()?;

    let several = labels.len() > 1;
    let report = |set: &Set, conditions: bool| {
        let paper = |class: &str| PAPER.iter().find(|(c, ..)| args.paper && *c == class);
        let (conf, every): (f64, Vec<usize>) = (args.conf.into(), (0..classes.len()).collect());
        let rows = classes.iter().enumerate().map(|(index, class)| Row {
            class: class.clone(),
            figures: figures(&set.seen, &[index], conf),
            paper: paper(class)
                .map(|(_, iou, map)| Paper { mean_iou: iou / 100.0, map: map / 100.0 }),
        });
        let figures = figures(&set.seen, &every, conf);
        Report {
            data: set.name.clone(),
            data_base64: args.data.iter().find_map(|folder| {
                let is_this = shown(folder.as_os_str()) == set.name;
                base64(folder.as_os_str()).filter(|_| is_this)
            }),
            pictures: set.seen.len(),
            assumed_scale: set.assumed,
            failed: set.failed,
            conf: args.conf,
            iou: nms_iou,
            adapter: detector.adapter(),
            seconds_per_picture: set.seconds / set.seen.len().max(1) as f64,
            classes: rows.collect(),
            all: Row { class: TOGETHER.into(), figures, paper: None },
            conditions: match conditions {
                true => by_condition(&set.seen, &every, conf),
                false => Vec::new(),
            },
            reliability: reliability(&set.seen, classes.len()),
            deviations: deviations(&set.seen, conf),
        }
    };
    let all = labels.iter().map(|(_, p)| p.len() as u64).sum();
    let progress = bar(all, "{pos}/{len} pictures {wide_bar} {eta} left");
    let mut together = Set::named(TOGETHER);
    let mut assumed = Assumed::default();
    let network = &args.detector.network;
    let stated = Stated {
        scale: !(args.unstated || network.sensor.is_some() || network.mm_per_pixel.is_some()),
        gel: !(args.unstated || network.sensor.is_some() || network.gel.is_some()),
    };
    for (number, (name, pictures)) in labels.iter().enumerate() {
        let set = detect_all(&detector, name, pictures, stated, &mut assumed, &progress)?;
        if let Some(gallery) = &gallery {
            let looked_at = set.places.iter().map(|place| &pictures[*place]).zip(&set.seen);
            let sheet = sheet::worst(&looked_at.collect::<Vec<_>>(), &classes, args.conf);
            let stem = format!("worst-{}", folder_name(&args.data[number]));
            if let Some(sheet) = sheet {
                // A file that cannot be written takes no figures with it.
                let saved = gallery.save(&mut outputs, &stem, &sheet);
                together.exit = together.exit.max(progress.suspend(|| told(saved)));
            }
        }
        if several {
            // A set's lines come when it is done: of forty sets the first are of interest early.
            let report = report(&set, args.json);
            progress.suspend(|| match args.json {
                true => json_line(&report),
                false => print::set_row(&report, number == 0, &labels),
            })?;
        }
        together.assumed += set.assumed;
        together.failed += set.failed;
        together.exit = together.exit.max(set.exit);
        together.seconds += set.seconds;
        together.seen.extend(set.seen);
    }
    progress.finish_and_clear();
    if !several {
        together.name.clone_from(&labels[0].0);
    }

    let report = report(&together, args.by_condition || args.json);
    match (args.json, several) {
        (true, _) => json_line(&report)?,
        (false, true) => print::set_row(&report, false, &labels)?,
        (false, false) => print::classes(&report)?,
    }
    if !args.json && args.by_condition {
        print::conditions(&report)?;
    }
    if !args.json && args.calibration {
        print::calibration(&report)?;
    }
    if !args.json {
        print::summary(&report);
    }
    Ok(together.exit)
}

/// Refuses folders of which two are one, by whatever names: its pictures would count twice.
fn each_once(folders: &[PathBuf]) -> Result<(), Failure> {
    let mut name_of = HashMap::new();
    for folder in folders {
        // Reading tells of one that is not there.
        let Ok(one) = folder.canonicalize() else { continue };
        if let Some(other) = name_of.insert(one, folder) {
            let [other, folder] = [other, folder].map(|path| shown(path.as_os_str()));
            let message = format!("--data: expected each folder once, got {other} and {folder}");
            return Err(Failure::usage(message));
        }
    }
    Ok(())
}

/// Detects in all pictures of a set. Those that fail are told of and counted.
pub(super) fn detect_all(
    detector: &GpuDetector,
    name: &str,
    pictures: &[Labelled],
    stated: Stated,
    assumed: &mut Assumed,
    progress: &ProgressBar,
) -> Result<Set, Failure> {
    let mut set = Set::named(name);
    for (place, labelled) in pictures.iter().enumerate() {
        match detect_one(detector, labelled, stated) {
            Ok(found) => {
                for what in assumed.remarks(&labelled.source, &found) {
                    progress.suspend(|| remark(what));
                }
                set.assumed += usize::from(found.scale.from == Origin::Assumed);
                set.seconds += found.wall.as_secs_f64();
                set.seen.push(Seen::new(&labelled.picture, &found));
                set.places.push(place);
            }
            Err(failure) if failure.is_of_one_picture() => {
                set.exit = set.exit.max(progress.suspend(|| failure.told().exit));
                set.failed += 1;
            }
            Err(failure) => return Err(failure.told()),
        }
        progress.inc(1);
    }
    Ok(set)
}

/// The pictures of a folder, by their ids, with what they show of the weights' `classes`; `outputs` spare
/// them and their annotations.
pub(super) fn read_labels(
    folder: &Path,
    classes: &[String],
    outputs: &mut Outputs,
) -> Result<Vec<Labelled>, Failure> {
    let file = folder.join("annotations.json");
    outputs.spare(&file);
    let failed =
        |message: String| Failure::new(Exit::Inputs, format!("{}: {message}", file.display()));
    let bytes = files::read(&file, MAX_ANNOTATIONS).map_err(|e| failed(e.to_string()))?;
    let dataset = coco::parse(&bytes).and_then(|dataset| dataset.of_classes(classes));
    let dataset = dataset.map_err(|e| failed(e.to_string()))?;
    let mut image_of = HashMap::new();
    let labelled = dataset.pictures.into_iter().map(|picture| {
        let path = picture.find_in(folder);
        outputs.spare(&path);
        // One file may have two names; where there is none, reading tells.
        if let Ok(one) = path.canonicalize()
            && let Some(other) = image_of.insert(one, picture.id)
        {
            let (id, path) = (picture.id, path.display());
            return Err(failed(format!(
                "image {id}: expected a file of its own, got {path}, which is image {other}'s"
            )));
        }
        Ok(Labelled { source: Source::File(path), picture })
    });
    labelled.collect()
}

fn detect_one(
    detector: &GpuDetector,
    labelled: &Labelled,
    stated: Stated,
) -> Result<Detections, Failure> {
    let source = &labelled.source;
    let failed = |message| Failure::new(Exit::Inputs, format!("{source}: {message}"));
    let picture = source.picture().map_err(failed)?;
    let checked = labelled.picture.check_size(picture.width(), picture.height());
    checked.map_err(|e| failed(e.to_string()))?;
    let frame = stated.of(labelled, Frame::from(&picture));
    detector.detect(&frame).map_err(|e| Failure::about(source, &e))
}
