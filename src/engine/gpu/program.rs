//! A [`Program`]: a lowered graph with its pipelines and weights on a device, shared by all slots.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

use crate::engine::gpu::context::Gpu;
use crate::engine::gpu::memory::Resource;
use crate::engine::gpu::pipeline::Pipeline;
use crate::engine::graph::TensorId;
use crate::engine::kernels::{
    Command, Dispatch, Grid, Layout, Recording, Role, Storage, TensorInfo,
};
use crate::engine::lifetimes::Assignment;
use crate::engine::lower::{Lowered, storage};
use crate::engine::precision::Precision;
use crate::engine::shader::BindingKind;
use crate::engine::shape::Extent;
use crate::error::{Error, Result};

/// Uniform bindings start at multiples of this on every adapter.
const UNIFORM_ALIGN: usize = 256;

/// How to build a program.
#[derive(Clone, Copy, Debug)]
pub struct ProgramOptions {
    /// Let tensors whose lifetimes do not overlap share what holds them.
    pub reuse: bool,
    /// For tests: fill every computed tensor with [`Poison`](super::Poison) before each run and put
    /// it behind every tensor, which shows in the results where a shader reads it; fail if one was
    /// written.
    pub guard: bool,
    /// What is timed on the device, where it can.
    pub profile: Profile,
}

/// What a run times on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Profile {
    /// Nothing.
    Off,
    /// Each stage.
    Stages,
    /// Each command.
    Commands,
}

impl Default for ProgramOptions {
    fn default() -> Self {
        Self { reuse: true, guard: false, profile: Profile::Stages }
    }
}

/// Where a tensor lies.
#[derive(Clone, Copy, Debug)]
pub(super) enum Place {
    /// In the program: a constant.
    Fixed(usize),
    /// In a slot's storage.
    Slot(usize),
    /// Given for each picture, of a size of its own: its number among such.
    Given(usize),
}

/// One binding of a dispatch.
#[derive(Clone, Debug)]
pub(super) struct Bound {
    pub binding: u32,
    pub place: Place,
    /// First byte and number of bytes, where it is a part of a buffer.
    pub part: Option<(u64, u64)>,
}

/// A command, ready but for the slot's own resources.
pub(super) enum Step {
    Dispatch {
        pipeline: Arc<Pipeline>,
        bound: Vec<Bound>,
        /// Binding, offset and bytes of the uniform.
        uniform: Option<(u32, u64, u64)>,
        grid: StepGrid,
        picture: Option<u32>,
    },
    Copy {
        from: Place,
        to: Place,
        width: u32,
        height: u32,
        row_bytes: u32,
    },
}

impl Step {
    /// What it runs, for people.
    pub fn name(&self) -> String {
        match self {
            Self::Dispatch { pipeline, .. } => pipeline.label.clone(),
            Self::Copy { .. } => "copy".into(),
        }
    }
}

pub(super) enum StepGrid {
    Direct([u32; 3]),
    Indirect(Place, u64),
}

/// A tensor that a run gives back.
pub(super) struct Output {
    /// The graph's tensor, `None` for one that is only read to look at its guard.
    pub id: Option<TensorId>,
    pub tensor: TensorId,
    pub place: Place,
    pub offset: u64,
}

/// A lowered graph on a device: pipelines, weights, and how a slot is laid out. Immutable.
///
/// Shaders run without bounds checks, so this crate alone makes one, of its own shaders; see
/// [`Slot::of`](super::Slot::of) and [`Gpu::with_replacement`].
///
/// ```compile_fail,E0624
/// let make = smr_gpu::engine::gpu::Program::new;
/// ```
pub struct Program {
    pub(super) gpu: Arc<Gpu>,
    pub(super) options: ProgramOptions,
    pub(super) batch: u32,
    pub(super) tensors: Vec<TensorInfo>,
    pub(super) places: Vec<Option<Place>>,
    /// The recording's tensor of each of the graph's inputs and outputs.
    pub(super) names: HashMap<TensorId, TensorId>,
    /// What a slot needs of an arena, the largest first.
    pub(super) storage: Vec<Storage>,
    pub(super) fixed: Vec<Resource>,
    pub(super) uniforms: wgpu::Buffer,
    pub(super) steps: Vec<Step>,
    pub(super) stages: Vec<(String, std::ops::Range<usize>)>,
    pub(super) outputs: Vec<Output>,
    pub(super) staging_bytes: u64,
    kernels: Vec<&'static str>,
    precision: Precision,
    stored: HashMap<TensorId, Precision>,
    shared: HashMap<(String, Storage), usize>,
}

/// See [`Program::guard`].
pub(super) const GUARD_BYTES: u64 = 4 * 64;

impl std::fmt::Debug for Program {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Program({} commands, {} tensors)", self.steps.len(), self.tensors.len())
    }
}

