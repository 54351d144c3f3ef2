//! `smr-gpu simulate`: data sets of simulated pictures.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Once};

use clap::ValueEnum;
use smr_gpu::Sensor;
use smr_gpu::files::{Outputs, Shard};
use smr_gpu::simulator::Error;
use smr_gpu::simulator::conditions::Distribution;
use smr_gpu::simulator::dataset::{self, Progress, Settings, Step, Summary};
use smr_gpu::simulator::distractors::Part;
use smr_gpu::simulator::forced::Forced;
use smr_gpu::simulator::given::Given;
use smr_gpu::simulator::render::Request;
use smr_gpu::simulator::scene::{Mix, Own};

use super::detector::sensor;
use super::exit::{Exit, Failure};
use super::message::remark;
use super::output;
use super::parts::{self, CadArgs, PartArg, part};
use super::preview;

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu simulate --out train --count 1000 --seed 1 --conditions wide
  smr-gpu simulate --out clips --count 100 --seed 2 --part clip=clip.stl
  smr-gpu simulate --preview sheet.png --part clip=clip.stl";

/// Simulate pictures of snaps pressed into the sensor's gel
///
/// Writes DIR/images/000000.png and so on, and DIR/annotations.json (COCO). The same seed gives the same pictures,
/// whatever the number of threads. Different seeds share no scene: give training, validation and test sets each their
/// own. Called again with the same options, a run that was stopped goes on.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folder to write to.
    #[arg(help_heading = "Output", long, value_name = "DIR", required_unless_present = "preview")]
    out: Option<PathBuf>,

    /// Number of pictures.
    #[arg(help_heading = "Output", long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    #[arg(allow_negative_numbers = true, required_unless_present_any = ["preview", "paper"])]
    count: Option<u32>,

    /// Seed of the data set, or of the presses of --preview.
    #[arg(help_heading = "Output", long, value_name = "S")]
    #[arg(allow_negative_numbers = true, required_unless_present_any = ["preview", "paper"])]
    seed: Option<u64>,

    /// Draw the two sets of the paper's experiments, DIR/a and DIR/b: 1000 pictures of each snap, by seeds that are
    /// fixed, or the first N of them. No weights here have learnt from them.
    #[arg(help_heading = "Output", long, requires = "out", conflicts_with_all = [
        "seed", "preview", "kind", "conditions", "press", "sensor", "part", "negative", "look_alike", "force",
    ])]
    paper: bool,

    /// Write one sheet (PNG) instead of a data set: of each --part what is seen of it from the gel, where its 0°
    /// is, its heights in millimetres, and six presses with their boxes and directions.
    #[arg(help_heading = "Output", long, value_name = "FILE", requires = "part", conflicts_with_all = [
        "out", "count", "kind", "conditions", "press", "sensor", "look_alike", "force",
    ])]
    preview: Option<PathBuf>,

    /// Draw each nth picture alone, from the ith on, and no annotations.json: n runs draw a data set together, into
    /// one folder or several that are put together. The same without --shard then draws what is missing and
    /// writes annotations.json.
    #[arg(help_heading = "Output", long, value_name = "I/N", conflicts_with = "preview")]
    shard: Option<Shard>,

    /// Which snaps the pictures show.
    #[arg(help_heading = "What is shown", long, value_enum, default_value_t = Mix::Mixed)]
    kind: Mix,

    /// From what frames, light, wear and parts are drawn.
    #[arg(help_heading = "What is shown", long, value_enum, default_value_t = Conditions::Plain)]
    conditions: Conditions,

    /// Draw the frames of one press in their order, 500 for each: a snap comes, presses, rests, slides and
    /// goes, under light that drifts (plain conditions).
    #[arg(help_heading = "What is shown", long, conflicts_with_all = ["sensor", "look_alike", "force"])]
    press: bool,

    /// Draw the pictures that one sensor takes: `paper`, `gelsight-mini`, `digit` or a sensor file (JSON), as
    /// `smr-gpu calibrate` writes. Frame, gel, scale, distortion and, if the file has them, light, markers
    /// and the untouched gel's picture are the sensor's. Plain conditions draw all else weakly, but for the
    /// lights' colour, which is grey on some sensors and strong on others.
    #[arg(help_heading = "Sensor", long, value_name = "NAME|FILE", value_parser = drawable)]
    sensor: Option<Sensor>,

    /// A class of snaps of your own, several times for several: its name, and its part from a CAD file (STL,
    /// OBJ) or a height map (PNG of 16 bits). `A` and `B` may be among them, which else they replace. What is
    /// easily taken for a part is drawn too, without a label: its outline as a plain block, the part without
    /// its tip, and its mirror image. Or FILE is JSON that names the part's `file`, from its own folder, and
    /// of `axis`, `up`, `unit`, `map_pixel` and `map_height` what is other than the options say.
    #[arg(help_heading = "Parts of your own", long, value_name = "NAME=FILE|A|B", value_parser = part)]
    part: Vec<PartArg>,

    /// A shape that is no snap, several times for several: a file as for --part.
    #[arg(help_heading = "Parts of your own", long, value_name = "FILE", requires = "part")]
    negative: Vec<PathBuf>,

    #[command(flatten)]
    cad: CadArgs,

    /// Narrow what is no snap to one kind: arm, block, tab, ring, screw, nut, ball, prism, bracket, letters, rib,
    /// edge, pin, clutter or nothing (wide conditions, or a sensor's); beside --part also what belongs to a part, as
    /// NAME-block, NAME-cut and NAME-mirror, or the name of a --negative, A or B.
    #[arg(help_heading = "What is shown", long, value_name = "KIND")]
    look_alike: Option<String>,

    /// Set conditions for all pictures, KEY or KEY=VALUE, separated by commas (wide conditions, or a sensor's).
    ///
    /// Numbers may be ranges, as in strength=2..4; of yes and no the name alone is yes.
    ///
    ///   mild        the paper's frame, and whatever is not set but colour is drawn weakly
    ///   frame       paper, gelsight-mini or WIDTHxHEIGHT@MM_PER_PIXEL
    ///   scale       of things beside the frame's own, as far as fields of 10 to 60 mm go
    ///   optics      measured or lamps
    ///   strength    of the shading; at 1 a slope of a half changes the brightness by a tenth
    ///   light       from one side: direction from x towards y, in degrees (sets optics=lamps)
    ///   darkness    share of the light that gel lacks which is pressed deep, as with grey gels
    ///   rim         change of brightness where the gel turns up from what presses, as a share
    ///   shadows     share of a light that its shadows take away
    ///   colour      of the lights: 0 grey, 1 each of its own; negative: one channel
    ///   exposure    factor on the brightness
    ///   markers     pitch in mm
    ///   mottle      of the coating, standard deviation
    ///   jpeg        quality
    ///   blur        in pixels
    ///   vignetting  share of the light lost in the corners
    ///   housing     at the frame's edges, yes or no
    ///   distortion  of the lens
    ///   snr         in dB
    ///   gel         its thickness in mm, 2.5 or more
    ///   mechanics   elastic or smoothed
    ///   wall, side  hooks with one, on their side; yes or no
    ///   cut         snaps at the picture's edge, yes or no
    ///   touching    snaps beside other parts, yes or no
    ///   gap         two to five parts side by side, so many mm apart
    ///   size        longer side of snaps, in mm
    ///   barbs       hooks with longer, wider or rounder barbs, yes or no
    ///   slots       of studs
    ///   hole        of studs, in mm
    ///   bead, fillet  of studs and rings, in mm
    ///   drive       of screws: cross, slot or hex
    ///   depth       of snaps, in mm, as far as the gel's thickness goes
    #[arg(
        help_heading = "What is shown",
        long,
        value_name = "KEY[=VALUE],…",
        default_value = "",
        hide_default_value = true,
        verbatim_doc_comment
    )]
    force: Forced,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Conditions {
    /// The paper's sensor: 1000×1000 pixels at 0.04 mm.
    Plain,
    /// Sensors of many kinds: frames, fields of 10 to 60 mm, lamps, shadows, markers, look-alikes.
    Wide,
}

