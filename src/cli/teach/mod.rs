//! `smr-gpu teach`: a detector of one's own parts, from CAD files, from labelled pictures, or from both.
//!
//! | file | what it holds |
//! |---|---|
//! | `plan` | which pictures are simulated |
//! | `python` | the training package as a child |
//! | `judge` | what the detector finds in pictures that it did not learn from |
//! | `charts` | the report's plots |
//! | `report` | the report |

mod charts;
mod judge;
mod plan;
mod python;
mod report;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use indicatif::HumanDuration;
use serde::{Deserialize, Serialize};
use smr_gpu::files::{self, Lock, Outputs, Sharing, lock};
use smr_gpu::simulator::dataset::{self, Progress, Settings, Step};
use smr_gpu::simulator::given::Given;
use smr_gpu::simulator::scene::Own;
use smr_gpu::smr::Catalog;

use super::detector::exact_fraction;
use super::eval;
use super::exit::{Exit, Failure};
use super::message::remark;
use super::names::shown;
use super::output::{bar, count, line};
use super::parts::{self, CadArgs, PartArg};
use super::preview;
use super::simulate::{drawable, failure};
use plan::{Plan, Role, Set};
use python::{Estimate, Python};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu teach clip=clip.stl pin=pin.stl --out mine.safetensors --python train/bin/python
  smr-gpu teach clip.stl --out mine.safetensors --estimate
  smr-gpu teach --data labelled --out mine.safetensors --sensor gelsight-mini";

/// Train a detector for parts of your own
///
/// From CAD files: simulates pictures of the parts and of what is taken for them, trains the network on these, fits
/// scores and stated deviations, and shows the result on other pictures. From your own labelled pictures (--data,
/// COCO): trains on four fifths of them and shows the result on the rest. From both: on both at once.
///
/// OUT is a weight file for --weights; the report is WORK/report.md. Needs a Python with the training package,
/// weights/training of the sources, whose README says how to install it. Called again with the same options, a run
/// that was stopped goes on, and gives the same weights.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Parts: a CAD file (STL, OBJ) or a height map (PNG of 16 bits) each, with a name before it or called as the
    /// file is; `A` and `B` may be among them.
    #[arg(value_name = "[NAME=]FILE|A|B", value_parser = parts::part_or_file)]
    part: Vec<PartArg>,

    /// Weight file to write.
    #[arg(help_heading = "Output", long, value_name = "FILE")]
    out: PathBuf,

    /// Folders of your own pictures: annotations.json (COCO) and the pictures it names. Their classes are
    /// learnt beside the parts'; a name that both have is one class.
    #[arg(help_heading = "Input", long, value_name = "DIR", num_args = 1..)]
    data: Vec<PathBuf>,

    /// Of all views that are learnt from, how many are of --data's pictures where there are parts too, 0 to 1.
    #[arg(help_heading = "Input", long, value_name = "SHARE", default_value_t = 0.5, value_parser = inner_fraction)]
    data_share: f64,

    /// A shape that is no snap, several times for several: a file as for a part.
    #[arg(help_heading = "Parts of your own", long, value_name = "FILE", requires = "part")]
    negative: Vec<PathBuf>,

    #[command(flatten)]
    cad: CadArgs,

    /// The sensor that takes the pictures: a name or a sensor file (JSON), as `smr-gpu calibrate` writes. A quarter
    /// of the simulated pictures are drawn as it takes them, and it has taken those of --data that state no scale.
    #[arg(help_heading = "Sensor", long, value_name = "NAME|FILE")]
    sensor: Option<String>,

    /// The network to begin with: what it knows of contact helps with any part. `large` learns four times slower.
    #[arg(
        help_heading = "Model",
        long,
        value_name = "large|small|NAME|FILE",
        default_value = "small"
    )]
    network: PathBuf,

    /// Simulated pictures to learn from.
    #[arg(help_heading = "Training", long, value_name = "N", default_value_t = 4000)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pictures: u32,

    /// Steps of training, of about twelve views each.
    #[arg(help_heading = "Training", long, value_name = "N", default_value_t = 4000)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    steps: u32,

    /// Simulated pictures to show the result on, plain and wide ones each; of what is taken for a part half as many.
    #[arg(help_heading = "Training", long, value_name = "N", default_value_t = 200)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=100_000))]
    test: u32,

    /// Seed of pictures and training.
    #[arg(help_heading = "Training", long, value_name = "S", default_value_t = 1, value_parser = clap::value_parser!(u32).range(..1_000_000))]
    seed: u32,

    /// Folder of pictures, training and report [default: OUT with .teach in place of its ending].
    #[arg(help_heading = "Output", long, value_name = "DIR")]
    work: Option<PathBuf>,

    /// The Python that has the training package.
    #[arg(help_heading = "Training", long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,

    /// Say what would be learnt from and how long it would take here, and end.
    #[arg(help_heading = "Training", long)]
    estimate: bool,
}

