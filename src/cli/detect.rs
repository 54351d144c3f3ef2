//! `smr-gpu detect`: finds the snaps in pictures, prints and draws them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::DynamicImage;
use serde::Serialize;
use smr_gpu::engine::graph::StageTime;
use smr_gpu::evaluation::tradeoff::Limit;
use smr_gpu::files::Outputs;
use smr_gpu::verify::{self, Stages};
use smr_gpu::{Detection, Detections, Frame, GpuDetector, Origin, Precision, Rect, Scale};

use super::detector::{self, Assumed, DetectorArgs, exact_fraction, fraction};
use super::draw::{Artist, Gallery};
use super::exit::{Exit, Failure, told};
use super::message::tell;
use super::output::{count, json_line, line};
use super::printable::printable;
use super::source::{Source, column_width, expand_all};
use super::tensors;

/// Find the snaps in pictures
///
/// Prints a line a snap, or with --json an object a picture. A picture that cannot be read is named
/// on stderr; the others still go through. Pictures have at most 33 554 432 pixels and 320 MiB; with weights
/// of at most 256 MiB that takes less than 1 GiB of memory, what a GPU's driver takes aside.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Pictures (PNG, JPEG, BMP, TIFF), folders of pictures, patterns such as 'in/*.png', or `-`
    /// for one picture on stdin.
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<PathBuf>,

    /// Print one JSON object a line for each picture.
    #[arg(long)]
    json: bool,

    /// Write each picture with its boxes, names and scores drawn into this folder, as PNG.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,

    /// Show detections with a score above this (0 to 1).
    #[arg(long, default_value_t = 0.5, value_name = "SCORE", value_parser = fraction)]
    #[arg(allow_negative_numbers = true)]
    conf: f32,

    /// Show at most so many detections a picture (1 to 100).
    #[arg(long, default_value_t = 100, value_name = "N")]
    #[arg(value_parser = clap::value_parser!(u8).range(1..=100))]
    #[arg(allow_negative_numbers = true)]
    max_det: u8,

    /// Look for this class alone; may be given several times.
    #[arg(long = "class", value_name = "NAME")]
    classes: Vec<String>,

    /// Write every stage's tensor, under the PyTorch model's names; for one picture. A tensor inside
    /// a stage has the name of the layer that made it, after batch norm, residual and ReLU. Nothing is left
    /// out then, as with --exact.
    #[arg(long, value_name = "FILE.safetensors", conflicts_with = "leave_out")]
    dump_stages: Option<PathBuf>,

    /// Run as the table says that `smr-gpu tradeoff` wrote, on whole pictures: the fastest configuration within
    /// --max-shift-mm, or with --min-iou. Refused where adapter, driver or weights are not the table's.
    #[arg(long, value_name = "JSON", conflicts_with_all = ["weights", "size", "device", "precision", "leave_out"])]
    tradeoff: Option<PathBuf>,

    /// With --tradeoff: nineteen of twenty boxes are within so many millimetres of the base's.
    #[arg(long, value_name = "MM", requires = "tradeoff", value_parser = super::tradeoff::millimetres)]
    #[arg(default_value_t = super::tradeoff::SHIFT_MM, allow_negative_numbers = true)]
    max_shift_mm: f64,

    /// With --tradeoff: the mean overlap with the labels is at least this.
    #[arg(long, value_name = "IOU", requires = "tradeoff", conflicts_with = "max_shift_mm")]
    #[arg(value_parser = exact_fraction, allow_negative_numbers = true)]
    min_iou: Option<f64>,

    #[command(flatten)]
    detector: DetectorArgs,
}

