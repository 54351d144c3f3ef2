//! `smr-gpu detect`: finds the snaps in pictures and streams, prints and draws them.

mod files;
pub(super) mod lists;
mod record;
mod table;
mod video;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use smr_gpu::evaluation::tradeoff::Limit;
use smr_gpu::files::{Outputs, Shard};
use smr_gpu::verify::{self, Stages};
use smr_gpu::{Config, Detections, GpuDetector};

use super::detector::{self, Assumed, DetectorArgs, exact_fraction, fraction};
use super::exit::{Exit, Failure, told};
use super::message::{detail, remark, tell};
use super::output::{count, counter, json_line};
use super::source::frame::{FrameId, RawFormat, Shot};
use super::source::reader::{Event, Message, Reader, Stop, Wanted};
use super::source::{Source, expand_all};
use super::tensors;
use files::{FileArgs, Files};
use record::Record;
use table::Table;

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu detect picture.png
  smr-gpu detect in/ --save out/ --json
  smr-gpu detect /dev/video0 --latest --sensor gelsight-mini";

/// Find the snaps in pictures
///
/// Prints a line for each snap, or with --json one for each picture. A picture that cannot be read is named on
/// stderr; the others still go through. Ctrl-C keeps what was found so far. A picture has at most 33 554 432 pixels
/// and 320 MiB. With weights of at most 256 MiB a run takes less than 1 GiB of memory, without the GPU driver's own.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Pictures (PNG, JPEG, BMP, TIFF), folders of pictures, patterns such as 'in/*.png', or `-`
    /// for pictures on stdin, one after the other. With ffmpeg also videos, cameras (/dev/video0) and network
    /// streams (rtsp://…).
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<PathBuf>,

    /// Take the pictures of folders within folders too.
    #[arg(help_heading = "Input", long)]
    recursive: bool,

    /// Read raw frames of this size and format from stdin, one after the other: rgb8, bgr8, rgba8, bgra8,
    /// gray8, gray16, bayer-rggb8, bayer-bggr8, bayer-grbg8, bayer-gbrg8, yuyv or nv12.
    #[arg(help_heading = "Input", long, value_name = "WxH:FORMAT")]
    raw: Option<RawFormat>,

    /// Look only at each Nth picture, from the Ith on, so that N runs share a list of picture files, or one video.
    /// All must see the same files. Indices and names are those of the whole list; `smr-gpu merge` merges the lists.
    #[arg(help_heading = "Input", long, value_name = "I/N", conflicts_with_all = ["latest", "video", "dump_stages"])]
    shard: Option<Shard>,

    /// Look only at each Nth frame.
    #[arg(
        help_heading = "Input",
        long,
        default_value_t = 1,
        value_name = "N",
        allow_negative_numbers = true
    )]
    #[arg(value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,

    /// Always look at the latest frame; drop and count those that came meanwhile.
    #[arg(help_heading = "Input", long)]
    latest: bool,

    /// Print one line of JSON for each picture.
    #[arg(help_heading = "Output", long)]
    json: bool,

    #[command(flatten)]
    files: FileArgs,

    /// Show detections with a score above this (0 to 1).
    #[arg(help_heading = "Output", long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    #[arg(allow_negative_numbers = true)]
    conf: f32,

    /// Show at most this many detections of a picture (1 to 100).
    #[arg(help_heading = "Output", long, default_value_t = 100, value_name = "N")]
    #[arg(value_parser = clap::value_parser!(u8).range(1..=100))]
    #[arg(allow_negative_numbers = true)]
    max_det: u8,

    /// Show only this class; may be given several times.
    #[arg(help_heading = "Output", long = "class", value_name = "NAME")]
    classes: Vec<String>,

    #[command(flatten)]
    detector: DetectorArgs,

    /// Run the fastest configuration of this table, which `smr-gpu tradeoff` wrote, that keeps --max-shift-mm or
    /// --min-iou. The table decides what is left out, too. Fails if adapter, driver or weights are not those of the
    /// table.
    #[arg(help_heading = "Speed", long, value_name = "JSON", conflicts_with_all = ["weights", "size", "device", "precision", "leave_out", "exact"])]
    tradeoff: Option<PathBuf>,

    /// With --tradeoff: 95 % of the boxes are within this distance of those of the base.
    #[arg(help_heading = "Speed", long, value_name = "MM", requires = "tradeoff", value_parser = super::tradeoff::millimetres)]
    #[arg(default_value_t = super::tradeoff::SHIFT_MM, allow_negative_numbers = true)]
    max_shift_mm: f64,

    /// With --tradeoff: the mean overlap with the labels is at least this.
    #[arg(
        help_heading = "Speed",
        long,
        value_name = "IOU",
        requires = "tradeoff",
        conflicts_with = "max_shift_mm"
    )]
    #[arg(value_parser = exact_fraction, allow_negative_numbers = true)]
    min_iou: Option<f64>,

    /// Write the tensor of every stage of one picture, under the names of the PyTorch model. A tensor inside a
    /// stage has the name of the layer that made it, after batch norm, residual and ReLU. Leaves nothing out, as
    /// --exact.
    #[arg(
        help_heading = "Advanced",
        long,
        value_name = "FILE.safetensors",
        conflicts_with = "leave_out"
    )]
    dump_stages: Option<PathBuf>,
}