/// Highest rate of learning.
const RATE: &str = "8e-4";
/// Share of labelled pictures that are held out.
const HELD_OUT: &str = "0.2";
/// Between two looks at validation pictures, in minutes.
const LOOK_MINUTES: &str = "12";
/// Pictures that the estimate is made with.
const PILOT: usize = 40;
/// What a picture takes to be looked at in the end, in seconds: to decode and to detect. A guess, and little.
const LOOK_SECONDS: f64 = 0.15;

/// What was asked for, as WORK/teach.json keeps it: another call must ask for the same.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Asked {
    parts: Vec<String>,
    negatives: Vec<String>,
    data: Vec<PathBuf>,
    data_share: f64,
    sensor: Option<String>,
    network: PathBuf,
    pictures: u32,
    steps: u32,
    test: u32,
    seed: u32,
}

fn inner_fraction(text: &str) -> Result<f64, String> {
    let value = exact_fraction(text)?;
    match value > 0.0 && value < 1.0 {
        true => Ok(value),
        false => Err("expected more than 0 and less than 1".to_owned()),
    }
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    if args.part.is_empty() && args.data.is_empty() {
        return Err(Failure::usage("expected parts, --data or both, got neither"));
    }
    let work = args.work.clone().unwrap_or_else(|| args.out.with_extension("teach"));
    files::check(&args.out)?;
    let own = parts::own(&args.part, &args.negative, &args.cad)?;
    let given = match &args.sensor {
        Some(text) => {
            let sensor = drawable(text).map_err(|e| Failure::usage(format!("--sensor: {e}")))?;
            Some(Arc::new(Given::new(sensor).map_err(|e| Failure::new(Exit::Inputs, e))?))
        }
        None => None,
    };
    std::fs::create_dir_all(&work)
        .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", shown(work.as_os_str()))))?;
    let python = Python::new(&args.python, &work)?;
    let _lock = match lock(&work.join(".teach.lock"), Sharing::Alone)? {
        Lock::Held(held) => held,
        Lock::Busy(_) => {
            let work = shown(work.as_os_str());
            return Err(Failure::new(Exit::Output, format!("{work}: another run works there")));
        }
    };
    let asked = Asked::of(&args);
    asked.as_begun(&work)?;
    python::stop_in_order();

    let plan = Plan {
        work: &work,
        own: &own,
        sensor: given.clone(),
        seed: args.seed.into(),
        pictures: args.pictures as usize,
        test: args.test as usize,
    };
    let sets = if args.part.is_empty() { Vec::new() } else { plan.sets() };
    if !sets.is_empty() {
        let mut outputs = Outputs::sparing(parts::files(&args.part));
        preview::write(&mut outputs, &work.join("parts.png"), &own, args.seed.into())?;
    }
    let teaching = Teaching { args: &args, work, own, sensor: given, sets, python };
    let started = Instant::now();
    teaching.foresee()?;
    if args.estimate {
        return Ok(Exit::Done);
    }
    asked.begin(&teaching.work)?;
    teaching.simulate()?;
    let trained = teaching.train()?;
    let calibrated = teaching.calibrate(&trained)?;
    let report = teaching.judge(&calibrated)?;
    let weights = read(&calibrated)?;
    files::write(&args.out, &weights)?;
    let minutes = HumanDuration(started.elapsed());
    line(format!("{}: done in {minutes}", shown(args.out.as_os_str())))?;
    line(format!("{}: how good it is", shown(report.as_os_str())))?;
    Ok(Exit::Done)
}

impl Asked {
    /// Its file in the work folder.
    const FILE: &str = "teach.json";

    fn of(args: &Args) -> Self {
        Self {
            parts: args.part.iter().map(PartArg::to_string).collect(),
            negatives: args.negative.iter().map(|file| shown(file.as_os_str())).collect(),
            data: args.data.clone(),
            data_share: args.data_share,
            sensor: args.sensor.clone(),
            network: args.network.clone(),
            pictures: args.pictures,
            steps: args.steps,
            test: args.test,
            seed: args.seed,
        }
    }