/// One picture's results, as `--json` prints them.
#[derive(Serialize)]
struct Record<'a> {
    file: String,
    /// Where the name is no Unicode, see [`super::source::base64`].
    #[serde(skip_serializing_if = "Option::is_none")]
    file_base64: Option<String>,
    width: u32,
    height: u32,
    /// The part that shows the gel, and whether that is assumed.
    gel: Rect,
    gel_assumed: bool,
    #[serde(flatten)]
    scale: Scale,
    detections: &'a [Detection],
    /// Whether something touches the gel; null where nobody looked.
    contact: Option<bool>,
    /// The parts of the picture that the network looked at, if any; null for all of it.
    regions: Option<&'a [Rect]>,
    /// What was left out, and why.
    left_out: Vec<String>,
    timings_ms: Timings<'a>,
    adapter: String,
    precision: Precision,
    /// The choice of kernels: where it is equal, so are the bits.
    kernels: String,
}

#[derive(Serialize)]
struct Timings<'a> {
    stages: &'a [StageTime],
    total: f64,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let (sources, mut exit) = expand_all(&args.sources)?;
    if args.dump_stages.is_some() && sources.len() != 1 {
        let got = sources.len();
        return Err(Failure::usage(format!("--dump-stages: expected one picture, got {got}")));
    }
    if sources.is_empty() {
        return Ok(exit);
    }
    let limit = args.min_iou.map_or(Limit::ShiftMm(args.max_shift_mm), Limit::Iou);
    let mut config = match &args.tradeoff {
        Some(table) => super::tradeoff::chosen(table, limit, &args.detector)?,
        None => args.detector.config()?,
    };
    config.score = args.conf;
    config.max_detections = args.max_det.into();
    config.classes = args.classes.clone();
    config.keep_stages = args.dump_stages.is_some();
    let mut outputs = Outputs::sparing(sources.iter().map(|source| match source {
        Source::File(path) => path.as_path(),
        // Where this is a file, it is as much an input.
        Source::Stdin => Path::new("/dev/stdin"),
    }));
    args.detector.network.spare(&mut outputs, &config);
    args.tradeoff.iter().for_each(|table| outputs.spare(table));
    if let Some(file) = &args.dump_stages {
        outputs.check(file)?;
    }
    let detector = detector::open(config)?;
    let mut gallery = args.save.as_deref().map(Gallery::create).transpose()?;
    let artist = Artist::new(&detector.model().classes);
    let mut table = Table::new(&sources, &detector.model().classes);
    let (mut pictures, mut snaps, start) = (0, 0, Instant::now());
    let mut assumed = Assumed::default();
    for source in &sources {
        let picture = match source.picture() {
            Ok(picture) => picture,
            Err(message) => {
                tell(format!("{source}: {message}"));
                exit = exit.max(Exit::Inputs);
                continue;
            }
        };
        let (found, stages) = match detect_one(&detector, source, &picture, &args) {
            Ok(found) => found,
            Err(failure) if failure.is_of_one_picture() => {
                exit = exit.max(failure.told().exit);
                continue;
            }
            Err(failure) => return Err(failure.told()),
        };
        assumed.remarks(source, &found).iter().for_each(tell);
        if found.precision != detector.precision() {
            tell(format!("{source}: past what f16 holds; looked at again in f32"));
        }
        match args.json {
            true => json_line(&record(source, &found, &detector))?,
            false => table.picture(source, &found)?,
        }
        // A file that cannot be written takes none of the other results with it.
        if let Some(gallery) = &mut gallery {
            let drawn = artist.draw_found(&picture, &found);
            exit = exit.max(told(gallery.save(&mut outputs, source, &drawn)));
        }
        if let Some(file) = &args.dump_stages {
            exit = exit.max(told(dump(&mut outputs, file, &detector, source, &stages)));
        }
        pictures += 1;
        snaps += found.detections.len();
    }
    if !args.json {
        let seconds = start.elapsed().as_secs_f64();
        tell(format!(
            "{} in {} on {}, {seconds:.2} s",
            count(snaps, "snap"),
            count(pictures, "picture"),
            detector.adapter()
        ));
    }
    Ok(exit)
}

/// Looks at one picture; the stages' tensors come along if they were asked for.
fn detect_one(
    detector: &GpuDetector,
    source: &Source,
    picture: &DynamicImage,
    args: &Args,
) -> Result<(Detections, Stages), Failure> {
    let result = match args.dump_stages {
        Some(_) => verify::stages(detector, &Frame::from(picture)),
        None => detector.detect(picture).map(|found| (found, Vec::new())),
    };
    result.map_err(|e| Failure::about(source, &e))
}

