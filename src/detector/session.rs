//! The weights, a device, and the network compiled on it for each size of input that pictures ask for.

use std::sync::{Arc, Mutex, MutexGuard};

use crate::detector::compiled::{self, Compiled};
use crate::detector::contact_map;
use crate::detector::gate::Gate;
use crate::detector::pool::Pool;
use crate::detector::runner::On;
use crate::detector::{Config, Device, Savings};
use crate::engine::gpu::{AdapterChoice, Gpu, GpuOptions};
use crate::engine::kernels;
use crate::engine::lock::lock;
use crate::engine::lower::KernelChoice;
use crate::engine::precision::Precision;
use crate::error::{Error, Result};
use crate::smr::{ModelConfig, Network, Wanted, Weights};

/// Sizes that are kept ready, parts of pictures among them; of one more, the one that was not used for
/// longest goes.
const MOST: usize = 12;

/// What the network is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Key {
    /// Height and width of its input.
    pub size: [usize; 2],
    /// How it stores maps and weights.
    pub precision: Precision,
    /// Pictures that it takes together; on a CPU one after the other.
    pub batch: usize,
    /// Proposals that reach the last part at most.
    pub proposals: usize,
    /// Whether it has the deepest scale.
    pub deepest: bool,
}

/// Weights, a device, and the network compiled on it for each size.
pub(crate) struct Session {
    config: Config,
    weights: Weights,
    wanted: Wanted,
    /// The memory of what runs on a GPU; `None` for the CPU.
    pool: Option<Arc<Pool>>,
    /// What runs the network, for people.
    pub adapter: String,
    /// Which kernels run it.
    pub kernels: KernelChoice,
    /// What went otherwise than the configuration says, for people.
    pub remarks: Vec<String>,
    ready: Recent<Key, Compiled>,
    /// The graphs of contact maps.
    contacts: Recent<contact_map::Key, contact_map::ContactGraph>,
    /// Held while one is built.
    building: Gate,
}

impl Session {
    /// Loads the weights and opens what the configuration names, or takes `gpu`.
    pub async fn open(config: &Config, gpu: Option<Arc<Gpu>>) -> Result<Self> {
        let weights = Weights::load(&config.weights)?;
        let wanted = config.wanted(weights.config())?;
        let (mut kernels, mut remarks) = (KernelChoice::default(), Vec::new());
        let gpu = match gpu {
            Some(gpu) => Some(gpu),
            None => {
                let gpu = open_device(config).await?;
                let kind = gpu.as_ref().map(|gpu| gpu.caps().kind);
                remarks.extend(makeshift(&config.device, kind).map(str::to_owned));
                gpu
            }
        };
        let adapter = match (&gpu, &config.device) {
            (Some(gpu), _) => {
                kernels = compiled::choose(config, gpu, &mut remarks);
                format!("{} ({})", gpu.info().name, gpu.info().backend)
            }
            (None, Device::Reference) => "CPU reference (f64)".to_owned(),
            (None, _) => format!("CPU ({})", on_cores(config.precision)),
        };
        match (&gpu, config.precision) {
            (None, Precision::F16) => {
                remarks.push(format!("f16 is for GPUs: {adapter} computes as ever"));
            }
            (Some(_), asked @ (Precision::Bf16 | Precision::Int8)) => {
                remarks.push(format!("{asked} is for cores: {adapter} computes in f32"));
            }
            (None, asked @ (Precision::Bf16 | Precision::Int8))
                if config.device == Device::Reference || on_cores(asked) != asked =>
            {
                let wanted = match asked {
                    Precision::Bf16 => "AVX-512 BF16 or NEON BF16",
                    _ => "AVX-512 VNNI, AVX-VNNI or NEON dot products",
                };
                remarks.push(format!(
                    "{asked} is for cores with {wanted}: {adapter} computes as ever"
                ));
            }
            _ => {}
        }
        Ok(Self {
            config: config.clone(),
            weights,
            wanted,
            pool: gpu.map(|gpu| Arc::new(Pool::new(gpu, config.in_flight))),
            adapter,
            kernels,
            remarks,
            ready: Recent::new(),
            contacts: Recent::new(),
            building: Gate::default(),
        })
    }

    /// The configuration that the weights carry.
    pub fn model(&self) -> &ModelConfig {
        self.weights.config()
    }

    /// Refuses weights that make no network.
    ///
    /// # Errors
    /// As [`Network::new`].
    pub fn check(&self) -> Result<()> {
        Network::new(self.weights.clone(), [32; 2], self.wanted).map(|_| ())
    }

    /// How maps and weights are stored, or multiplied: as the configuration says, where what runs the network
    /// does.
    pub fn precision(&self) -> Precision {
        match (self.pool.is_some(), self.config.precision) {
            (true, Precision::F16) => Precision::F16,
            (false, precision) if self.on_cores() => on_cores(precision),
            _ => Precision::F32,
        }
    }

    /// Whether the fast path on cores runs the network.
    pub fn on_cores(&self) -> bool {
        let reference = matches!(self.config.device, Device::Reference);
        cfg!(feature = "cpu") && self.pool.is_none() && !reference
    }

    /// Pictures that may run together.
    pub fn batch(&self) -> usize {
        self.pool.as_ref().map_or(1, |_| self.config.batch.max(1))
    }

    /// The network for one picture at a time with inputs of `size`, height and width, in the precision that is
    /// asked for.
    ///
    /// # Errors
    /// As [`Compiled::new`].
    pub async fn one(&self, size: [usize; 2]) -> Result<Arc<Compiled>> {
        self.compiled(self.whole(size, self.precision())).await
    }