impl Program {
    /// Compiles the shaders of `lowered`, and uploads its constants. Those that `like` holds already,
    /// a program of the same weights, are shared.
    ///
    /// # Errors
    /// [`Error::Shader`] for a shader that does not compile or does not have the bindings that were
    /// recorded; [`Error::Capacity`] for a tensor past the device's limits; [`Error::Driver`] for what
    /// the driver objects to.
    pub(crate) async fn new(
        gpu: &Arc<Gpu>,
        lowered: &Lowered,
        like: Option<&Program>,
        options: ProgramOptions,
    ) -> Result<Self> {
        let recording = &lowered.recording;
        check_sizes(recording, &gpu.device.handle.limits())?;
        let put = || {
            let put = || Self::put(gpu, lowered, like, options);
            gpu.device.scoped("building the program", put)
        };
        let put = gpu.pipelines.compile(&gpu.device, recording, put).await?;
        let mut program = put.await?;
        program.add_steps(recording)?;
        // A lost device objects to nothing.
        gpu.device.check_alive().await?;
        Ok(program)
    }

    /// A program that has its constants on the device, and no steps.
    fn put(
        gpu: &Arc<Gpu>,
        lowered: &Lowered,
        like: Option<&Program>,
        options: ProgramOptions,
    ) -> Result<Self> {
        let recording = &lowered.recording;
        let assignment = storage::assign(recording, options.reuse && !options.guard);
        let mut program = Self {
            gpu: gpu.clone(),
            options,
            batch: recording.batch(),
            tensors: recording.tensors().to_vec(),
            places: vec![None; recording.tensors().len()],
            names: lowered.places.clone(),
            storage: Vec::new(),
            fixed: Vec::new(),
            uniforms: uniforms(gpu, recording),
            steps: Vec::new(),
            stages: stage_ranges(recording),
            outputs: Vec::new(),
            staging_bytes: 0,
            kernels: lowered.kernels.clone(),
            precision: lowered.precision,
            stored: lowered.places.keys().map(|id| (*id, lowered.stored(*id))).collect(),
            shared: HashMap::new(),
        };
        program.place_all(recording, &assignment, like)?;
        // The weights are on the device: nobody needs how to make them any more.
        for info in &mut program.tensors {
            if let Role::Constant(_) = info.role {
                info.role = Role::Transient;
            }
        }
        Ok(program)
    }

    /// Adds the commands, whose pipelines are compiled, and what a run gives back.
    fn add_steps(&mut self, recording: &Recording) -> Result<()> {
        let mut offset = 0;
        for command in recording.commands() {
            self.add_step(command, &mut offset)?;
        }
        self.add_outputs(recording);
        let available = self.gpu.device.handle.limits().max_buffer_size;
        if self.staging_bytes > available {
            return Err(Error::Capacity {
                what: "bytes read back in one run; keep fewer tensors or a smaller input".into(),
                needed: self.staging_bytes,
                available,
            });
        }
        Ok(())
    }

    /// Gives each tensor its place, and puts the constants on the device.
    fn place_all(
        &mut self,
        recording: &Recording,
        assignment: &Assignment<Storage>,
        like: Option<&Program>,
    ) -> Result<()> {
        let mut slots: HashMap<usize, usize> = HashMap::new();
        let mut given = 0;
        // The largest first: what it takes to make them is not yet beside all the others.
        let mut order: Vec<usize> = (0..recording.tensors().len()).collect();
        order.sort_by_key(|index| std::cmp::Reverse(recording.tensors()[*index].storage.bytes()));
        for index in order {
            let info = &recording.tensors()[index];
            let Some(slot) = assignment.slot[index] else { continue };
            self.places[index] = Some(match &info.role {
                Role::Constant(_) => Place::Fixed(self.upload(info, like)?),
                Role::Input(Extent::UpTo) => {
                    given += 1;
                    Place::Given(given - 1)
                }
                Role::Input(Extent::Exact) | Role::Transient | Role::Output => {
                    let next = self.storage.len();
                    let at = *slots.entry(slot).or_insert(next);
                    if at == next {
                        self.storage.push(assignment.storage[slot]);
                    }
                    Place::Slot(at)
                }
            });
        }
        Ok(())
    }

