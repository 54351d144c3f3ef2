//! What runs the network for a detector: a GPU's slots, the CPU, or the reference.

use std::sync::Arc;
#[cfg(feature = "cpu")]
use std::sync::{Mutex, PoisonError};

use crate::comparison::Values;
use crate::detector::pool::Pool;
use crate::detector::{Config, Device, WeightSource};
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Deadline, Gpu, GpuOptions, Program, ProgramOptions};
use crate::graph::{StageTime, TensorId};
#[cfg(feature = "cpu")]
use crate::host::HostPlan;
use crate::lower::{Choice, Request, lower};
use crate::model::{Network, Weights};
use crate::tensor::Value;
use crate::tune::{Place, Tuned};

/// A network and what runs it.
pub(super) struct Engine {
    pub network: Network,
    /// What runs it, for people.
    pub adapter: String,
    /// Which kernels run it.
    pub choice: Choice,
    /// What went otherwise than the configuration says, for people.
    pub remarks: Vec<String>,
    runner: Runner,
    keep: Vec<TensorId>,
}

enum Runner {
    Gpu(Pool),
    #[cfg(feature = "cpu")]
    Host(Box<Mutex<HostPlan>>),
    Reference,
}

impl Engine {
    /// Loads the weights and makes the network ready on `gpu`, or on what the configuration names.
    pub async fn new(config: &Config, gpu: Option<Arc<Gpu>>) -> Result<Self> {
        let weights = match &config.weights {
            WeightSource::File(path) => Weights::open(path)?,
            WeightSource::Bytes(name, bytes) => {
                Weights::from_shared(name, Arc::new(bytes.clone()))?
            }
        };
        let weights = match config.input_size {
            Some(size) => weights.with_input_size(size)?,
            None => weights,
        };
        let thresholds = config.thresholds(weights.config())?;
        let mut network = Network::new(weights, thresholds)?;
        let keep = match config.keep_stages {
            true => network.graph.computed(),
            false => Vec::new(),
        };
        let gpu = match gpu {
            Some(gpu) => Some(gpu),
            None => open(config).await?,
        };
        let (mut choice, mut remarks) = (Choice::default(), Vec::new());
        let (runner, adapter) = match (gpu, &config.device) {
            (Some(gpu), _) => {
                let adapter = format!("{} ({})", gpu.info().name, gpu.info().backend);
                choice = choose(config, &gpu, &mut remarks);
                let request = Request { keep: &keep, batch: 1, caps: gpu.caps(), choice: &choice };
                let lowered = lower(&network.graph, &request)?;
                let program = Program::new(&gpu, &lowered, None, ProgramOptions::default()).await?;
                let pool = Pool::new(Arc::new(program), config.in_flight).await?;
                (Runner::Gpu(pool), adapter)
            }
            (None, Device::Reference) => (Runner::Reference, "CPU reference (f64)".to_owned()),
            #[cfg(feature = "cpu")]
            (None, _) => {
                let plan = HostPlan::new(&network.graph, &keep)?;
                (Runner::Host(Box::new(Mutex::new(plan))), "CPU (f32)".to_owned())
            }
            #[cfg(not(feature = "cpu"))]
            (None, _) => {
                let expected = "an adapter or `reference`; the CPU needs the feature `cpu`";
                return Err(Error::param("detect", "device", expected, "`cpu`"));
            }
        };
        if !matches!(runner, Runner::Reference) && !config.keep_stages {
            network.graph.forget_constants();
        }
        Ok(Self { network, adapter, choice, remarks, runner, keep })
    }

    /// The kernel of each operation, in order; none but on a GPU.
    pub fn kernels(&self) -> &[&'static str] {
        match &self.runner {
            Runner::Gpu(pool) => pool.program().kernels(),
            _ => &[],
        }
    }

    /// Whether a GPU runs the network.
    pub fn is_gpu(&self) -> bool {
        matches!(self.runner, Runner::Gpu(_))
    }

    /// Runs the network. The values are the outputs, or with `keep_stages` those of every stage, as
    /// they came.
    pub async fn run(
        &self,
        inputs: &[(TensorId, &Value)],
        deadline: Deadline,
    ) -> Result<(Values, Vec<StageTime>)> {
        match &self.runner {
            Runner::Reference => self.network.graph.reference(inputs, &self.keep),
            #[cfg(feature = "cpu")]
            Runner::Host(plan) => {
                let mut plan = plan.lock().unwrap_or_else(PoisonError::into_inner);
                plan.run(&self.network.graph, inputs)
            }
            Runner::Gpu(pool) => {
                let mut slot = pool.take(deadline).await?;
                slot.submit(&[inputs])?;
                let mut run = slot.receive(deadline).await?;
                Ok((run.first(), run.stages))
            }
        }
    }
}

/// The kernels that the configuration names, or that were measured on `gpu`.
pub(super) fn choose(config: &Config, gpu: &Gpu, remarks: &mut Vec<String>) -> Choice {
    let file = config.choices.as_ref().map(|folder| folder.join(Place::of(gpu).file_name()));
    match file.filter(|file| config.choice == Choice::default() && file.exists()) {
        None => config.choice.clone(),
        Some(file) => match Tuned::read(&file, gpu) {
            Ok(tuned) => tuned.choice,
            Err(e) => {
                remarks.push(format!("{e}; going on without"));
                Choice::default()
            }
        },
    }
}

/// Opens the adapter that the configuration names; `None` for the CPU.
async fn open(config: &Config) -> Result<Option<Arc<Gpu>>> {
    let options = |adapter: AdapterChoice| GpuOptions {
        adapter,
        timeout: config.timeout,
        checked: config.checked,
    };
    match &config.device {
        Device::Cpu | Device::Reference => Ok(None),
        Device::Gpu(choice) => Gpu::open(options(choice.clone())).await.map(Some),
        Device::Auto => match Gpu::open(options(AdapterChoice::Hardware)).await {
            // Without the CPU path a software adapter is better than nothing.
            Err(Error::NoAdapter { .. }) if cfg!(feature = "cpu") => Ok(None),
            Err(Error::NoAdapter { .. }) => Gpu::open(options(AdapterChoice::Auto)).await.map(Some),
            other => other.map(Some),
        },
    }
}