/// Writes the stages' tensors.
fn dump(
    outputs: &mut Outputs,
    file: &Path,
    detector: &GpuDetector,
    source: &Source,
    stages: &Stages,
) -> Result<(), Failure> {
    let config = serde_json::to_string(detector.model())
        .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", file.display())))?;
    let metadata = HashMap::from([
        ("picture".to_owned(), source.to_string()),
        ("adapter".to_owned(), detector.adapter()),
        ("config".to_owned(), config),
    ]);
    let stages = stages.iter().map(|(name, value)| (name.as_str(), value));
    tensors::write(outputs, file, stages, metadata)
}

fn record<'a>(source: &Source, found: &'a Detections, detector: &'a GpuDetector) -> Record<'a> {
    Record {
        file: source.to_string(),
        file_base64: source.base64(),
        width: found.width,
        height: found.height,
        gel: found.gel,
        gel_assumed: found.gel_assumed,
        scale: found.scale,
        detections: &found.detections,
        contact: found.contact,
        regions: found.regions.as_deref(),
        left_out: found.left_out(&detector.config().savings),
        timings_ms: Timings { stages: &found.stages, total: found.wall.as_secs_f64() * 1e3 },
        adapter: detector.adapter(),
        precision: found.precision,
        kernels: format!("{:016x}", detector.kernels().digest()),
    }
}

/// Heading of the classes' column.
const CLASS: &str = "class";

/// The table for people: a line a snap, or one for a picture without, below a head with their scale.
struct Table {
    file_width: usize,
    class_width: usize,
    /// That of the last head.
    scale: Option<Scale>,
}

impl Table {
    fn new(sources: &[Source], classes: &[String]) -> Self {
        let names = classes.iter().map(String::as_str).chain([CLASS]);
        let longest = names.map(|name| printable(name).chars().count()).max();
        let (file_width, class_width) = (column_width(sources), longest.unwrap_or(0));
        Self { file_width, class_width, scale: None }
    }

    /// The head, where the scale is another than that of the last.
    fn heading(&mut self, scale: Scale) -> Result<(), Failure> {
        if self.scale.replace(scale) == Some(scale) {
            return Ok(());
        }
        let [x1, y1, x2, y2] = ["x1", "y1", "x2", "y2"];
        let from = match scale.from {
            Origin::Stated => "stated",
            Origin::Sensor => "of the sensor",
            Origin::Label => "of the label",
            Origin::Assumed => "assumed",
        };
        line(format!(
            "{:w$}  {CLASS:c$}  score  {x1:>7} {y1:>7} {x2:>7} {y2:>7} px  {:>7} {:>7} mm  {:>6} °  at \
             {:.4} mm a pixel, {from}",
            "file",
            "x",
            "y",
            "yaw",
            scale.mm_per_pixel,
            w = self.file_width,
            c = self.class_width
        ))
    }

    fn picture(&mut self, source: &Source, found: &Detections) -> Result<(), Failure> {
        self.heading(found.scale)?;
        let file = printable(source);
        let Self { file_width: w, class_width: c, .. } = *self;
        if found.detections.is_empty() {
            return line(format!("{file:w$}  no snaps"));
        }
        for d in &found.detections {
            let [x1, y1, x2, y2] = d.bbox;
            let [x, y] = d.center_mm;
            line(format!(
                "{file:w$}  {:c$}  {:.3}  {x1:7.1} {y1:7.1} {x2:7.1} {y2:7.1}     {x:7.2} {y:7.2}     \
                 {:>6}{}",
                printable(&d.class),
                d.score,
                d.yaw_deg.map_or("-".into(), |yaw| format!("{yaw:.1}")),
                // Below an even chance.
                if d.whole.is_some_and(|whole| whole < 0.5) { "  cut by the edge" } else { "" }
            ))?;
        }
        Ok(())
    }
}
