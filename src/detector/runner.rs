//! What runs a graph for a detector: a GPU's slots, the CPU, or the reference.

use std::sync::Arc;
#[cfg(feature = "cpu")]
use std::sync::{Mutex, PoisonError};

use crate::comparison::{How, Values};
use crate::detector::pool::Pool;
use crate::detector::{Config, Device};
use crate::error::Result;
use crate::gpu::{Deadline, Gpu, Program, ProgramOptions};
use crate::graph::{Graph, StageTime, TensorId};
#[cfg(feature = "cpu")]
use crate::host::HostPlan;
use crate::lower::{Choice, Request, lower};
use crate::precision::Precision;
use crate::tensor::Value;

/// A graph made ready on a device.
pub(super) enum Runner {
    Gpu(Pool),
    #[cfg(feature = "cpu")]
    Host(Box<Mutex<HostPlan>>),
    Reference,
}

impl Runner {
    /// Makes `graph` ready on `gpu`, where it is stored in a precision, or on the CPU. What `like` has there of the same weights is shared.
    pub async fn new(
        config: &Config,
        graph: &Graph,
        keep: &[TensorId],
        gpu: Option<(&Arc<Gpu>, Precision)>,
        choice: &Choice,
        like: Option<&Self>,
    ) -> Result<Self> {
        Ok(match (gpu, &config.device) {
            (Some((gpu, precision)), _) => {
                let request = Request { keep, batch: 1, precision, caps: gpu.caps(), choice };
                let lowered = lower(graph, &request)?;
                let like = match like {
                    Some(Self::Gpu(pool)) => Some(pool.program()),
                    _ => None,
                };
                let program = Program::new(gpu, &lowered, like, ProgramOptions::default()).await?;
                Self::Gpu(Pool::new(Arc::new(program), config.in_flight).await?)
            }
            (None, Device::Reference) => Self::Reference,
            #[cfg(feature = "cpu")]
            (None, _) => {
                let like = match like {
                    Some(Self::Host(plan)) => {
                        Some(plan.lock().unwrap_or_else(PoisonError::into_inner))
                    }
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
            Self::Gpu(pool) => {
                let program = pool.program();
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
        inputs: &[(TensorId, &Value)],
        deadline: Deadline,
    ) -> Result<(Values, Vec<StageTime>)> {
        match self {
            Self::Reference => graph.reference(inputs, keep),
            #[cfg(feature = "cpu")]
            Self::Host(plan) => {
                plan.lock().unwrap_or_else(PoisonError::into_inner).run(graph, inputs)
            }
            Self::Gpu(pool) => {
                let mut slot = pool.take(deadline).await?;
                slot.submit(&[inputs])?;
                let mut run = slot.receive(deadline).await?;
                Ok((run.first(), run.stages))
            }
        }
    }
}