    /// Puts a constant on the device, or finds it where it is already.
    fn upload(&mut self, info: &TensorInfo, like: Option<&Program>) -> Result<usize> {
        let Role::Constant(constant) = &info.role else {
            return Err(Error::tensor("program", &info.name, "a constant", "another tensor"));
        };
        let name = (info.name.clone(), info.storage);
        let resource = match like.and_then(|p| Some(p.fixed[*p.shared.get(&name)?].clone())) {
            Some(shared) => shared,
            None => {
                let value = constant.get()?;
                let resource = self.gpu.device.create(info.storage, self.guard());
                match &resource {
                    Resource::Buffer(buffer) => self.gpu.device.upload(buffer, value.bytes()),
                    Resource::Texture(texture, _) => {
                        let width = match info.storage {
                            Storage::Texture { width, .. } => width,
                            Storage::Buffer { .. } => 0,
                        };
                        let bytes = match info.precision {
                            Precision::F32 => Cow::from(value.bytes()),
                            precision => precision.encode(value.f32()?.data()).into(),
                        };
                        self.gpu.device.upload_texture(texture, width, &bytes);
                    }
                }
                resource
            }
        };
        self.fixed.push(resource);
        self.shared.insert(name, self.fixed.len() - 1);
        Ok(self.fixed.len() - 1)
    }

    fn place(&self, dispatch: &Dispatch, id: TensorId) -> Result<Place> {
        let none = || mismatch(dispatch, format!("tensor {} lies nowhere", id.0));
        self.places[id.0].ok_or_else(none)
    }

    fn add_step(&mut self, command: &Command, offset: &mut u64) -> Result<()> {
        let dispatch = match command {
            Command::Dispatch(dispatch) => dispatch,
            Command::Copy { from, to } => {
                let info = &self.tensors[to.0];
                let missing =
                    || Error::tensor("program", &info.name, "a texture", "another tensor");
                let Storage::Texture { width, height, precision } = info.storage else {
                    return Err(missing());
                };
                let row_bytes = width * precision.texel_bytes();
                let [from, to] = [from, to].map(|id| self.places[id.0].ok_or_else(missing));
                self.steps.push(Step::Copy { from: from?, to: to?, width, height, row_bytes });
                return Ok(());
            }
        };
        let pipeline = self.gpu.pipelines.compiled(dispatch)?;
        let mut bound = Vec::new();
        let mut uniform = None;
        let (params, bytes) = (*offset, dispatch.params.len() as u64);
        *offset += bytes.next_multiple_of(UNIFORM_ALIGN as u64);
        for (name, binding, kind) in &pipeline.bindings {
            if *kind == BindingKind::Uniform {
                uniform = Some((*binding, params, bytes));
                continue;
            }
            let missing = || mismatch(dispatch, format!("binding `{name}` was not recorded"));
            let found = dispatch.bindings.iter().find(|(n, _)| n == name);
            let (_, id) = found.ok_or_else(missing)?;
            bound.push(Bound {
                binding: *binding,
                place: self.place(dispatch, *id)?,
                part: self.part(dispatch, *id),
            });
        }
        let known = |n: &str| pipeline.bindings.iter().any(|(name, _, _)| name == n);
        if let Some((name, _)) = dispatch.bindings.iter().find(|(n, _)| !known(n)) {
            return Err(mismatch(dispatch, format!("no binding `{name}`")));
        }
        let grid = match dispatch.grid {
            Grid::Workgroups(n) => StepGrid::Direct(n),
            Grid::Counted(..) => {
                return Err(mismatch(dispatch, "a count that was not lowered to a grid".into()));
            }
            Grid::Indirect(..) if pipeline.reads_grid => {
                let message = "an indirect dispatch of what reads the number of workgroups";
                return Err(mismatch(dispatch, message.into()));
            }
            Grid::Indirect(id, offset) => {
                let first = self.part(dispatch, id).map_or(0, |(first, _)| first);
                StepGrid::Indirect(self.place(dispatch, id)?, first + offset)
            }
        };
        let picture = dispatch.picture;
        self.steps.push(Step::Dispatch { pipeline, bound, uniform, grid, picture });
        Ok(())
    }

    /// What a dispatch for one picture of several sees of a tensor.
    fn part(&self, dispatch: &Dispatch, id: TensorId) -> Option<(u64, u64)> {
        let info = &self.tensors[id.0];
        let picture = dispatch.picture.filter(|_| self.batch > 1)?;
        match self.places[id.0]? {
            Place::Slot(_) => {
                let bytes = match info.layout {
                    Layout::Planar => info.spec.bytes().max(4),
                    Layout::Quads | Layout::Texture => info.stride,
                };
                Some((u64::from(picture) * info.stride, bytes))
            }
            // A constant serves all pictures, and each picture's inputs are their own.
            Place::Fixed(_) | Place::Given(_) => None,
        }
    }

    fn add_outputs(&mut self, recording: &Recording) {
        let guard = self.guard();
        let names: HashMap<TensorId, TensorId> = self.names.iter().map(|(k, v)| (*v, *k)).collect();
        for (index, info) in recording.tensors().iter().enumerate() {
            let tensor = TensorId(index);
            let asked = matches!(info.role, Role::Output);
            let guarded = guard > 0 && matches!(info.role, Role::Transient);
            let Storage::Buffer { bytes } = info.storage else { continue };
            let Some(place) = self.places[index].filter(|_| asked || guarded) else { continue };
            let id = names.get(&tensor).copied().filter(|_| asked);
            self.outputs.push(Output { id, tensor, place, offset: self.staging_bytes });
            self.staging_bytes += (bytes + guard).next_multiple_of(8);
        }
    }