    /// Keeps it in the work folder.
    fn begin(&self, work: &Path) -> Result<(), Failure> {
        let file = work.join(Self::FILE);
        let text = serde_json::to_vec_pretty(self).map_err(|e| unreadable(&file, &e))?;
        Ok(files::write(&file, &text)?)
    }

    /// Holds it to what was begun in the work folder, if anything was.
    fn as_begun(&self, work: &Path) -> Result<(), Failure> {
        let file = work.join(Self::FILE);
        let begun: serde_json::Value = match files::read(&file, MAX_ASKED) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|e| unreadable(&file, &e))?,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(e) => return Err(unreadable(&file, &e)),
        };
        let now = serde_json::to_value(self).map_err(|e| unreadable(&file, &e))?;
        let differs =
            now.as_object().into_iter().flatten().find(|(key, value)| begun[*key] != **value);
        match differs {
            None => Ok(()),
            Some((key, value)) => Err(Failure::usage(format!(
                "{}: begun with {key} {}, got {value}: give the same, or another --work",
                shown(work.as_os_str()),
                begun[key]
            ))),
        }
    }
}

/// A file of the work folder that is not what it should be.
fn unreadable(file: &Path, why: &dyn std::fmt::Display) -> Failure {
    Failure::new(Exit::Inputs, format!("{}: {why}", shown(file.as_os_str())))
}

const MAX_ASKED: u64 = 1 << 20;

fn read(file: &Path) -> Result<Vec<u8>, Failure> {
    files::read(file, smr_gpu::smr::MAX_FILE).map_err(|e| unreadable(file, &e))
}

/// A path as Python is told it.
fn text(path: &Path) -> Result<String, Failure> {
    path.to_str().map(str::to_owned).ok_or_else(|| {
        let path = shown(path.as_os_str());
        Failure::usage(format!("{path}: expected a name in Unicode, which Python is told"))
    })
}

fn texts(paths: &[PathBuf]) -> Result<Vec<String>, Failure> {
    paths.iter().map(|path| text(path)).collect()
}

/// What is taught, and with what.
struct Teaching<'a> {
    args: &'a Args,
    work: PathBuf,
    own: Own,
    sensor: Option<Arc<Given>>,
    /// None where there are no parts.
    sets: Vec<Set>,
    python: Python,
}

