//! What a run gives back, read from staging memory.

use std::collections::HashMap;
use std::time::Duration;

use super::Slot;
use crate::engine::gpu::context::Gpu;
use crate::engine::gpu::landing::Landing;
use crate::engine::gpu::program::{GUARD_BYTES, Profile, Step};
use crate::engine::graph::{StageTime, TensorId};
use crate::engine::kernels::{Layout, Quads, Storage};
use crate::engine::shape::DType;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// What a run gives back.
#[derive(Clone, Debug)]
pub struct RunOutput {
    /// For each picture, the values of the graph's outputs and of the tensors that were kept.
    pub values: Vec<HashMap<TensorId, Value>>,
    /// Device time by stage, or by command; empty where the device has no timestamps.
    pub stages: Vec<StageTime>,
    /// From the first byte uploaded to the last read back.
    pub wall: Duration,
}

impl RunOutput {
    /// The values of the first picture.
    pub fn first(&mut self) -> HashMap<TensorId, Value> {
        if self.values.is_empty() { HashMap::new() } else { self.values.swap_remove(0) }
    }
}

impl Slot {
    /// What a run that has ended gives back.
    pub(super) fn read(&self, landing: &Landing) -> Result<RunOutput> {
        let refused = |message: String| Error::Driver {
            stage: "reading what the network gave".into(),
            message,
        };
        let staging = self.staging.as_ref().ok_or_else(|| refused("it was given up".into()))?;
        let slice = staging.slice(..self.staging_bytes);
        let bytes = slice.get_mapped_range().map_err(|e| refused(e.to_string()))?;
        let values = (0..self.program.batch).map(|picture| self.collect(&bytes, picture));
        let values = values.collect::<Result<_>>()?;
        let stages = self.times(&self.program.gpu, &bytes);
        Ok(RunOutput { values, stages, wall: landing.start.elapsed() })
    }

    fn collect(&self, bytes: &[u8], picture: u32) -> Result<HashMap<TensorId, Value>> {
        let program = &self.program;
        let mut values = HashMap::new();
        for output in &program.outputs {
            let info = &program.tensors[output.tensor.0];
            let Storage::Buffer { bytes: all } = info.storage else { continue };
            let start = output.offset as usize;
            if program.options.guard {
                let end = start + all as usize;
                let behind: Vec<u32> =
                    bytemuck::pod_collect_to_vec(&bytes[end..end + GUARD_BYTES as usize]);
                let first = all as usize / 4;
                let word = |at: usize| self.poison.word(output.tensor, first + at);
                if let Some(at) = (0..behind.len()).find(|at| behind[*at] != word(*at)) {
                    return Err(Error::tensor(
                        "run",
                        &info.name,
                        "no write behind its end",
                        format!("one {at} elements behind"),
                    ));
                }
            }
            let Some(id) = output.id else { continue };
            let start = start + (u64::from(picture) * info.stride) as usize;
            let value = match info.layout {
                Layout::Planar => {
                    let end = start + info.spec.bytes() as usize;
                    Value::from_bytes(&info.spec, &bytes[start..end])?
                }
                Layout::Quads | Layout::Texture => {
                    let (caps, batch) = (program.gpu.caps(), program.batch);
                    let quads = Quads::of(&info.spec, program.precision(), batch, caps);
                    let wrong = || Error::tensor("run", &info.name, "a map [C, H, W]", &info.spec);
                    let quads =
                        quads.filter(|_| info.spec.dtype == DType::F32).ok_or_else(wrong)?;
                    let end = start + info.stride as usize;
                    let texels = info.precision.decode(&bytes[start..end]);
                    Tensor::new(info.spec.shape.clone(), quads.unpack(&texels))?.into()
                }
            };
            values.insert(id, value);
        }
        Ok(values)
    }

    fn times(&self, gpu: &Gpu, bytes: &[u8]) -> Vec<StageTime> {
        let Some(t) = &self.timestamps else { return Vec::new() };
        let start = t.offset as usize;
        let ticks: Vec<u64> =
            bytemuck::pod_collect_to_vec(&bytes[start..start + t.resolve.size() as usize]);
        let period = f64::from(gpu.device.queue.get_timestamp_period());
        let names: Vec<String> = match self.program.options.profile {
            Profile::Commands => self.program.steps.iter().map(Step::name).collect(),
            _ => self.program.stages.iter().map(|(name, _)| name.clone()).collect(),
        };
        names
            .into_iter()
            .zip(ticks.chunks_exact(2))
            .map(|(stage, t)| StageTime {
                stage,
                time: Duration::from_nanos((t[1].saturating_sub(t[0]) as f64 * period) as u64),
            })
            .collect()
    }
}