impl Args {
    fn config(&self) -> Result<Config, Failure> {
        let limit = self.min_iou.map_or(Limit::ShiftMm(self.max_shift_mm), Limit::Iou);
        let mut config = match &self.tradeoff {
            Some(table) => super::tradeoff::chosen(table, limit, &self.detector)?,
            None => self.detector.config()?,
        };
        config.score = self.conf;
        config.max_detections = self.max_det.into();
        config.classes = self.classes.clone();
        // A table does not show them.
        config.stage_times = self.json;
        config.keep_stages = self.dump_stages.is_some();
        Ok(config)
    }

    /// How many frames the run looks at, where each source is one.
    fn known_length(&self, sources: &[Source]) -> Option<u64> {
        let all_files = sources.iter().all(|source| matches!(source, Source::File(_)));
        let frames = (sources.len() as u64).div_ceil(self.every);
        all_files.then_some(self.shard.map_or(frames, |shard| shard.share(frames)))
    }

    /// Refuses sources that the options do not fit.
    fn check(&self, sources: &[Source]) -> Result<(), Failure> {
        let is_one = matches!(sources, [Source::File(_) | Source::Stdin]) && self.raw.is_none();
        if self.dump_stages.is_some() && !is_one {
            let got = match sources {
                [_] => "a stream".to_owned(),
                _ => sources.len().to_string(),
            };
            return Err(Failure::usage(format!("--dump-stages: expected one picture, got {got}")));
        }
        let other = sources.iter().find(|source| !matches!(source, Source::File(_)));
        if let (Some(_), Some(other)) = (self.shard, other)
            && !matches!(sources, [Source::Video(_)])
        {
            return Err(Failure::usage(format!(
                "--shard: expected picture files, or one video, got {other}"
            )));
        }
        match self.raw.is_some() && !sources.contains(&Source::Stdin) {
            true => {
                Err(Failure::usage("--raw: expected `-` for frames on stdin, got other sources"))
            }
            false => Ok(()),
        }
    }
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let (sources, exit) = expand_all(&args.sources, args.recursive)?;
    if !sources.is_empty() || args.dump_stages.is_some() {
        args.check(&sources)?;
    }
    if sources.is_empty() {
        return Ok(exit);
    }
    let config = args.config()?;
    let mut outputs = Outputs::sparing(sources.iter().filter_map(Source::file));
    args.detector.network.spare(&mut outputs, &config);
    args.tradeoff.iter().for_each(|table| outputs.spare(table));
    let single = args.files.single().chain(args.dump_stages.as_deref());
    outputs.check_all(single)?;
    let detector = detector::open(config)?;
    let classes = &detector.model().classes;
    let mut run = Run {
        table: Table::new(&sources, classes),
        files: Files::create(&args.files, &mut outputs, classes)?,
        outputs,
        assumed: Assumed::default(),
        sums: Sums::default(),
        progress: counter(args.known_length(&sources), "pictures"),
        exit,
        detector: &detector,
        args: &args,
    };
    let begun = Instant::now();
    let Args { every, shard, latest, raw, .. } = args;
    let wanted = Wanted { every, shard, latest, raw };
    let mut reader = Reader::start(sources, wanted);
    let stopped = stop_in_order(reader.stopper());
    let failure = reader.by_ref().find_map(|event| run.take(event).err());
    let dropped = reader.dropped();
    drop(reader);
    run.progress.finish_and_clear();
    // However it ends, what was found so far is kept.
    run.exit = run.exit.max(run.files.finish(&mut run.outputs));
    if let Some(failure) = failure {
        return Err(Failure { exit: failure.exit.max(run.exit), ..failure });
    }
    let line = run.sums.line(&detector, begun.elapsed(), args.latest.then_some(dropped));
    // What reads objects counts them itself, but not the frames that were dropped.
    if args.json && !args.latest {
        detail(line)
    } else {
        remark(line)
    }
    Ok(if stopped.load(Ordering::SeqCst) { Exit::Interrupted } else { run.exit })
}

/// Lets Ctrl-C, and what else asks for an end, end the reading; a second one ends the program at once.
fn stop_in_order(reading: Stop) -> Arc<AtomicBool> {
    let stopped = Arc::new(AtomicBool::new(false));
    let stop = stopped.clone();
    let handler = ctrlc::set_handler(move || {
        if stop.swap(true, Ordering::SeqCst) {
            std::process::exit(Exit::Interrupted as i32);
        }
        reading.stop();
    });
    if let Err(e) = handler {
        tell(format!("Ctrl-C will lose files that are not finished: {e}"));
    }
    stopped
}

