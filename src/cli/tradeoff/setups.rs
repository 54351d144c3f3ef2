//! Which setups are measured, and their configurations.

use std::path::Path;
use std::sync::Arc;

use smr_gpu::engine::cpu::multiplies;
use smr_gpu::engine::gpu::Gpu;
use smr_gpu::engine::lower::KernelChoice;
use smr_gpu::engine::tuned::Place;
use smr_gpu::evaluation::tradeoff::{Measured, Setup, Table, digest};
use smr_gpu::smr::Catalog;
use smr_gpu::{Config, Device, Precision, Saving, Savings, WeightSource};

use super::super::detector::open_gpu;
use super::super::exit::Failure;

/// Families of kernels that are measured beside the default kernels.
const FAMILIES: [&[&str]; 3] =
    [&["conv2d/direct", "conv2d/split"], &["conv2d/winograd"], &["conv2d/planar", "linear/planar"]];
/// What is left out, beside nothing: the default, the deepest scale besides, and all.
const SAVINGS: [&[Saving]; 3] = [
    &[Saving::Contact, Saving::Regions],
    &[Saving::Contact, Saving::Regions, Saving::Scales],
    &Saving::ALL,
];
/// Pictures at a time, beside one.
pub(super) const BATCH: usize = 4;
/// Combinations that are measured at most.
const MOST_COMBINED: usize = 16;
/// What cores multiply beside f32.
const NARROW: [Precision; 2] = [Precision::Bf16, Precision::Int8];
/// This machine's cores, as `--device` takes them.
const CPU: &str = "cpu";

/// What is measured.
pub(super) struct Plan {
    /// What all else is compared with.
    pub base: Setup,
    /// The adapter that `gpu` stands for.
    pub place: Option<Place>,
    /// Digest of each weight file.
    pub weights: Vec<(String, String)>,
    /// Those that differ from the base in one thing, or a network in what it leaves out, the base first; and with an
    /// adapter the networks on the CPU.
    pub single: Vec<Setup>,
}

impl Plan {
    /// From the weights, with where they are, the sizes, the adapter, if there is one, and the number of pictures.
    pub fn new(
        weights: &[(String, WeightSource, String)],
        sizes: &[usize],
        gpu: Option<&(Arc<Gpu>, Device)>,
        pictures: usize,
    ) -> Self {
        // `detect --tradeoff` opens the adapter under the same name.
        let device = match gpu {
            Some((_, Device::Auto)) => "gpu".into(),
            Some((_, device)) => device.to_string(),
            None => CPU.into(),
        };
        let base = Setup {
            weights: weights[0].0.clone(),
            size: None,
            device,
            kernels: Vec::new(),
            batch: 1,
            precision: Precision::F32,
            leave_out: Vec::new(),
        };
        let mut single = vec![base.clone()];
        single.extend(
            weights[1..].iter().map(|(w, ..)| Setup { weights: w.clone(), ..base.clone() }),
        );
        single.extend(sizes.iter().map(|size| Setup { size: Some(*size), ..base.clone() }));
        for savings in SAVINGS {
            let networks = weights.iter().map(|(w, ..)| w.clone());
            single.extend(networks.map(|weights| Setup {
                weights,
                leave_out: savings.to_vec(),
                ..base.clone()
            }));
        }
        let networks = single.clone();
        if pictures >= BATCH {
            single.push(Setup { batch: BATCH, ..base.clone() });
        }
        if gpu.is_some() {
            single.push(Setup { precision: Precision::F16, ..base.clone() });
            single.extend(FAMILIES.map(|family| {
                let kernels = family.iter().map(|id| (*id).to_owned()).collect();
                Setup { kernels, ..base.clone() }
            }));
            // Who has no adapter wants to know what each network costs without.
            let all = networks.iter().cloned();
            single.extend(all.map(|s| Setup { device: CPU.into(), ..s }));
        }
        for precision in NARROW.into_iter().filter(|precision| multiplies(*precision)) {
            let on_cores = networks.iter().filter(|s| s.size.is_none() && s.leave_out.is_empty());
            let setup = |s: &Setup| Setup { device: CPU.into(), precision, ..s.clone() };
            single.extend(on_cores.map(setup));
        }
        let place = gpu.map(|(gpu, _)| Place::of(gpu));
        let weights = weights.iter().map(|(w, _, digest)| (w.clone(), digest.clone())).collect();
        Self { base, place, weights, single }
    }

