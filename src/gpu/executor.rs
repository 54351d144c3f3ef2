//! A [`Plan`]: a recording turned once into buffers, pipelines and bind groups, and run many times
//! with one submit and one map each.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
use crate::gpu::arena;
use crate::gpu::context::{Gpu, Pipeline};
use crate::gpu::readback;
use crate::gpu::recording::{Dispatch, Grid, Recording, Role, TensorId, TensorInfo};
use crate::gpu::shader::BindingKind;
use crate::shape::{Extent, TensorSpec};
use crate::tensor::Value;

/// Uniform bindings start at multiples of this under `wgpu::Limits::default()`.
const UNIFORM_ALIGN: usize = 256;
/// Bytes behind each tensor that no shader may touch, where `PlanOptions::guard` is set.
const GUARD_BYTES: u64 = 4 * 64;

/// What guarded buffers hold before a run. Each word differs with its tensor and place, so that a
/// copied one shows too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Poison {
    /// Float NaNs: they show in whatever a sum or product makes of them, but arithmetic leaves them
    /// as they are, and a maximum passes over them.
    #[default]
    Nan,
    /// Floats of both signs, every other near 1 and huge: sums and products change the former, and
    /// the latter win any maximum or minimum.
    Finite,
}

impl Poison {
    /// Word `at` of `tensor`.
    pub fn word(self, tensor: TensorId, at: usize) -> u32 {
        // The finalizer of MurmurHash3, which spreads each bit over all.
        let mut hash = (tensor.0 as u32).wrapping_mul(0x9e37_79b9) ^ at as u32;
        hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
        hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
        hash ^= hash >> 16;
        match self {
            // Quiet: a driver may set that bit when it moves a signalling one.
            Self::Nan => 0x7fc0_0000 | hash & 0x003f_ffff,
            Self::Finite if at.is_multiple_of(2) => 0x3f80_0000 | hash & 0x807f_ffff,
            // About 1e30.
            Self::Finite => 0x7180_0000 | hash & 0x807f_ffff,
        }
    }
}

/// How to build a plan.
#[derive(Clone, Copy, Debug)]
pub struct PlanOptions {
    /// Let tensors whose lifetimes do not overlap share a buffer.
    pub reuse: bool,
    /// For tests: fill every computed tensor with [`Poison`] before each run and put it behind every
    /// tensor, which shows in the results where a shader reads it; fail if one was written.
    pub guard: bool,
    /// Time each stage on the device, where it can.
    pub profile: bool,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self { reuse: true, guard: false, profile: true }
    }
}

/// Time that one stage took.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StageTime {
    /// Stage name.
    pub stage: String,
    /// Time on the device; serialised as `ms`.
    #[cfg_attr(feature = "serde", serde(rename = "ms", with = "crate::milliseconds"))]
    pub time: Duration,
}

/// What a run gives back.
#[derive(Clone, Debug)]
pub struct RunOutput {
    /// Values of the recording's outputs.
    pub values: HashMap<TensorId, Value>,
    /// Device time by stage; empty where the device has no timestamps.
    pub stages: Vec<StageTime>,
    /// From the first byte uploaded to the last read back.
    pub wall: Duration,
}

struct Step {
    pipeline: Arc<Pipeline>,
    bind_group: wgpu::BindGroup,
    grid: StepGrid,
}

enum StepGrid {
    Direct([u32; 3]),
    Indirect(wgpu::Buffer),
}

/// Words of a guarded buffer that hold poison before a run.
struct Poisoned {
    id: TensorId,
    slot: usize,
    words: std::ops::Range<usize>,
}

struct Output {
    id: TensorId,
    slot: usize,
    spec: TensorSpec,
    name: String,
    offset: u64,
}

/// A recording made ready to run on one device. Runs must not overlap: it holds one set of buffers.
pub struct Plan {
    gpu: Arc<Gpu>,
    options: PlanOptions,
    buffers: Vec<wgpu::Buffer>,
    slot: Vec<Option<usize>>,
    /// Tensors the host writes before each run.
    inputs: HashMap<TensorId, (TensorInfo, Extent)>,
    /// In guarded plans, computed tensors and what lies behind the others.
    poisoned: Vec<Poisoned>,
    poison: Poison,
    outputs: Vec<Output>,
    steps: Vec<Step>,
    stages: Vec<(String, std::ops::Range<usize>)>,
    staging: wgpu::Buffer,
    staging_bytes: u64,
    /// Query set, resolve buffer, offset of the timestamps in the staging buffer.
    timestamps: Option<(wgpu::QuerySet, wgpu::Buffer, u64)>,
}

impl std::fmt::Debug for Plan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Plan({} dispatches, {} buffers)", self.steps.len(), self.buffers.len())
    }
}