/// A sensor whose frames have a size to draw.
///
/// # Errors
/// In words.
pub(super) fn drawable(text: &str) -> Result<Sensor, String> {
    let has_frame = |sensor: &Sensor| sensor.frame.is_some();
    let names = || {
        let drawn = |name: &&str| Sensor::named(name).is_some_and(|sensor| has_frame(&sensor));
        Sensor::NAMES.into_iter().filter(drawn).collect::<Vec<_>>().join(", ")
    };
    if Sensor::named(text).is_none() && !Path::new(text).exists() {
        return Err(format!("expected {} or a file", names()));
    }
    let sensor = sensor(text)?;
    match has_frame(&sensor) {
        true => Ok(sensor),
        false => Err(format!("expected {}, or a file that states a `frame` to draw", names())),
    }
}

/// The sets of the paper's experiments: their folders, what they show, their seeds.
const PAPER: [(&str, Mix, u64); 2] = [("a", Mix::A, 47301), ("b", Mix::B, 47302)];
/// Pictures of each.
const PAPER_COUNT: u32 = 1000;

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    if let (true, Some(out)) = (args.paper, &args.out) {
        let count = args.count.unwrap_or(PAPER_COUNT) as usize;
        for (name, mix, seed) in PAPER {
            let request = Request { mix, ..Request::default() };
            let out = out.join(name);
            draw(&Settings { out, count, seed, request, shard: args.shard })?;
        }
        return Ok(Exit::Done);
    }
    let mut own = parts::own(&args.part, &args.negative, &args.cad)?;
    let (out, count, seed) = match (args.preview, args.out, args.count, args.seed) {
        (Some(sheet), _, _, seed) => {
            let mut outputs = Outputs::sparing(parts::files(&args.part));
            preview::write(&mut outputs, &sheet, &own, seed.unwrap_or_default())?;
            remark(format!("{}: what the simulator makes of the parts", sheet.display()));
            return Ok(Exit::Done);
        }
        (None, Some(out), Some(count), Some(seed)) => (out, count, seed),
        _ => return Err(Failure::usage("expected --out, --count and --seed, or --preview")),
    };
    let Args { kind, conditions, press, sensor, look_alike, mut force, shard, .. } = args;
    let plain = conditions == Conditions::Plain;
    let narrowed = look_alike.is_some();
    let look_alike = match look_alike {
        Some(name) => only(&name, &mut own)?,
        None => None,
    };
    if plain && sensor.is_none() && (look_alike.is_some() || force != Forced::default()) {
        return Err(Failure::usage("--look-alike and --force need --conditions wide or --sensor"));
    }
    if press && (!plain || matches!(kind, Mix::None | Mix::Bare)) {
        return Err(Failure::usage(
            "--press needs --conditions plain and a snap: --kind a, b or mixed",
        ));
    }
    if narrowed && kind == Mix::Bare {
        let message = "--look-alike needs a --kind that shows parts, not --kind bare";
        return Err(Failure::usage(message));
    }
    let sensor = sensor.map(Given::new).transpose();
    let sensor = sensor.map_err(|e| Failure::new(Exit::Inputs, e))?.map(Arc::new);
    if let Some(key) = sensor.as_ref().and_then(|given| given.stated(&force)) {
        let message =
            format!("--force: expected no {key} beside a --sensor that states it, got one");
        return Err(Failure::usage(message));
    }
    // A given sensor is drawn as a wide one of which little is left to chance.
    force.mild |= plain && sensor.is_some();
    let conditions = match plain && sensor.is_none() {
        true => Distribution::Plain,
        false => Distribution::Wide,
    };
    if !own.classes.is_empty() && matches!(kind, Mix::A | Mix::B) {
        return Err(Failure::usage(
            "--kind a and b are for A and B: with --part, mixed, none or bare",
        ));
    }
    let request =
        Request { mix: kind, conditions, part: look_alike, forced: force, sensor, press, own };
    draw(&Settings { out, count: count as usize, seed, request, shard })?;
    Ok(Exit::Done)
}

