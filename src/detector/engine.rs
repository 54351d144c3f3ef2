//! The network for one size of input, and what runs it.

use crate::detector::Config;
use crate::detector::runner::{Given, On, Runner};
use crate::engine::gpu::{Deadline, Gpu, Inputs};
use crate::engine::graph::{StageTime, TensorId};
use crate::engine::lower::Choice;
use crate::error::Result;
use crate::smr::Network;
use crate::verify::comparison::{How, Values};
use crate::verify::tune::{Place, Tuned};

/// A network and what runs it.
pub(super) struct Engine {
    pub network: Network,
    runner: Runner,
    keep: Vec<TensorId>,
}

impl Engine {
    /// Makes a network ready on `gpu`, or on the CPU. The weights that `like` has on the device, an engine of
    /// the same weights, are shared.
    pub async fn new(
        config: &Config,
        mut network: Network,
        on: Option<On<'_>>,
        choice: &Choice,
        like: Option<&Self>,
    ) -> Result<Self> {
        let keep = match config.keep_stages {
            true => network.graph.computed(),
            false => Vec::new(),
        };
        let like = like.map(|engine| &engine.runner);
        let runner = Runner::new(config, &network.graph, &keep, on, choice, like).await?;
        if !matches!(runner, Runner::Reference) && !config.keep_stages {
            network.graph.forget_constants();
        }
        Ok(Self { network, runner, keep })
    }

    /// How the network is run, as far as errors depend on it.
    pub fn how(&self) -> How<'_> {
        self.runner.how()
    }

    /// Whether a GPU runs the network.
    pub fn is_gpu(&self) -> bool {
        matches!(self.runner, Runner::Gpu(_))
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

    /// [`Engine::run`] of as many pictures as it was made for; the times add up to those of all.
    pub async fn run_all(
        &self,
        pictures: &[Given<'_>],
        deadline: Deadline,
    ) -> Result<(Vec<Values>, Vec<StageTime>)> {
        self.runner.run_all(&self.network.graph, &self.keep, pictures, deadline).await
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