impl Plan {
    /// Compiles the shaders of `recording`, allocates its buffers and uploads its constants.
    ///
    /// # Errors
    /// [`Error::Shader`] for a shader that does not compile or does not have the bindings that were
    /// recorded; [`Error::Capacity`] for a tensor past the device's binding size;
    /// [`Error::Driver`] for what the driver objects to.
    pub async fn new(gpu: &Arc<Gpu>, recording: &Recording, options: PlanOptions) -> Result<Self> {
        gpu.check_lost()?;
        let plan = gpu.scoped("building the plan", || Self::build(gpu, recording, options)).await;
        if plan.is_err() {
            gpu.forget_pipelines();
        }
        plan
    }

    fn build(gpu: &Arc<Gpu>, recording: &Recording, options: PlanOptions) -> Result<Self> {
        let limits = gpu.device.limits();
        for info in recording.tensors() {
            if info.spec.bytes() > limits.max_storage_buffer_binding_size {
                return Err(Error::Capacity {
                    what: format!("bytes for tensor `{}` ({})", info.name, info.spec),
                    needed: info.spec.bytes(),
                    available: limits.max_storage_buffer_binding_size,
                });
            }
        }
        let guard = if options.guard { GUARD_BYTES } else { 0 };
        let assignment = arena::assign(recording, options.reuse && !options.guard);
        let buffers: Vec<wgpu::Buffer> = assignment
            .bytes
            .iter()
            .map(|bytes| {
                gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: None,
                    size: bytes + guard,
                    usage: wgpu::BufferUsages::STORAGE
                        | wgpu::BufferUsages::INDIRECT
                        | wgpu::BufferUsages::COPY_SRC
                        | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            })
            .collect();
        let slot = assignment.slot;

        let mut inputs = HashMap::new();
        let mut poisoned = Vec::new();
        let mut outputs = Vec::new();
        let mut staging_bytes = 0;
        for (index, info) in recording.tensors().iter().enumerate() {
            let Some(at) = slot[index] else { continue };
            let buffer = &buffers[at];
            if options.guard {
                let by_host = matches!(info.role, Role::Constant(_) | Role::Input(_));
                let first = if by_host { buffer.size() - guard } else { 0 };
                let words = (first / 4) as usize..(buffer.size() / 4) as usize;
                poisoned.push(Poisoned { id: TensorId(index), slot: at, words });
            }
            match &info.role {
                Role::Constant(value) => gpu.queue.write_buffer(buffer, 0, value.bytes()),
                Role::Input(extent) => {
                    inputs.insert(TensorId(index), (info.clone(), *extent));
                }
                Role::Transient | Role::Output => {}
            }
            let is_output = matches!(info.role, Role::Output);
            if is_output || (options.guard && matches!(info.role, Role::Transient)) {
                outputs.push(Output {
                    id: TensorId(index),
                    slot: at,
                    spec: info.spec.clone(),
                    name: info.name.clone(),
                    offset: staging_bytes,
                });
                staging_bytes += info.spec.bytes() + guard;
            }
        }

        let steps = Self::steps(gpu, recording, &buffers, &slot)?;
        let stages = stage_ranges(recording);
        let timestamps =
            (options.profile && gpu.has_timestamps() && !stages.is_empty()).then(|| {
                let count = stages.len() as u32 * 2;
                let set = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                    label: None,
                    ty: wgpu::QueryType::Timestamp,
                    count,
                });
                let resolve = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: None,
                    size: u64::from(count) * 8,
                    usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                });
                let offset = staging_bytes.next_multiple_of(8);
                staging_bytes = offset + resolve.size();
                (set, resolve, offset)
            });
        if staging_bytes > limits.max_buffer_size {
            return Err(Error::Capacity {
                what: "bytes read back in one run; keep fewer tensors or a smaller input".into(),
                needed: staging_bytes,
                available: limits.max_buffer_size,
            });
        }
        let staging = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size: staging_bytes.max(4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Ok(Self {
            gpu: gpu.clone(),
            options,
            buffers,
            slot,
            inputs,
            poisoned,
            poison: Poison::default(),
            outputs,
            steps,
            stages,
            staging,
            staging_bytes: staging_bytes.max(4),
            timestamps,
        })
    }

    /// What guarded buffers hold before the next runs; [`Poison::Nan`] at first.
    pub fn poison_with(&mut self, poison: Poison) {
        self.poison = poison;
    }

    fn steps(
        gpu: &Gpu,
        recording: &Recording,
        buffers: &[wgpu::Buffer],
        slot: &[Option<usize>],
    ) -> Result<Vec<Step>> {
        let mut uniforms: Vec<u8> = Vec::new();
        let offsets: Vec<usize> = recording
            .dispatches()
            .iter()
            .map(|d| {
                let at = uniforms.len();
                uniforms.extend_from_slice(&d.params);
                uniforms.resize(uniforms.len().next_multiple_of(UNIFORM_ALIGN), 0);
                at
            })
            .collect();
        let uniform_buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("params"),
            size: (uniforms.len() as u64).max(4),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        if !uniforms.is_empty() {
            gpu.queue.write_buffer(&uniform_buffer, 0, &uniforms);
        }
        let mut steps = Vec::with_capacity(recording.dispatches().len());
        for (dispatch, offset) in recording.dispatches().iter().zip(offsets) {
            let pipeline = gpu.pipeline(dispatch)?;
            let mut entries = Vec::new();
            for (name, binding, kind) in &pipeline.bindings {
                let resource = match kind {
                    BindingKind::Uniform => wgpu::BufferBinding {
                        buffer: &uniform_buffer,
                        offset: offset as u64,
                        size: std::num::NonZeroU64::new(dispatch.params.len() as u64),
                    },
                    _ => {
                        let id = bound(dispatch, name)?;
                        buffer_of(buffers, slot, dispatch, id)?.as_entire_buffer_binding()
                    }
                };
                entries.push(wgpu::BindGroupEntry {
                    binding: *binding,
                    resource: wgpu::BindingResource::Buffer(resource),
                });
            }
            let extra = dispatch
                .bindings
                .iter()
                .find(|(n, _)| !pipeline.bindings.iter().any(|(name, _, _)| name == n));
            if let Some((name, _)) = extra {
                return Err(mismatch(dispatch, format!("no binding `{name}`")));
            }
            let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(dispatch.shader.stem),
                layout: &pipeline.layout,
                entries: &entries,
            });
            let grid = match dispatch.grid {
                Grid::Workgroups(n) => StepGrid::Direct(n),
                Grid::Indirect(id) => {
                    StepGrid::Indirect(buffer_of(buffers, slot, dispatch, id)?.clone())
                }
            };
            steps.push(Step { pipeline, bind_group, grid });
        }
        Ok(steps)
    }

    /// Writes `inputs`, runs every dispatch in one submit, and reads the outputs back in one map.
    ///
    /// # Errors
    /// [`Error::Tensor`] if an input is missing, unknown or of another shape;
    /// [`Error::DeviceLost`], [`Error::Timeout`] or [`Error::Driver`] from the device.
    pub fn run(&mut self, inputs: &[(TensorId, &Value)]) -> Result<RunOutput> {
        let start = Instant::now();
        self.gpu.check_lost()?;
        for (id, (info, extent)) in &self.inputs {
            let given = inputs.iter().find(|(i, _)| i == id).map(|(_, v)| v.spec());
            extent.check("run", &info.name, &info.spec, given)?;
        }
        for (id, value) in inputs {
            if !self.inputs.contains_key(id) {
                return Err(Error::tensor("run", &format!("{}", id.0), "an input", value.spec()));
            }
        }
        let gpu = self.gpu.clone();
        let submission = pollster::block_on(gpu.scoped("running the network", || {
            for Poisoned { id, slot, words } in &self.poisoned {
                let poison: Vec<u32> = words.clone().map(|at| self.poison.word(*id, at)).collect();
                let offset = words.start as u64 * 4;
                gpu.queue.write_buffer(&self.buffers[*slot], offset, bytemuck::cast_slice(&poison));
            }
            for (id, value) in inputs {
                if let Some(slot) = self.slot[id.0] {
                    gpu.queue.write_buffer(&self.buffers[slot], 0, value.bytes());
                }
            }
            Ok(gpu.queue.submit([self.encode()]))
        }))?;
        let bytes =
            readback::read(&gpu, &self.staging, self.staging_bytes, submission, "the network")?;
        let values = self.collect(&bytes)?;
        Ok(RunOutput { values, stages: self.stage_times(&bytes), wall: start.elapsed() })
    }

    fn encode(&self) -> wgpu::CommandBuffer {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        for (index, (name, range)) in self.stages.iter().enumerate() {
            let writes =
                self.timestamps.as_ref().map(|(set, _, _)| wgpu::ComputePassTimestampWrites {
                    query_set: set,
                    beginning_of_pass_write_index: Some(index as u32 * 2),
                    end_of_pass_write_index: Some(index as u32 * 2 + 1),
                });
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(name),
                timestamp_writes: writes,
            });
            for step in &self.steps[range.clone()] {
                pass.set_pipeline(&step.pipeline.pipeline);
                pass.set_bind_group(0, &step.bind_group, &[]);
                match &step.grid {
                    StepGrid::Direct([x, y, z]) => pass.dispatch_workgroups(*x, *y, *z),
                    StepGrid::Indirect(buffer) => pass.dispatch_workgroups_indirect(buffer, 0),
                }
            }
        }
        let guard = if self.options.guard { GUARD_BYTES } else { 0 };
        for output in &self.outputs {
            let bytes = output.spec.bytes() + guard;
            if bytes > 0 {
                let buffer = &self.buffers[output.slot];
                encoder.copy_buffer_to_buffer(buffer, 0, &self.staging, output.offset, bytes);
            }
        }
        if let Some((set, resolve, offset)) = &self.timestamps {
            encoder.resolve_query_set(set, 0..self.stages.len() as u32 * 2, resolve, 0);
            encoder.copy_buffer_to_buffer(resolve, 0, &self.staging, *offset, resolve.size());
        }
        encoder.finish()
    }

    fn collect(&self, bytes: &[u8]) -> Result<HashMap<TensorId, Value>> {
        let mut values = HashMap::new();
        for output in &self.outputs {
            let start = output.offset as usize;
            let end = start + output.spec.bytes() as usize;
            if self.options.guard {
                let behind: Vec<u32> =
                    bytemuck::pod_collect_to_vec(&bytes[end..end + GUARD_BYTES as usize]);
                let first = (end - start) / 4;
                let word = |at: usize| self.poison.word(output.id, first + at);
                if let Some(at) = (0..behind.len()).find(|at| behind[*at] != word(*at)) {
                    return Err(Error::tensor(
                        "run",
                        &output.name,
                        "no write behind its end",
                        format!("one {at} elements behind"),
                    ));
                }
            }
            values.insert(output.id, Value::from_bytes(&output.spec, &bytes[start..end])?);
        }
        Ok(values)
    }

    fn stage_times(&self, bytes: &[u8]) -> Vec<StageTime> {
        let Some((_, resolve, offset)) = &self.timestamps else { return Vec::new() };
        let start = *offset as usize;
        let ticks: Vec<u64> =
            bytemuck::pod_collect_to_vec(&bytes[start..start + resolve.size() as usize]);
        let period = f64::from(self.gpu.queue.get_timestamp_period());
        self.stages
            .iter()
            .zip(ticks.chunks_exact(2))
            .map(|((name, _), t)| StageTime {
                stage: name.clone(),
                time: Duration::from_nanos((t[1].saturating_sub(t[0]) as f64 * period) as u64),
            })
            .collect()
    }
}

