//! The network for one size of input, and what runs it.

use crate::detector::Config;
use crate::detector::runner::{Given, On, Runner};
#[cfg(feature = "cpu")]
use crate::engine::cpu::CpuPlan;
use crate::engine::gpu::{Deadline, Gpu, Inputs, Program};
use crate::engine::graph::{StageTime, TensorId, Values};
use crate::engine::lower::KernelChoice;
use crate::engine::tuned::{Place, Tuned};
use crate::error::Result;
use crate::smr::Network;

/// A network and what runs it.
pub(crate) struct Compiled {
    pub network: Network,
    runner: Runner,
    keep: Vec<TensorId>,
}

impl Compiled {
    /// Makes a network ready on `gpu`, or on the CPU. The weights that `like` has on the device, an engine of
    /// the same weights, are shared.
    pub async fn new(
        config: &Config,
        mut network: Network,
        on: Option<On<'_>>,
        kernels: &KernelChoice,
        like: Option<&Self>,
    ) -> Result<Self> {
        let keep = match config.keep_stages {
            true => network.graph.computed(),
            false => Vec::new(),
        };
        let like = like.map(|engine| &engine.runner);
        let runner = Runner::new(config, &network.graph, &keep, on, kernels, like).await?;
        if !matches!(runner, Runner::Reference) && !config.keep_stages {
            network.graph.forget_constants();
        }
        Ok(Self { network, runner, keep })
    }

    /// What runs it on cores; `None` for a GPU and for the reference.
    #[cfg(feature = "cpu")]
    pub fn plan(&self) -> Option<&CpuPlan> {
        self.runner.plan()
    }

    /// What runs it on a GPU; `None` for the CPU.
    pub fn program(&self) -> Option<&Program> {
        self.runner.program()
    }

    /// Runs the network. The values are the outputs, or with `keep_stages` those of every stage, as
    /// they came.
    pub async fn run(
        &self,
        inputs: &Inputs<'_>,
        deadline: Deadline,
    ) -> Result<(Values, Vec<StageTime>)> {
        let given = Given { inputs, picture: None };
        self.runner.run(&self.network.graph, &self.keep, given, deadline).await
    }

    /// [`Compiled::run`] of as many pictures as it was made for; the times add up to those of all.
    pub async fn run_all(
        &self,
        pictures: &[Given<'_>],
        deadline: Deadline,
    ) -> Result<(Vec<Values>, Vec<StageTime>)> {
        self.runner.run_all(&self.network.graph, &self.keep, pictures, deadline).await
    }
}

/// The kernels that the configuration names, or that were measured on `gpu`.
pub(crate) fn choose(config: &Config, gpu: &Gpu, remarks: &mut Vec<String>) -> KernelChoice {
    let file = config.tuned_kernels.as_ref().map(|folder| folder.join(Place::of(gpu).file_name()));
    match file.filter(|file| config.kernels == KernelChoice::default() && file.exists()) {
        None => config.kernels.clone(),
        Some(file) => match Tuned::read(&file, gpu) {
            Ok(tuned) => tuned.kernels,
            Err(e) => {
                remarks.push(format!("{e}; going on without"));
                KernelChoice::default()
            }
        },
    }
}