    /// Combinations of what the front of a table has, without what was measured: first with what is
    /// fastest. Where the front has few, also the other networks at the other sizes. All of one picture at
    /// a time, as [`Table::choose`] takes them.
    pub fn combinations(&self, table: &Table) -> Vec<Setup> {
        let mut alone = table.clone();
        alone.rows.retain(|row| row.setup.batch <= 1);
        let front: Vec<&Setup> = alone.front().into_iter().map(|row| &row.setup).collect();
        let mut found: Vec<Setup> = Vec::new();
        let mut add = |setup: Setup| {
            let is_new = !self.single.contains(&setup) && !found.contains(&setup);
            if is_new && found.len() < MOST_COMBINED {
                found.push(setup);
            }
        };
        for a in &front {
            for b in &front {
                for c in &front {
                    let gpu = c.device != CPU;
                    let kernels = if gpu { c.kernels.clone() } else { Vec::new() };
                    let precision = match (gpu, c.precision) {
                        (true, precision) if NARROW.contains(&precision) => Precision::F32,
                        (false, Precision::F16) => Precision::F32,
                        (_, precision) => precision,
                    };
                    let (weights, device) = (a.weights.clone(), c.device.clone());
                    add(Setup {
                        weights,
                        size: b.size,
                        device,
                        kernels,
                        batch: c.batch,
                        precision,
                        leave_out: b.leave_out.clone(),
                    });
                }
            }
        }
        for weights in self.single.iter().map(|s| &s.weights) {
            for s in self.single.iter().filter(|s| s.kernels.is_empty() && s.batch == 1) {
                add(Setup { weights: weights.clone(), ..s.clone() });
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

/// Names, places and digests of the weights; without names, of those of `large` and `small` that there are.
///
/// # Errors
/// [`Exit::Weights`](super::super::exit::Exit::Weights).
pub(super) fn weights(names: &[String]) -> Result<Vec<(String, WeightSource, String)>, Failure> {
    let of = |name: &str| {
        let found = named(name)?;
        let digest = digest_of(&found)?;
        Ok((name.to_owned(), found, digest))
    };
    if !names.is_empty() {
        return names.iter().map(|name| of(name)).collect();
    }
    match (of("large"), of("small")) {
        (Ok(large), small) => Ok([large].into_iter().chain(small.ok()).collect()),
        (Err(missing), Ok(small)) => {
            missing.told();
            Ok(vec![small])
        }
        (Err(missing), Err(_)) => Err(missing),
    }
}

/// The digest of weights.
///
/// # Errors
/// [`Exit::Weights`](super::super::exit::Exit::Weights).
pub(super) fn digest_of(weights: &WeightSource) -> Result<String, Failure> {
    Ok(digest((*weights.bytes()?).as_ref()))
}

/// The weights of a setup.
///
/// # Errors
/// [`Exit::Weights`](super::super::exit::Exit::Weights) if there are none.
pub(super) fn weights_of(setup: &Setup) -> Result<WeightSource, Failure> {
    named(&setup.weights)
}

fn named(weights: &str) -> Result<WeightSource, Failure> {
    Ok(Catalog::from_env().find(Path::new(weights))?)
}

/// `config` with what a setup says besides its weights, and the adapter that it runs on.
///
/// # Errors
/// What opening the adapter returns.
pub(in crate::cli) fn configured(
    setup: &Setup,
    mut config: Config,
) -> Result<(Config, Option<Place>), Failure> {
    config.input_size = setup.size;
    config.precision = setup.precision;
    config.device = setup.device.parse::<Device>()?;
    config.kernels = KernelChoice { forced: setup.kernels.clone(), ..KernelChoice::default() };
    config.batch = setup.batch;
    config.savings = Savings::of(&setup.leave_out);
    let gpu = open_gpu(&config.device)?;
    Ok((config, gpu.map(|gpu| Place::of(&gpu))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(setup: &Setup, ms: f64, mm: f64) -> Measured {
        let spread =
            |v| smr_gpu::evaluation::tradeoff::Spread { median: v, percentile_95: v, worst: v };
        Measured {
            setup: setup.clone(),
            wall_ms: spread(ms),
            device_ms: None,
            peak_bytes: None,
            stages: vec![],
            shift: smr_gpu::evaluation::tradeoff::Shift {
                mm: Some(spread(mm)),
                ..Default::default()
            },
            quality: None,
        }
    }

    /// Two networks, six sizes and three ways to leave out on the CPU alone are fourteen setups and a batch.
    #[test]
    fn enough_is_measured_and_nothing_twice() {
        let weights = ["large", "small"]
            .map(|w| (w.to_owned(), WeightSource::File("gone".into()), String::new()));
        let sizes = [160, 192, 224, 256, 288, 384];
        // Both networks besides in each precision that these cores have.
        let narrow = 2 * NARROW.into_iter().filter(|precision| multiplies(*precision)).count();
        // Three pictures are no four at a time.
        assert_eq!(Plan::new(&weights, &sizes, None, 3).single.len(), 14 + narrow);
        let plan = Plan::new(&weights, &sizes, None, 4);
        assert_eq!(plan.single.len(), 15 + narrow);
        assert!(plan.single.iter().all(|s| s.device == "cpu" && s.kernels.is_empty()));
        let time = |s: &Setup| match s.weights == "small" {
            true => 1.0,
            false => s.size.unwrap_or(320) as f64 / s.batch as f64,
        };
        let rows = |error: &dyn Fn(&Setup) -> f64| {
            plan.single.iter().map(|s| row(s, time(s), error(s))).collect::<Vec<_>>()
        };
        // All on the front, or one alone.
        for rows in [rows(&|s| 1e3 / time(s)), rows(&|s| time(s))] {
            let found = plan.combinations(&plan.table(rows, 1, false));
            let all: Vec<&Setup> = plan.single.iter().chain(&found).collect();
            let twice = |(i, s): (usize, &&Setup)| all[..i].contains(s);
            assert!(!all.iter().enumerate().any(twice), "{all:?}");
            assert!(found.len() <= MOST_COMBINED && found.iter().any(|s| s.weights == "small"));
            assert!(found.iter().all(|s| s.batch == 1), "{found:?}");
        }
    }
}