impl Teaching<'_> {
    fn run_folder(&self) -> PathBuf {
        self.work.join("run")
    }

    /// Says what there is to learn from and how long it will take, as far as that is not behind us.
    fn foresee(&self) -> Result<(), Failure> {
        if std::fs::exists(self.run_folder().join("run.json")).unwrap_or(false) {
            return Ok(());
        }
        // What an earlier estimate left may be of other parts; what cannot be removed takes some room and no more.
        let scratch = self.work.join("estimate");
        let _ = std::fs::remove_dir_all(&scratch);
        let estimated = self.estimate(&scratch);
        let _ = std::fs::remove_dir_all(&scratch);
        let (seconds_per_picture, said) = estimated?;
        let last = said.trim().lines().last().unwrap_or("");
        let estimate: Estimate = serde_json::from_str(last).map_err(|e| {
            Failure::new(Exit::Inputs, format!("training: expected an estimate, got {last}: {e}"))
        })?;
        if !self.args.data.is_empty() {
            let snaps = estimate.snaps.iter().map(|(class, n)| format!("{class} {n}"));
            let snaps = snaps.collect::<Vec<_>>().join(", ");
            let (all, none) = (estimate.pictures, estimate.without_snap);
            remark(format!("{}, {none} of them without a snap; {snaps}", count(all, "picture")));
        }
        let simulated: usize = self.sets.iter().map(|set| set.settings.count).sum();
        let look = self.sets.iter().filter(|set| matches!(set.role, Role::Test | Role::Negative));
        let look = look.map(|set| set.settings.count).sum::<usize>() as f64 * LOOK_SECONDS;
        let simulating = seconds_per_picture * simulated as f64;
        let training = estimate.seconds_per_step * f64::from(self.args.steps);
        let duration = |seconds: f64| HumanDuration(Duration::from_secs_f64(seconds.max(0.0)));
        if !self.sets.is_empty() {
            let names = self.own.classes.iter().map(|kind| kind.name().to_owned());
            let names = names.collect::<Vec<_>>().join(", ");
            let pictures = count(self.args.pictures as usize, "simulated picture");
            remark(format!("{pictures} of {names} to learn from"));
            remark(format!("simulating takes about {}", duration(simulating)));
        }
        let Estimate { device, threads, .. } = &estimate;
        let on = format!("{device}, {}", count(*threads, "thread"));
        let steps = count(self.args.steps as usize, "step");
        remark(format!("{steps} of training take about {} ({on})", duration(training)));
        remark(format!("all together about {}", duration(simulating + training + look)));
        Ok(())
    }

    /// Seconds that it takes to simulate a picture, and what training says of a few steps: on the labelled pictures,
    /// or else on some that are simulated for it.
    fn estimate(&self, scratch: &Path) -> Result<(f64, String), Failure> {
        let mut seconds = 0.0;
        let pilot = self.sets.first().map(|first| {
            let (count, out) = (PILOT.min(first.settings.count), scratch.join("pictures"));
            let settings = Settings { count, out, ..first.settings.clone() };
            Set { role: Role::Train, name: first.name.clone(), settings }
        });
        if let Some(pilot) = &pilot {
            let began = Instant::now();
            dataset::simulate(&pilot.settings, &|_| {}).map_err(failure)?;
            seconds = began.elapsed().as_secs_f64() / pilot.settings.count as f64;
        }
        let sets = pilot.as_slice();
        let sets = if self.args.data.is_empty() { sets } else { &[] };
        let mut arguments = self.fit_arguments(sets, scratch)?;
        arguments.push("--estimate".to_owned());
        Ok((seconds, self.python.run(&arguments, &mut || {})?))
    }

    /// Simulates what is missing of the sets.
    fn simulate(&self) -> Result<(), Failure> {
        let all: usize = self.sets.iter().map(|set| set.settings.count).sum();
        let bar = bar(all as u64, "simulating {bar:40} {pos}/{len} pictures, {eta} left");
        let mut before = 0;
        for set in &self.sets {
            let result = dataset::simulate(&set.settings, &|Progress { step, done, .. }| {
                if step == Step::Render {
                    bar.set_position(bar.position().max((before + done) as u64));
                }
            });
            if let Err(e) = result {
                bar.finish_and_clear();
                return Err(failure(e));
            }
            before += set.settings.count;
        }
        bar.finish_and_clear();
        if !self.sets.is_empty() && python::weights_of(&self.run_folder()).is_none() {
            remark(self.counted()?);
        }
        Ok(())
    }

    /// What there is to learn from of the simulated pictures, in words.
    fn counted(&self) -> Result<String, Failure> {
        let classes: Vec<String> =
            self.own.classes.iter().map(|kind| kind.name().to_owned()).collect();
        let (mut pictures, mut bare, mut snaps) = (0, 0, vec![0; classes.len()]);
        for folder in plan::folders(&self.sets, Role::Train) {
            for labelled in eval::read_labels(&folder, &classes, &mut Outputs::default())? {
                let labels = &labelled.picture.labels;
                pictures += 1;
                bare += usize::from(labels.is_empty());
                labels.iter().for_each(|label| snaps[label.category] += 1);
            }
        }
        let of_class = classes.iter().zip(&snaps).map(|(class, n)| format!("{class} {n}"));
        let of_class = of_class.collect::<Vec<_>>().join(", ");
        let (pictures, all) = (count(pictures, "simulated picture"), snaps.iter().sum());
        let all = count(all, "snap");
        Ok(format!("{pictures}, {bare} of them without a snap; {all}: {of_class}"))
    }

    /// The network to begin with, as a file.
    fn begin_with(&self) -> Result<PathBuf, Failure> {
        let found = Catalog::from_env().find(&self.args.network)?;
        if let Some(file) = found.file() {
            return Ok(file.to_owned());
        }
        let bytes = found.bytes()?;
        let file = self.work.join("begin.safetensors");
        files::write(&file, bytes.as_ref().as_ref())?;
        Ok(file)
    }

    /// The arguments of `fit` on these sets and the labelled pictures, into a folder.
    fn fit_arguments(&self, sets: &[Set], out: &Path) -> Result<Vec<String>, Failure> {
        let simulated = texts(&plan::folders(sets, Role::Train))?;
        let calibration: Vec<PathBuf> = plan::folders(sets, Role::Calibrate);
        let own = texts(&self.args.data)?;
        let mut arguments = vec!["fit".to_owned(), "--data".to_owned()];
        match (own.is_empty(), simulated.is_empty()) {
            (true, _) => arguments.extend(simulated),
            (false, true) => arguments.extend(own),
            (false, false) => {
                arguments.extend(own);
                arguments.push("--mix".to_owned());
                arguments.extend(simulated);
                let share = (1.0 - self.args.data_share).to_string();
                arguments.extend(["--mix-share".to_owned(), share]);
            }
        }
        if !self.args.data.is_empty() {
            arguments.extend(["--split", HELD_OUT].map(str::to_owned));
        }
        if !calibration.is_empty() {
            arguments.push("--val".to_owned());
            arguments.extend(texts(&calibration)?);
        }
        if let Some(sensor) = &self.args.sensor {
            arguments.extend(["--sensor".to_owned(), sensor.clone()]);
        }
        let (begin, out) = (text(&self.begin_with()?)?, text(out)?);
        let (steps, seed) = (self.args.steps.to_string(), self.args.seed.to_string());
        let more = [
            ["--init", &begin],
            ["--steps", &steps],
            ["--seed", &seed],
            ["--lr", RATE],
            ["--val-minutes", LOOK_MINUTES],
            ["--out", &out],
        ];
        arguments.extend(more.into_iter().flatten().map(str::to_owned));
        Ok(arguments)
    }

    /// Trains, or goes on; returns the weights.
    fn train(&self) -> Result<PathBuf, Failure> {
        let run = self.run_folder();
        if let Some(weights) = python::weights_of(&run) {
            return Ok(weights);
        }
        let arguments = match std::fs::exists(run.join("run.json")) {
            Ok(true) => {
                let out = text(&run)?;
                ["fit", "--resume", "--out", &out].map(str::to_owned).to_vec()
            }
            _ => self.fit_arguments(&self.sets, &run)?,
        };
        let bar = bar(self.args.steps.into(), "training {bar:40} {pos}/{len} steps{msg}");
        let mut read = 0;
        let look = &mut || {
            bar.tick();
            // It grows every twenty steps.
            let length = python::history_length(&run);
            if length == read {
                return;
            }
            read = length;
            let lines = python::history(&run);
            if let Some((last, loss)) = lines.iter().rev().find_map(|line| Some((line, line.loss?)))
            {
                let left = last.seconds_left.unwrap_or(0.0).max(0.0);
                let left = HumanDuration(Duration::from_secs_f64(left));
                bar.set_position(last.step.into());
                bar.set_message(format!(", {left} left, loss {loss:.3}"));
            }
        };
        let result = self.python.run(&arguments, look);
        bar.finish_and_clear();
        result?;
        python::weights_of(&run).ok_or_else(|| {
            Failure::new(Exit::Inputs, format!("{}: no weights came of it", shown(run.as_os_str())))
        })
    }

    /// Fits scores and stated deviations; returns the weights.
    fn calibrate(&self, trained: &Path) -> Result<PathBuf, Failure> {
        let out = self.work.join("weights.safetensors");
        let (weights, file) = (text(trained)?, text(&out)?);
        let mut arguments: Vec<String> =
            ["calibrate", "--weights", &weights, "--out", &file, "--data"]
                .map(str::to_owned)
                .to_vec();
        let calibration = plan::folders(&self.sets, Role::Calibrate);
        match calibration.is_empty() {
            false => arguments.extend(texts(&calibration)?),
            true => {
                arguments.extend(texts(&self.args.data)?);
                let split = text(&self.run_folder().join("split.json"))?;
                arguments.extend(["--split".to_owned(), split]);
            }
        }
        if let Some(sensor) = &self.args.sensor {
            arguments.extend(["--sensor".to_owned(), sensor.clone()]);
        }
        let bar = bar(0, "fitting scores and deviations {spinner}");
        let result = self.python.run(&arguments, &mut || bar.tick());
        bar.finish_and_clear();
        result?;
        Ok(out)
    }

    /// Looks at pictures that were not learnt from, and writes the report.
    fn judge(&self, weights: &Path) -> Result<PathBuf, Failure> {
        let judged = judge::judge(self, weights)?;
        report::write(self, weights, &judged)
    }
}