/// Draws a data set and tells what came of it.
fn draw(settings: &Settings) -> Result<(), Failure> {
    let bar = output::bar(0, "{msg} {bar:40} {pos}/{len} pictures, {eta} left");
    let rendering = Once::new();
    let result = dataset::simulate(settings, &|Progress { step, done, all }| {
        match step {
            Step::Check => bar.set_message("checking"),
            // The time left is of this step alone.
            Step::Render => rendering.call_once(|| {
                bar.reset();
                bar.set_message("rendering");
                bar.set_position(done as u64);
                bar.reset_eta();
            }),
        }
        bar.set_length(all as u64);
        // Threads report out of order.
        bar.set_position(bar.position().max(done as u64));
    });
    bar.finish_and_clear();
    let summary = result.map_err(failure)?;
    let Summary { rendered, kept, snaps } = summary;
    let pictures = format!("{} ({rendered} new)", output::count(rendered + kept, "picture"));
    let file = settings.out.join("annotations.json");
    remark(match snaps {
        Some(snaps) => format!("{}: {pictures}, {}", file.display(), output::count(snaps, "snap")),
        None => format!("{}: {pictures}", settings.out.display()),
    });
    Ok(())
}

/// The kind of look-alike of this name; one of a part's own is left alone in `own`.
///
/// # Errors
/// [`Exit::Usage`] where there is none.
fn only(name: &str, own: &mut Own) -> Result<Option<Part>, Failure> {
    if let Ok(part) = Part::from_str(name, true) {
        return Ok(Some(part));
    }
    if !own.negatives.iter().any(|negative| negative.name == name) {
        let kinds = Part::value_variants().iter().filter_map(ValueEnum::to_possible_value);
        let kinds = kinds.map(|kind| kind.get_name().to_owned());
        let names = own.negatives.iter().map(|negative| negative.name.clone());
        let all: Vec<String> = kinds.chain(names).collect();
        let all = all.join(", ");
        return Err(Failure::usage(format!("--look-alike: expected one of {all}, got {name}")));
    }
    own.negatives.retain(|negative| negative.name == name);
    own.negatives_alone = true;
    Ok(None)
}

/// What of the simulator's errors the program ends with.
pub(super) fn failure(error: Error) -> Failure {
    let exit = match error {
        Error::OtherDataset { .. } | Error::NoScene { .. } => Exit::Usage,
        // The simulator reads nothing but what it wrote, and another run may write there.
        _ => Exit::Output,
    };
    Failure::new(exit, error)
}