    /// What a whole picture alone needs whose input has `size`, height and width, and of which nothing is left
    /// out.
    pub fn whole(&self, size: [usize; 2], precision: Precision) -> Key {
        let proposals = Savings::NONE.proposals(size, false);
        Key { size, precision, batch: 1, proposals, deepest: true }
    }

    /// A compiled network; built first if no picture asked for it lately.
    ///
    /// # Errors
    /// As [`Compiled::new`].
    pub async fn compiled(&self, key: Key) -> Result<Arc<Compiled>> {
        // What cannot do without it has one for both.
        let deepest = key.deepest || !self.model().variant.leaves_deepest();
        let key = Key { deepest, ..key };
        let build = async || {
            let like = self.ready.best(|other| (other.precision == key.precision, other.deepest));
            let Key { size, precision, batch, proposals, deepest } = key;
            let wanted = Wanted { most_proposals: proposals, deepest, ..self.wanted };
            let network = Network::new(self.weights.clone(), size, wanted)?;
            let on = self.pool.as_ref().map(|pool| On { pool, precision, batch });
            Compiled::new(&self.config, network, on, &self.kernels, like.as_deref()).await
        };
        self.ready.get_or_build(key, &self.building, build).await
    }

    /// The graph of a contact map; built first if no picture asked for it lately.
    ///
    /// # Errors
    /// As [`Compiled::new`].
    pub async fn contact(&self, key: contact_map::Key) -> Result<Arc<contact_map::ContactGraph>> {
        let (config, pool, kernels) = (&self.config, self.pool.as_ref(), &self.kernels);
        let build = || contact_map::ContactGraph::new(config, key, pool, kernels);
        self.contacts.get_or_build(key, &self.building, build).await
    }
}

/// What cores multiply where this precision is asked for.
fn on_cores(asked: Precision) -> Precision {
    #[cfg(feature = "cpu")]
    if crate::engine::cpu::multiplies(asked) {
        return asked;
    }
    let _ = asked;
    Precision::F32
}

/// What was used lately, the last used last.
struct Recent<K, T>(Mutex<Vec<(K, Arc<T>)>>);

impl<K: PartialEq + Copy, T> Recent<K, T> {
    fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// What `key` names; built first, one at a time while `building` is held, if it is not there.
    async fn get_or_build<F: Future<Output = Result<T>>>(
        &self,
        key: K,
        building: &Gate,
        build: impl FnOnce() -> F,
    ) -> Result<Arc<T>> {
        if let Some(found) = self.find(key) {
            return Ok(found);
        }
        let _one = building.pass().await;
        // Another caller may have been faster.
        if let Some(found) = self.find(key) {
            return Ok(found);
        }
        let built = Arc::new(build().await?);
        let mut all = self.all();
        all.push((key, built.clone()));
        if all.len() > MOST {
            all.remove(0);
        }
        Ok(built)
    }

    fn find(&self, key: K) -> Option<Arc<T>> {
        let mut all = self.all();
        let at = all.iter().position(|(of, _)| *of == key)?;
        let found = all.remove(at);
        all.push(found);
        all.last().map(|(_, found)| found.clone())
    }

    /// What is ranked highest, of several the one used last.
    fn best<R: Ord>(&self, rank: impl Fn(&K) -> R) -> Option<Arc<T>> {
        self.all().iter().max_by_key(|(key, _)| rank(key)).map(|(_, best)| best.clone())
    }

    fn all(&self) -> MutexGuard<'_, Vec<(K, Arc<T>)>> {
        lock(&self.0)
    }
}

/// What is to be said where a software adapter was opened that nobody asked for.
fn makeshift(device: &Device, opened: Option<kernels::Kind>) -> Option<&'static str> {
    let software = *device == Device::Auto && opened == Some(kernels::Kind::Software);
    software.then_some(
        "no hardware adapter was found: a software one computes; the feature `cpu` is faster",
    )
}

/// Opens the adapter that the configuration names; `None` for the CPU.
async fn open_device(config: &Config) -> Result<Option<Arc<Gpu>>> {
    let options = |adapter: AdapterChoice| GpuOptions {
        adapter,
        timeout: config.timeout,
        bounds_checks: config.bounds_checks,
        faults: config.faults.clone(),
    };
    match &config.device {
        #[cfg(not(feature = "cpu"))]
        Device::Cpu => {
            let expected = "an adapter or `reference`; the CPU needs the feature `cpu`";
            Err(Error::param("detect", "device", expected, "`cpu`"))
        }
        #[cfg(feature = "cpu")]
        Device::Cpu => Ok(None),
        Device::Reference => Ok(None),
        Device::Gpu(kernels) => Gpu::open(options(kernels.clone())).await.map(Some),
        Device::Auto => match Gpu::open(options(AdapterChoice::Hardware)).await {
            // Without the CPU path a software adapter is better than nothing.
            Err(Error::NoAdapter { .. }) if cfg!(feature = "cpu") => Ok(None),
            Err(Error::NoAdapter { .. }) => Gpu::open(options(AdapterChoice::Auto)).await.map(Some),
            other => other.map(Some),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_software_adapter_that_nobody_asked_for_is_told_of() {
        use kernels::Kind::{Integrated, Software};
        let told = |device: &Device, opened| makeshift(device, opened).is_some();
        assert!(told(&Device::Auto, Some(Software)));
        assert!(!told(&Device::Auto, Some(Integrated)) && !told(&Device::Auto, None));
        assert!(!told(&Device::Gpu(AdapterChoice::Auto), Some(Software)));
    }
}
