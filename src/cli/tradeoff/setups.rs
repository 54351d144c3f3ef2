//! Which setups are measured, and their configurations.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use smr_gpu::gpu::Gpu;
use smr_gpu::lower::Choice;
use smr_gpu::tradeoff::{Measured, Setup, Table, digest};
use smr_gpu::tune::Place;
use smr_gpu::{Config, Device, Precision, WeightSource};

use super::super::detector::{open_gpu, weight_file};
use super::super::exit::{Exit, Failure};

/// Families of kernels that are measured beside the default choice.
const FAMILIES: [&[&str]; 3] =
    [&["conv2d/direct", "conv2d/split"], &["conv2d/winograd"], &["conv2d/planar", "linear/planar"]];
/// Pictures at a time, beside one.
const BATCH: usize = 4;

/// What is measured.
pub(super) struct Plan {
    /// What all else is compared with.
    pub base: Setup,
    /// The adapter that `gpu` stands for.
    pub place: Option<Place>,
    /// Digest of each weight file.
    pub weights: Vec<(String, String)>,
    /// Those that differ from the base in one thing, the base first.
    pub single: Vec<Setup>,
}

impl Plan {
    /// From the weights, with their files, the sizes and the adapter, if there is one.
    pub fn new(
        weights: &[(String, PathBuf, String)],
        sizes: &[usize],
        gpu: Option<&(Arc<Gpu>, Device)>,
    ) -> Self {
        let device = if gpu.is_some() { "gpu" } else { "cpu" };
        let base = Setup {
            weights: weights[0].0.clone(),
            size: None,
            device: device.into(),
            kernels: Vec::new(),
            batch: 1,
            precision: Precision::F32,
        };
        let mut single = vec![base.clone()];
        single.extend(
            weights[1..].iter().map(|(w, ..)| Setup { weights: w.clone(), ..base.clone() }),
        );
        single.extend(sizes.iter().map(|size| Setup { size: Some(*size), ..base.clone() }));
        single.push(Setup { batch: BATCH, ..base.clone() });
        if gpu.is_some() {
            single.push(Setup { device: "cpu".into(), ..base.clone() });
            single.push(Setup { precision: Precision::F16, ..base.clone() });
            single.extend(FAMILIES.map(|family| {
                let kernels = family.iter().map(|id| (*id).to_owned()).collect();
                Setup { kernels, ..base.clone() }
            }));
        }
        let place = gpu.map(|(gpu, _)| Place::of(gpu));
        let weights = weights.iter().map(|(w, _, digest)| (w.clone(), digest.clone())).collect();
        Self { base, place, weights, single }
    }

    /// Combinations of what the front of `rows` has, without those that were measured.
    pub fn combinations(&self, rows: Vec<Measured>) -> Vec<Setup> {
        let measured: BTreeSet<String> = rows.iter().map(|row| row.setup.name()).collect();
        let table = self.table(rows, 0, false);
        let front: Vec<&Setup> = table.front().into_iter().map(|row| &row.setup).collect();
        let mut found: Vec<Setup> = Vec::new();
        for a in &front {
            for b in &front {
                for c in &front {
                    let setup = Setup {
                        weights: a.weights.clone(),
                        size: b.size,
                        device: c.device.clone(),
                        kernels: if c.device == "gpu" { c.kernels.clone() } else { Vec::new() },
                        batch: c.batch,
                        precision: c.precision,
                    };
                    if !measured.contains(&setup.name()) && !found.contains(&setup) {
                        found.push(setup);
                    }
                }
            }
        }
        found
    }

    /// A table of `rows`.
    pub fn table(&self, rows: Vec<Measured>, pictures: usize, stopped: bool) -> Table {
        let (place, weights) = (self.place.clone(), self.weights.clone());
        Table { place, weights, pictures, stopped, base: self.base.clone(), rows }
    }
}

/// Names, files and digests of the weights; without names, of those that there are.
///
/// # Errors
/// [`Exit::Weights`].
pub(super) fn weights(names: &[String]) -> Result<Vec<(String, PathBuf, String)>, Failure> {
    let of = |name: &str| {
        let file = weight_file(Some(Path::new(name)))?;
        let digest = digest_of_file(&file)?;
        Ok((name.to_owned(), file, digest))
    };
    match names {
        [] => {
            let mut found = vec![of("large")?];
            found.extend(of("small").ok());
            Ok(found)
        }
        names => names.iter().map(|name| of(name)).collect(),
    }
}

fn digest_of_file(file: &Path) -> Result<String, Failure> {
    let bytes = smr_gpu::files::read(file, smr_gpu::model::MAX_FILE)
        .map_err(|e| Failure::new(Exit::Weights, format!("weights {}: {e}", file.display())))?;
    Ok(digest(&bytes))
}

/// The digest of the weights of a configuration.
///
/// # Errors
/// [`Exit::Weights`].
pub(super) fn digest_of(config: &Config) -> Result<String, Failure> {
    match &config.weights {
        WeightSource::File(file) => digest_of_file(file),
        WeightSource::Bytes(_, bytes) => Ok(digest(bytes)),
    }
}

/// `config` with what a setup says, and the adapter that it runs on.
///
/// # Errors
/// What opening the adapter and looking for the weights return.
pub(in crate::cli) fn configured(
    setup: &Setup,
    mut config: Config,
) -> Result<(Config, Option<Place>), Failure> {
    config.weights = WeightSource::File(weight_file(Some(Path::new(&setup.weights)))?);
    config.input_size = setup.size;
    config.precision = setup.precision;
    config.device = setup.device.parse::<Device>()?;
    config.choice = Choice { forced: setup.kernels.clone(), ..Choice::default() };
    config.in_flight = config.in_flight.max(setup.batch.min(4));
    let gpu = open_gpu(&config.device)?;
    Ok((config, gpu.map(|gpu| Place::of(&gpu))))
}