fn bound(dispatch: &Dispatch, name: &str) -> Result<TensorId> {
    dispatch
        .bindings
        .iter()
        .find(|(n, _)| *n == name)
        .map(|(_, id)| *id)
        .ok_or_else(|| mismatch(dispatch, format!("binding `{name}` was not recorded")))
}

fn buffer_of<'a>(
    buffers: &'a [wgpu::Buffer],
    slot: &[Option<usize>],
    dispatch: &Dispatch,
    id: TensorId,
) -> Result<&'a wgpu::Buffer> {
    let buffer = slot[id.0].and_then(|at| buffers.get(at));
    buffer.ok_or_else(|| mismatch(dispatch, format!("tensor {} has no buffer", id.0)))
}

fn mismatch(dispatch: &Dispatch, message: String) -> Error {
    Error::Shader { file: format!("{}.wgsl", dispatch.shader.stem), line: 0, message }
}

fn stage_ranges(recording: &Recording) -> Vec<(String, std::ops::Range<usize>)> {
    let total = recording.dispatches().len();
    let mut starts: Vec<(String, usize)> =
        recording.stages().iter().map(|s| (s.name.clone(), s.first)).collect();
    if starts.first().is_none_or(|(_, first)| *first > 0) && total > 0 {
        starts.insert(0, ("all".into(), 0));
    }
    let ends: Vec<usize> = starts.iter().skip(1).map(|s| s.1).chain([total]).collect();
    starts.into_iter().zip(ends).map(|((name, start), end)| (name, start..end)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A word is no result of arithmetic on another: neither a copy nor a NaN that went through.
    #[test]
    fn poison_differs_from_word_to_word_and_between_its_kinds() {
        let words = |poison: Poison| -> Vec<u32> {
            let tensors = (0..4).map(TensorId);
            tensors.flat_map(|id| (0..1000).map(move |at| poison.word(id, at))).collect()
        };
        let (nan, finite) = (words(Poison::Nan), words(Poison::Finite));
        assert!(nan.iter().all(|w| f32::from_bits(*w).is_nan()));
        assert!(finite.iter().all(|w| f32::from_bits(*w).is_finite()));
        for kind in [nan, finite] {
            let distinct: std::collections::HashSet<_> = kind.iter().collect();
            assert!(distinct.len() > kind.len() - 20, "{} of {}", distinct.len(), kind.len());
        }
    }
}
