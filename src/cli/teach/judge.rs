//! What the detector finds in pictures that it did not learn from.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use smr_gpu::evaluation::Seen;
use smr_gpu::files::{self, Outputs};
use smr_gpu::{Config, GpuDetector, Savings, Sensor, WeightSource};

use super::super::detector::{self, Assumed};
use super::super::eval::{self, Labelled, Stated};
use super::super::exit::Failure;
use super::super::folders;
use super::super::output::{bar, folder_name};
use super::super::source::Source;
use super::plan::Role;
use super::{MAX_ASKED, Teaching, unreadable};

/// Score above which a box counts, as `detect` has it.
pub(super) const COUNTS_ABOVE: f32 = 0.5;

/// A set that was looked at.
pub(super) struct Looked {
    pub name: String,
    pub role: Role,
    pub pictures: Vec<Labelled>,
    pub seen: Vec<Seen>,
}

/// What was found.
pub(super) struct Judged {
    pub classes: Vec<String>,
    /// What ran it.
    pub adapter: String,
    pub sets: Vec<Looked>,
}

impl Judged {
    /// The pictures of snaps, with what they show and what was seen in them.
    pub fn shown(&self) -> Vec<(&Labelled, &Seen)> {
        let sets = self.sets.iter().filter(|set| set.role == Role::Test);
        sets.flat_map(|set| set.pictures.iter().zip(&set.seen)).collect()
    }
}

/// Looks at each test set, and at those of --data's pictures that were held out, with nothing left out.
pub(super) fn judge(teaching: &Teaching, weights: &Path) -> Result<Judged, Failure> {
    let open = |sensor: Option<Sensor>| -> Result<GpuDetector, Failure> {
        let mut config = Config::with_weights(WeightSource::File(weights.to_owned()));
        config.sensor = sensor;
        config.score = smr_gpu::evaluation::LEAST_SCORE as f32;
        config.savings = Savings::NONE;
        config.tuned_kernels = folders::tuned();
        detector::open(config)
    };
    let detector = open(None)?;
    let classes = detector.model().classes.clone();
    let mut outputs = Outputs::default();
    let mut sets = Vec::new();
    for set in &teaching.sets {
        if matches!(set.role, Role::Test | Role::Negative) {
            let pictures = eval::read_labels(&set.settings.out, &classes, &mut outputs)?;
            sets.push((set.name.clone(), set.role, pictures));
        }
    }
    let simulated = sets.len();
    let held_out = match teaching.args.data.is_empty() {
        true => HashSet::new(),
        false => held_out(&teaching.run_folder())?,
    };
    for folder in &teaching.args.data {
        let mut pictures = eval::read_labels(folder, &classes, &mut outputs)?;
        pictures.retain(|labelled| match &labelled.source {
            Source::File(path) => path.canonicalize().is_ok_and(|path| held_out.contains(&path)),
            Source::Stdin | Source::Video(_) | Source::Live(_) => false,
        });
        sets.push((folder_name(folder), Role::Test, pictures));
    }
    let all: u64 = sets.iter().map(|(.., pictures)| pictures.len() as u64).sum();
    let progress = bar(all, "testing {bar:40} {pos}/{len} pictures, {eta} left");
    // Its frames alone are the sensor's for sure.
    let own = match sets.len() > simulated {
        true => Some(open(teaching.sensor.as_ref().map(|given| given.sensor().clone()))?),
        false => None,
    };
    let mut judged = Judged { classes, adapter: detector.adapter(), sets: Vec::new() };
    let mut assumed = Assumed::default();
    for (at, (name, role, pictures)) in sets.into_iter().enumerate() {
        let detector = own.as_ref().filter(|_| at >= simulated).unwrap_or(&detector);
        let stated = Stated { scale: true, gel: true };
        let set = eval::detect_all(detector, &name, &pictures, stated, &mut assumed, &progress)?;
        let places: HashSet<usize> = set.places.into_iter().collect();
        let pictures = pictures.into_iter().enumerate();
        let pictures =
            pictures.filter(|(place, _)| places.contains(place)).map(|(_, p)| p).collect();
        judged.sets.push(Looked { name, role, pictures, seen: set.seen });
    }
    progress.finish_and_clear();
    Ok(judged)
}

/// What a run of `fit --split` says of its pictures.
#[derive(Deserialize)]
struct Split {
    held_out: Vec<HeldOut>,
}

#[derive(Deserialize)]
struct HeldOut {
    file: PathBuf,
}

/// The files that a run of `fit --split` did not learn from.
fn held_out(run: &Path) -> Result<HashSet<PathBuf>, Failure> {
    let file = run.join("split.json");
    let bytes = files::read(&file, MAX_ASKED << 8).map_err(|e| unreadable(&file, &e))?;
    let split: Split = serde_json::from_slice(&bytes).map_err(|e| unreadable(&file, &e))?;
    Ok(split.held_out.iter().filter_map(|row| row.file.canonicalize().ok()).collect())
}
