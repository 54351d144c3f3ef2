//! What runs the network for a detector: a GPU's slots, the CPU, or the reference.

use std::sync::Arc;
#[cfg(feature = "cpu")]
use std::sync::{Mutex, PoisonError};

use crate::comparison::{How, Values};
use crate::detector::pool::Pool;
use crate::detector::{Config, Device};
use crate::error::Result;
use crate::gpu::{Deadline, Gpu, Program, ProgramOptions};
use crate::graph::{StageTime, TensorId};
#[cfg(feature = "cpu")]
use crate::host::HostPlan;
use crate::lower::{Choice, Request, lower};
use crate::model::Network;
use crate::precision::Precision;
use crate::tensor::Value;
use crate::tune::{Place, Tuned};

/// A network and what runs it.
pub(super) struct Engine {
    pub network: Network,
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
    /// Makes a network ready on `gpu`, where it is stored in a precision, or on the CPU. The weights that
    /// `like` has on the device, an engine of the same weights, are shared.
    pub async fn new(
        config: &Config,
        mut network: Network,
        gpu: Option<(&Arc<Gpu>, Precision)>,
        choice: &Choice,
        like: Option<&Self>,
    ) -> Result<Self> {
        let keep = match config.keep_stages {
            true => network.graph.computed(),
            false => Vec::new(),
        };
        let runner = match (gpu, &config.device) {
            (Some((gpu, precision)), _) => {
                let caps = gpu.caps();
                let request = Request { keep: &keep, batch: 1, precision, caps, choice };
                let lowered = lower(&network.graph, &request)?;
                let like = like.and_then(|engine| match &engine.runner {
                    Runner::Gpu(pool) => Some(pool.program()),
                    _ => None,
                });
                let program = Program::new(gpu, &lowered, like, ProgramOptions::default()).await?;
                Runner::Gpu(Pool::new(Arc::new(program), config.in_flight).await?)
            }
            (None, Device::Reference) => Runner::Reference,
            #[cfg(feature = "cpu")]
            (None, _) => Runner::Host(Box::new(Mutex::new(HostPlan::new(&network.graph, &keep)?))),
            #[cfg(not(feature = "cpu"))]
            (None, _) => Runner::Reference,
        };
        if !matches!(runner, Runner::Reference) && !config.keep_stages {
            network.graph.forget_constants();
        }
        Ok(Self { network, runner, keep })
    }

    /// How the network is run, as far as errors depend on it.
    pub fn how(&self) -> How<'_> {
        match &self.runner {
            Runner::Gpu(pool) => {
                let program = pool.program();
                let (kernels, precision) = (program.kernels(), program.precision());
                How { kernels, precision, written: Some(program.stored()) }
            }
            _ => How::default(),
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