/// What a run has seen, and where its results go.
struct Run<'a> {
    detector: &'a GpuDetector,
    args: &'a Args,
    table: Table,
    files: Files<'a>,
    outputs: Outputs,
    assumed: Assumed,
    sums: Sums,
    progress: ProgressBar,
    exit: Exit,
}

#[derive(Default)]
struct Sums {
    frames: usize,
    snaps: usize,
    read: Duration,
    look: Duration,
    write: Duration,
}

impl Sums {
    /// What was found, and what each step took a picture, in a line.
    fn line(&self, detector: &GpuDetector, wall: Duration, dropped: Option<u64>) -> String {
        let ms = |sum: Duration| sum.as_secs_f64() * 1e3 / self.frames.max(1) as f64;
        let mut line = format!(
            "{} in {} on {}, {:.2} s",
            count(self.snaps, "snap"),
            count(self.frames, "picture"),
            detector.adapter(),
            wall.as_secs_f64(),
        );
        if self.frames > 0 {
            let [read, look, write] = [self.read, self.look, self.write].map(ms);
            line += &format!(
                "; a picture: {read:.1} ms to read, {look:.1} to look, {write:.1} to write"
            );
        }
        if let Some(dropped) = dropped {
            line += &format!("; {} dropped", count(dropped as usize, "frame"));
        }
        line
    }
}

impl Run<'_> {
    /// # Errors
    /// What ends the run.
    fn take(&mut self, event: Event) -> Result<(), Failure> {
        match event {
            Event::Message(Message::Failed(message)) => {
                self.progress.suspend(|| tell(message));
                self.exit = self.exit.max(Exit::Inputs);
                Ok(())
            }
            Event::Message(Message::Remark(message)) => {
                self.progress.suspend(|| remark(message));
                Ok(())
            }
            Event::Frame(shot) => self.look(&shot),
        }
    }

    /// Looks at a frame, and gives what is found there to all who want it.
    fn look(&mut self, shot: &Shot) -> Result<(), Failure> {
        let (id, begun) = (&shot.id, Instant::now());
        let (found, stages) = match detect_one(self.detector, shot, self.args) {
            Ok(found) => found,
            Err(failure) if failure.is_of_one_picture() => {
                self.exit = self.exit.max(failure.told().exit);
                return Ok(());
            }
            Err(failure) => return Err(failure.told()),
        };
        let looked = Instant::now();
        let remarks = self.assumed.remarks(id, &found);
        remarks.iter().for_each(|text| self.progress.suspend(|| remark(text)));
        if found.precision != self.detector.precision() {
            remark(format!("{id}: past what f16 holds; looked at again in f32"));
        }
        let printed = match self.args.json {
            true => json_line(&Record::new(id, &found, self.detector)),
            false => self.table.frame(id, &found),
        };
        // A file that cannot be written takes none of the other results with it, nor does a closed stdout.
        self.exit = self.exit.max(self.files.add(&mut self.outputs, shot, &found));
        if let Some(file) = &self.args.dump_stages {
            let dumped = dump(&mut self.outputs, file, self.detector, id, &stages);
            self.exit = self.exit.max(told(dumped));
        }
        let [read, look, write] =
            [shot.read, looked - begun, looked.elapsed()].map(|time| time.as_secs_f64() * 1e3);
        detail(format!("{id}: {read:.1} ms to read, {look:.1} to look, {write:.1} to write"));
        self.progress.inc(1);
        self.sums.frames += 1;
        self.sums.snaps += found.detections.len();
        self.sums.read += shot.read;
        self.sums.look += looked - begun;
        self.sums.write += looked.elapsed();
        printed
    }
}

/// Looks at one frame; the stages' tensors come along if they were asked for.
fn detect_one(
    detector: &GpuDetector,
    shot: &Shot,
    args: &Args,
) -> Result<(Detections, Stages), Failure> {
    let frame = shot.pixels.frame();
    let result = match args.dump_stages {
        Some(_) => verify::stages(detector, &frame),
        None => detector.detect(&frame).map(|found| (found, Vec::new())),
    };
    result.map_err(|e| Failure::about(&shot.id, &e))
}

/// Writes the stages' tensors.
fn dump(
    outputs: &mut Outputs,
    file: &Path,
    detector: &GpuDetector,
    id: &FrameId,
    stages: &Stages,
) -> Result<(), Failure> {
    let config = serde_json::to_string(detector.model())
        .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", file.display())))?;
    let metadata = HashMap::from([
        ("picture".to_owned(), id.source.to_string()),
        ("adapter".to_owned(), detector.adapter()),
        ("config".to_owned(), config),
    ]);
    let stages = stages.iter().map(|(name, value)| (name.as_str(), value));
    tensors::write(outputs, file, stages, metadata)
}
