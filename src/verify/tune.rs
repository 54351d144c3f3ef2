//! Which kernels are fastest here: measured once, kept in a file, and taken from there.
//!
//! The network runs a few times with each kernel wherever it fits, and each operation keeps the one
//! with which it and the conversions before it took least.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::engine::gpu::{Gpu, Profile, Program, ProgramOptions, Slot};
use crate::engine::graph::{Graph, TensorId};
use crate::engine::kernels;
use crate::engine::lower::{Choice, Request, lower, works};
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};
use crate::files;

/// Longest file with a choice: that of the network has some 10 kB.
const MAX_FILE: u64 = 1 << 20;
/// Runs of each kernel, of which the fastest counts.
const RUNS: usize = 3;

/// What a choice was measured on; on another it says nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// The adapter's name.
    pub adapter: String,
    /// Its driver, with the version.
    pub driver: String,
    /// This crate's version.
    pub version: String,
}

impl Place {
    /// Where `gpu` is.
    pub fn of(gpu: &Gpu) -> Self {
        let info = gpu.info();
        Self {
            adapter: info.name.clone(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().into(),
            version: env!("CARGO_PKG_VERSION").into(),
        }
    }

    /// A name for its file: letters, digits and `-`.
    pub fn file_name(&self) -> String {
        let text = format!("{} {} {}", self.adapter, self.driver, self.version).to_lowercase();
        let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
        format!("{}.json", words.collect::<Vec<_>>().join("-"))
    }
}

/// A choice and where it was measured, as a file holds them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tuned {
    /// Where.
    pub place: Place,
    /// What was fastest.
    pub choice: Choice,
}

impl Tuned {
    /// Reads the choice for `gpu`.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is damaged, measured elsewhere, or names kernels that there are not.
    pub fn read(path: &Path, gpu: &Gpu) -> Result<Self> {
        let fail = |message: String| Error::File { file: path.to_owned(), message };
        let bytes = files::read(path, MAX_FILE).map_err(|e| fail(e.to_string()))?;
        let tuned = Self::parse(&bytes).map_err(fail)?;
        if let Some((key, kernel)) = tuned.choice.unknown() {
            let got = format!("the unknown kernel `{kernel}` for `{key}`");
            return Err(fail(format!("expected a choice of kernels, got {got}")));
        }
        let Place { adapter, driver, version } = &tuned.place;
        match tuned.place == Place::of(gpu) {
            true => Ok(tuned),
            false => Err(fail(format!(
                "expected a choice of kernels, got one of {adapter} ({driver}) in version {version}"
            ))),
        }
    }

    /// Reads the bytes of a choice's file, wherever it was measured.
    ///
    /// # Errors
    /// In words.
    pub fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let text = files::text(bytes).map_err(|e| e.to_string())?;
        serde_json::from_str(text)
            .map_err(|e| format!("expected a choice of kernels, got an error: {e}"))
    }

    /// With what `earlier` says of shapes that this does not name: those of another network, or of another
    /// size of its input.
    pub fn beside(mut self, earlier: Self) -> Self {
        let own = std::mem::replace(&mut self.choice.by_shape, earlier.choice.by_shape);
        self.choice.by_shape.extend(own);
        self
    }

    /// The file's text.
    pub fn to_json(&self) -> String {
        // A map of texts always is.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }
}

/// Measures which kernels are fastest for `graph` on `gpu`, stored in `precision`, for at most about `limit`.
/// `progress` hears of each kernel's turn: how many there were, and are.
///
/// # Errors
/// [`Error::Device`] for an adapter without timestamps; what the device returns.
pub fn tune(
    gpu: &Arc<Gpu>,
    graph: &Graph,
    inputs: &[(TensorId, &Value)],
    precision: Precision,
    limit: Duration,
    mut progress: impl FnMut(usize, usize),
) -> Result<Tuned> {
    let start = Instant::now();
    // By operation and shapes: the kernels that fit, the preferred first.
    let mut candidates: BTreeMap<String, Vec<&'static str>> = BTreeMap::new();
    works(graph, (1, precision, gpu.caps()), |work| {
        let fitting = kernels::of(work.op)?.iter().filter(|k| k.fits(work)).map(|k| k.id());
        candidates.insert(Choice::key(work), fitting.collect());
        Ok(())
    })?;
    let turns = candidates.values().map(Vec::len).max().unwrap_or(0);
    let mut best: BTreeMap<String, (Duration, &'static str)> = BTreeMap::new();
    for turn in 0..turns {
        if turn > 0 && start.elapsed() > limit {
            break;
        }
        let of_turn = |ids: &Vec<&'static str>| (*ids.get(turn).unwrap_or(&ids[0])).to_owned();
        let by_shape = candidates.iter().map(|(key, ids)| (key.clone(), of_turn(ids)));
        let choice = Choice { by_shape: by_shape.collect(), ..Choice::default() };
        for (key, (time, kernel)) in times(gpu, graph, inputs, (&choice, precision))? {
            let entry = best.entry(key).or_insert((time, kernel));
            if time < entry.0 {
                *entry = (time, kernel);
            }
        }
        progress(turn + 1, turns);
    }
    // What has one kernel needs no choice.
    let chosen =
        best.into_iter().filter(|(key, _)| candidates.get(key).is_some_and(|c| c.len() > 1));
    let by_shape = chosen.map(|(key, (_, kernel))| (key, kernel.to_owned())).collect();
    let choice = Choice { by_shape, ..Choice::default() };
    Ok(Tuned { place: Place::of(gpu), choice })
}

/// For each operation and shape, the mean time of its commands and of the conversions before them.
fn times(
    gpu: &Arc<Gpu>,
    graph: &Graph,
    inputs: &[(TensorId, &Value)],
    (choice, precision): (&Choice, Precision),
) -> Result<BTreeMap<String, (Duration, &'static str)>> {
    let request = Request { keep: &[], batch: 1, precision, caps: gpu.caps(), choice };
    let lowered = lower(graph, &request)?;
    let options = ProgramOptions { profile: Profile::Commands, ..ProgramOptions::default() };
    let mut slot = pollster::block_on(async {
        let program = Program::new(gpu, &lowered, None, options).await?;
        Slot::new(&Arc::new(program)).await
    })?;
    let mut fastest: Vec<Duration> = vec![Duration::MAX; lowered.owners.len()];
    for _ in 0..RUNS {
        let times = slot.run(inputs)?.stages;
        if times.len() != fastest.len() {
            let message = "it has no timestamps, by which kernels are timed".into();
            return Err(Error::Device { adapter: gpu.info().name.clone(), message });
        }
        fastest.iter_mut().zip(times).for_each(|(best, t)| *best = (*best).min(t.time));
    }
    let mut by_node: BTreeMap<usize, Duration> = BTreeMap::new();
    for (owner, time) in lowered.owners.iter().zip(fastest) {
        *by_node.entry(*owner).or_default() += time;
    }
    let mut sums: BTreeMap<String, (Duration, u32, &'static str)> = BTreeMap::new();
    works(graph, (1, precision, gpu.caps()), |work| {
        let kernel = choice.kernel(work)?.id();
        let time = by_node.get(&work.node).copied().unwrap_or_default();
        let sum = sums.entry(Choice::key(work)).or_insert((Duration::ZERO, 0, kernel));
        *sum = (sum.0 + time, sum.1 + 1, kernel);
        Ok(())
    })?;
    let mean =
        |(key, (time, count, kernel)): (_, (Duration, u32, _))| (key, (time / count, kernel));
    Ok(sums.into_iter().map(mean).collect())
}
