//! What runs a graph for a detector: a GPU's slots, the CPU, or the reference.

use std::sync::Arc;
#[cfg(feature = "cpu")]
use std::sync::{Condvar, Mutex, PoisonError};
#[cfg(feature = "cpu")]
use std::time::Duration;

use crate::detector::pool::{Pool, Slots};
use crate::detector::{Config, Device};
#[cfg(feature = "cpu")]
use crate::engine::cpu::{self, CpuPlan};
use crate::engine::gpu::{Deadline, Inputs, Profile, Program, ProgramOptions};
use crate::engine::graph::{Graph, StageTime, TensorId, Values};
#[cfg(feature = "cpu")]
use crate::engine::lock::lock;
use crate::engine::lower::{KernelChoice, Request, lower};
use crate::engine::precision::Precision;
use crate::error::Result;

/// The GPU on which a graph is to run.
#[derive(Clone, Copy)]
pub(crate) struct On<'a> {
    pub pool: &'a Arc<Pool>,
    /// How maps and weights are stored.
    pub precision: Precision,
    /// Pictures that run together.
    pub batch: usize,
}

/// What a run is given.
#[derive(Clone, Copy)]
pub(crate) struct Given<'a> {
    pub inputs: &'a Inputs<'a>,
    /// The bytes of a frame that is not copied, in place of the picture's tensor: for the CPU alone.
    #[cfg_attr(not(feature = "cpu"), expect(dead_code))]
    pub picture: Option<(TensorId, &'a [u8])>,
}

/// A graph made ready on a device.
pub(crate) enum Runner {
    Gpu(Slots),
    #[cfg(feature = "cpu")]
    Cpu(Box<CpuPlan>, Turns),
    Reference,
}

/// How many may compute at once, each with buffers of its own. Where callers have a core each, each
/// computes alone, which takes longer and wastes nothing; else they take turns in using all cores.
#[cfg(feature = "cpu")]
pub(crate) struct Turns {
    left: Mutex<usize>,
    back: Condvar,
}

/// A caller's turn, until it is dropped.
#[cfg(feature = "cpu")]
struct Turn<'a>(&'a Turns);

#[cfg(feature = "cpu")]
impl Turns {
    fn new(most: usize) -> Self {
        Self { left: Mutex::new(most.max(1)), back: Condvar::new() }
    }

    /// # Errors
    /// [`crate::error::Error::Timeout`] past the deadline.
    fn take(&self, deadline: Deadline) -> Result<Turn<'_>> {
        /// Between two checks of the clock.
        const PAUSE: Duration = Duration::from_millis(10);
        let mut left = lock(&self.left);
        while *left == 0 {
            if deadline.is_over() {
                return Err(deadline.error("earlier pictures"));
            }
            left = self.back.wait_timeout(left, PAUSE).unwrap_or_else(PoisonError::into_inner).0;
        }
        *left -= 1;
        Ok(Turn(self))
    }
}

#[cfg(feature = "cpu")]
impl Drop for Turn<'_> {
    fn drop(&mut self) {
        *lock(&self.0.left) += 1;
        self.0.back.notify_one();
    }
}

impl Runner {
    /// Makes `graph` ready on a GPU or on the CPU. What `like` has there of the same weights is shared.
    pub async fn new(
        config: &Config,
        graph: &Graph,
        keep: &[TensorId],
        on: Option<On<'_>>,
        kernels: &KernelChoice,
        like: Option<&Self>,
    ) -> Result<Self> {
        Ok(match (on, &config.device) {
            (Some(On { pool, precision, batch }), _) => {
                let (gpu, batch) = (pool.gpu(), batch as u32);
                let request = Request { keep, batch, precision, caps: gpu.caps(), kernels };
                let lowered = lower(graph, &request)?;
                let like = match like {
                    Some(Self::Gpu(slots)) => Some(slots.program()),
                    _ => None,
                };
                let profile = if config.stage_times { Profile::Stages } else { Profile::Off };
                let options = ProgramOptions { profile, ..ProgramOptions::default() };
                let program = Program::new(gpu, &lowered, like, options).await?;
                Self::Gpu(Slots::new(Arc::new(program), pool.clone()).await?)
            }
            (None, Device::Reference) => Self::Reference,
            #[cfg(feature = "cpu")]
            (None, _) => {
                let like = match like {
                    Some(Self::Cpu(plan, _)) => Some(&**plan),
                    _ => None,
                };
                let plan = CpuPlan::new(graph, keep, like, config.precision)?;
                Self::Cpu(Box::new(plan), Turns::new(config.in_flight))
            }
            #[cfg(not(feature = "cpu"))]
            (None, _) => Self::Reference,
        })
    }

    /// What runs the graph on cores; `None` for a GPU and for the reference.
    #[cfg(feature = "cpu")]
    pub fn plan(&self) -> Option<&CpuPlan> {
        match self {
            Self::Cpu(plan, _) => Some(plan),
            _ => None,
        }
    }

    /// What runs the graph on a GPU; `None` for the CPU.
    pub fn program(&self) -> Option<&Program> {
        match self {
            Self::Gpu(slots) => Some(slots.program()),
            _ => None,
        }
    }

    /// Runs the graph that it was made of. The values are its outputs and those in `keep`.
    pub async fn run(
        &self,
        graph: &Graph,
        keep: &[TensorId],
        given: Given<'_>,
        deadline: Deadline,
    ) -> Result<(Values, Vec<StageTime>)> {
        let (mut values, times) = self.run_all(graph, keep, &[given], deadline).await?;
        Ok((values.pop().unwrap_or_default(), times))
    }

    /// [`Runner::run`] of several pictures, on a GPU as many as it was made for; the times add up to those of
    /// all.
    pub async fn run_all(
        &self,
        graph: &Graph,
        keep: &[TensorId],
        pictures: &[Given<'_>],
        deadline: Deadline,
    ) -> Result<(Vec<Values>, Vec<StageTime>)> {
        match self {
            Self::Reference => one_by_one(pictures, |given| graph.reference(given.inputs, keep)),
            #[cfg(feature = "cpu")]
            Self::Cpu(plan, turns) => one_by_one(pictures, |given| {
                let deadline = deadline.of_run();
                let _turn = turns.take(deadline)?;
                let given = cpu::Given { tensors: given.inputs, picture: given.picture };
                plan.run_while(graph, given, &|stage| match deadline.is_over() {
                    true => Err(deadline.error(&format!("the network, at stage `{stage}`"))),
                    false => Ok(()),
                })
            }),
            Self::Gpu(slots) => {
                let pictures: Vec<_> = pictures.iter().map(|given| given.inputs).collect();
                let run = slots.run(&pictures, deadline.of_run()).await?;
                Ok((run.values, run.stages))
            }
        }
    }
}

fn one_by_one(
    pictures: &[Given<'_>],
    mut run: impl FnMut(&Given<'_>) -> Result<(Values, Vec<StageTime>)>,
) -> Result<(Vec<Values>, Vec<StageTime>)> {
    let (mut all, mut stages) = (Vec::new(), Vec::new());
    for given in pictures {
        let (values, times) = run(given)?;
        all.push(values);
        stages.extend(times);
    }
    Ok((all, stages))
}