    /// Bytes behind each tensor that no shader may touch.
    pub(super) fn guard(&self) -> u64 {
        if self.options.guard { GUARD_BYTES } else { 0 }
    }

    /// The device.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// Pictures at a time.
    pub fn batch(&self) -> u32 {
        self.batch
    }

    /// How maps and weights are stored, where kernels store them otherwise than planar.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// How each of the graph's tensors that is given or read back is stored.
    pub(crate) fn stored(&self) -> &HashMap<TensorId, Precision> {
        &self.stored
    }

    /// The kernel of each operation, in order.
    pub fn kernels(&self) -> &[&'static str] {
        &self.kernels
    }
}

fn check_sizes(recording: &Recording, limits: &wgpu::Limits) -> Result<()> {
    for info in recording.tensors() {
        let (what, needed, available) = match info.storage {
            _ if matches!(info.role, Role::Input(Extent::UpTo)) => continue,
            Storage::Buffer { bytes } => ("bytes", bytes, limits.max_storage_buffer_binding_size),
            Storage::Texture { width, height, .. } => (
                "texels of a side",
                width.max(height).into(),
                limits.max_texture_dimension_2d.into(),
            ),
        };
        if needed > available {
            let what = format!("{what} for tensor `{}` ({})", info.name, info.spec);
            return Err(Error::Capacity { what, needed, available });
        }
    }
    Ok(())
}

/// The uniforms of all dispatches, one behind the other.
fn uniforms(gpu: &Gpu, recording: &Recording) -> wgpu::Buffer {
    let mut bytes: Vec<u8> = Vec::new();
    for command in recording.commands() {
        let Command::Dispatch(dispatch) = command else { continue };
        bytes.extend_from_slice(&dispatch.params);
        bytes.resize(bytes.len().next_multiple_of(UNIFORM_ALIGN), 0);
    }
    let buffer = gpu.device.create_buffer(wgpu::BufferDescriptor {
        label: Some("params"),
        size: (bytes.len() as u64).max(4),
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    if !bytes.is_empty() {
        gpu.device.write(&buffer, 0, &bytes);
    }
    buffer
}

fn mismatch(dispatch: &Dispatch, message: String) -> Error {
    Error::Shader { file: format!("{}.wgsl", dispatch.shader.stem), line: 0, message }
}

fn stage_ranges(recording: &Recording) -> Vec<(String, std::ops::Range<usize>)> {
    let total = recording.commands().len();
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
    use crate::engine::gpu::{GpuOptions, Slot};
    use crate::engine::graph::Graph;
    use crate::engine::lower::{KernelChoice, Request, lower};
    use crate::engine::ops::Conv2d;
    use crate::engine::shape::TensorSpec;
    use crate::engine::tensor::{Tensor, Value};

    /// Two kernels of one convolution pack the same weights otherwise, in textures of one size.
    #[test]
    fn programs_share_only_weights_that_are_packed_alike() {
        let gpu = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
        let mut graph = Graph::default();
        let small = |i: usize| (i * 7 % 11) as f32;
        let input = graph.input("input", TensorSpec::f32([8, 4, 4]), Extent::Exact);
        let weight = graph.constant("weight", Tensor::from_fn([16, 8, 1, 1], small));
        let op = Conv2d { bias: false, ..Conv2d::default() };
        let output = graph.apply1("conv", op, &[input, weight]).expect("a map");
        graph.mark_output(output);
        // Whole numbers, so that no order of sums matters.
        let value = Value::from(Tensor::from_fn([8, 4, 4], small));
        let run = |id: &str, like: Option<&Program>| {
            let kernels = KernelChoice::force(id).expect("a kernel");
            let (caps, kernels) = (gpu.caps(), &kernels);
            let request = Request { keep: &[], batch: 1, precision: Precision::F32, caps, kernels };
            let lowered = lower(&graph, &request).expect("kernels");
            let program = Program::new(&gpu, &lowered, like, ProgramOptions::default());
            let program = Arc::new(pollster::block_on(program).expect("a program"));
            let mut slot = pollster::block_on(Slot::new(&program)).expect("a slot");
            let got = slot.run(&[(input, &value)]).expect("a run").first()[&output].clone();
            (program, got)
        };
        let (scalar, want) = run("conv2d/scalar", None);
        let (_, got) = run("conv2d/direct", Some(&scalar));
        assert_eq!(got, want);
    }
}
