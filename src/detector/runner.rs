//! What runs a graph for a detector: a GPU's slots, the CPU, or the reference.

use std::sync::Arc;
#[cfg(feature = "cpu")]
use std::sync::Mutex;

use crate::comparison::{How, Values};
use crate::detector::pool::{Pool, Slots};
use crate::detector::{Config, Device};
use crate::error::Result;
use crate::gpu::{Deadline, Inputs, Program, ProgramOptions};
use crate::graph::{Graph, StageTime, TensorId};
#[cfg(feature = "cpu")]
use crate::host::HostPlan;
#[cfg(feature = "cpu")]
use crate::lock::lock;
use crate::lower::{Choice, Request, lower};
use crate::precision::Precision;

/// The GPU on which a graph is to run.
#[derive(Clone, Copy)]
pub(super) struct On<'a> {
    pub pool: &'a Arc<Pool>,
    /// How maps and weights are stored.
    pub precision: Precision,
    /// Pictures that run together.
    pub batch: usize,
}

/// A graph made ready on a device.
pub(super) enum Runner {
    Gpu(Slots),
    #[cfg(feature = "cpu")]
    Host(Box<Mutex<HostPlan>>),
    Reference,
}

impl Runner {
    /// Makes `graph` ready on a GPU or on the CPU. What `like` has there of the same weights is shared.
    pub async fn new(
        config: &Config,
        graph: &Graph,
        keep: &[TensorId],
        on: Option<On<'_>>,
        choice: &Choice,
        like: Option<&Self>,
    ) -> Result<Self> {
        Ok(match (on, &config.device) {
            (Some(On { pool, precision, batch }), _) => {
                let (gpu, batch) = (pool.gpu(), batch as u32);
                let request = Request { keep, batch, precision, caps: gpu.caps(), choice };
                let lowered = lower(graph, &request)?;
                let like = match like {
                    Some(Self::Gpu(slots)) => Some(slots.program()),
                    _ => None,
                };
                let program = Program::new(gpu, &lowered, like, ProgramOptions::default()).await?;
                Self::Gpu(Slots::new(Arc::new(program), pool.clone()).await?)
            }
            (None, Device::Reference) => Self::Reference,
            #[cfg(feature = "cpu")]
            (None, _) => {
                let like = match like {
                    Some(Self::Host(plan)) => Some(lock(plan)),
                    _ => None,
                };
                let plan = HostPlan::new(graph, keep, like.as_deref())?;
                Self::Host(Box::new(Mutex::new(plan)))
            }
            #[cfg(not(feature = "cpu"))]
            (None, _) => Self::Reference,
        })
    }

    /// How the graph is run, as far as errors depend on it.
    pub fn how(&self) -> How<'_> {
        match self {
            Self::Gpu(slots) => {
                let program = slots.program();
                let (kernels, precision) = (program.kernels(), program.precision());
                How { kernels, precision, written: Some(program.stored()) }
            }
            _ => How::default(),
        }
    }

    /// Runs the graph that it was made of. The values are its outputs and those in `keep`.
    pub async fn run(
        &self,
        graph: &Graph,
        keep: &[TensorId],
        inputs: &Inputs<'_>,
        deadline: Deadline,
    ) -> Result<(Values, Vec<StageTime>)> {
        let (mut values, times) = self.run_all(graph, keep, &[inputs], deadline).await?;
        Ok((values.pop().unwrap_or_default(), times))
    }

    /// [`Runner::run`] of several pictures, on a GPU as many as it was made for; the times add up to those of
    /// all.
    pub async fn run_all(
        &self,
        graph: &Graph,
        keep: &[TensorId],
        pictures: &[&Inputs<'_>],
        deadline: Deadline,
    ) -> Result<(Vec<Values>, Vec<StageTime>)> {
        match self {
            Self::Reference => one_by_one(pictures, |inputs| graph.reference(inputs, keep)),
            #[cfg(feature = "cpu")]
            Self::Host(plan) => one_by_one(pictures, |inputs| lock(plan).run(graph, inputs)),
            Self::Gpu(slots) => {
                let run = slots.run(pictures, deadline.of_run()).await?;
                Ok((run.values, run.stages))
            }
        }
    }
}

fn one_by_one(
    pictures: &[&Inputs<'_>],
    mut run: impl FnMut(&Inputs<'_>) -> Result<(Values, Vec<StageTime>)>,
) -> Result<(Vec<Values>, Vec<StageTime>)> {
    let (mut all, mut stages) = (Vec::new(), Vec::new());
    for inputs in pictures {
        let (values, times) = run(inputs)?;
        all.push(values);
        stages.extend(times);
    }
    Ok((all, stages))
}
