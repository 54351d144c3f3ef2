//! A [`Slot`]: what one run of a program needs for itself, so that several can be in flight.

use std::collections::HashMap;
use std::sync::Arc;
use std::task::Waker;
use std::time::Duration;

use web_time::Instant;

use crate::engine::gpu::arena::Arena;
use crate::engine::gpu::context::Gpu;
use crate::engine::gpu::deadline::Deadline;
use crate::engine::gpu::faults::{Call, Fault};
use crate::engine::gpu::landing::Landing;
use crate::engine::gpu::memory::Resource;
use crate::engine::gpu::poison::Poison;
use crate::engine::gpu::program::{
    GUARD_BYTES, Place, Profile, Program, ProgramOptions, Step, StepGrid,
};
use crate::engine::graph::{Graph, StageTime, TensorId};
use crate::engine::kernels::{Layout, Quads, Role, Storage};
use crate::engine::lower::{KernelChoice, Request, lower};
use crate::engine::precision::Precision;
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

/// The values that a run takes, by the graph's inputs.
pub type Inputs<'a> = [(TensorId, &'a Value)];

/// One run of a [`Program`] at a time: what binds it to an `Arena`, and staging memory.
pub struct Slot {
    program: Arc<Program>,
    arena: Arc<Arena>,
    /// What the arena held at the last run.
    storage: Vec<Resource>,
    /// What the host writes there of a size of its own, by its number and the picture.
    given: HashMap<(usize, u32), wgpu::Buffer>,
    /// For each step, its bindings; none for copies, and before they are needed.
    groups: Vec<Option<wgpu::BindGroup>>,
    /// None after a run that failed, until the next.
    staging: Option<wgpu::Buffer>,
    staging_bytes: u64,
    timestamps: Option<Timestamps>,
    poison: Poison,
    in_flight: Option<Landing>,
}

struct Timestamps {
    set: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    /// Their place in the staging buffer.
    offset: u64,
}

impl std::fmt::Debug for Slot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Slot({} buffers and textures)", self.storage.len())
    }
}

impl Slot {
    /// Allocates what a run of `program` needs, in an arena of its own.
    ///
    /// # Errors
    /// [`Error::Driver`] for what the driver objects to.
    pub async fn new(program: &Arc<Program>) -> Result<Self> {
        Self::sharing(program, &Arc::default()).await
    }

    /// Allocates what a run of `program` needs, in `arena`. Nothing else may run there while it does.
    ///
    /// # Errors
    /// As [`Slot::new`].
    pub(crate) async fn sharing(program: &Arc<Program>, arena: &Arc<Arena>) -> Result<Self> {
        let gpu = program.gpu.clone();
        let build = || Ok(Self::build(program, arena));
        let slot = gpu.device.scoped("allocating memory for a picture", build).await;
        let slot = slot.inspect_err(|_| arena.clear())?;
        // A lost device objects to nothing.
        gpu.device.check_alive().await?;
        Ok(slot)
    }

    /// A slot of a program of its own: `graph` by the preferred kernels, a picture at a time. A run
    /// gives back the graph's outputs and the tensors in `keep`.
    ///
    /// # Errors
    /// What lowering, compiling and allocating return.
    pub async fn of(
        gpu: &Arc<Gpu>,
        graph: &Graph,
        keep: &[TensorId],
        options: ProgramOptions,
    ) -> Result<Self> {
        let kernels = KernelChoice::default();
        let precision = Precision::F32;
        let request = Request { keep, batch: 1, precision, caps: gpu.caps(), kernels: &kernels };
        let lowered = lower(graph, &request)?;
        let program = Program::new(gpu, &lowered, None, options).await?;
        Self::new(&Arc::new(program)).await
    }

    fn build(program: &Arc<Program>, arena: &Arc<Arena>) -> Self {
        let gpu = &program.gpu;
        let storage = arena.storage(gpu, &program.storage, program.guard());
        let timed = match program.options.profile {
            Profile::Off => 0,
            Profile::Stages => program.stages.len(),
            Profile::Commands => program.steps.len(),
        };
        let mut staging_bytes = program.staging_bytes;
        let timestamps = (timed > 0 && gpu.has_timestamps()).then(|| {
            let count = timed as u32 * 2;
            let set = gpu.device.handle.create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Timestamp,
                count,
            });
            let resolve = gpu.device.create_buffer(wgpu::BufferDescriptor {
                label: None,
                size: u64::from(count) * 8,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            });
            let offset = staging_bytes.next_multiple_of(8);
            staging_bytes = offset + resolve.size();
            Timestamps { set, resolve, offset }
        });
        let staging_bytes = staging_bytes.max(4);
        Self {
            program: program.clone(),
            arena: arena.clone(),
            storage,
            given: HashMap::new(),
            groups: program.steps.iter().map(|_| None).collect(),
            staging: Some(staging(gpu, staging_bytes)),
            staging_bytes,
            timestamps,
            poison: Poison::default(),
            in_flight: None,
        }
    }

    /// The program that it runs.
    pub fn program(&self) -> &Arc<Program> {
        &self.program
    }

    /// Whether it runs in `arena`.
    pub(crate) fn is_in(&self, arena: &Arc<Arena>) -> bool {
        Arc::ptr_eq(&self.arena, arena)
    }

    /// What guarded buffers hold before the next runs; [`Poison::Nan`] at first.
    pub fn poison_with(&mut self, poison: Poison) {
        self.poison = poison;
    }

    /// [`Slot::submit`] of one picture and [`Slot::receive`], within the device's time limit.
    ///
    /// # Errors
    /// As both.
    pub fn run(&mut self, inputs: &Inputs) -> Result<RunOutput> {
        pollster::block_on(self.run_async(inputs))
    }

    /// [`Slot::run`] for callers with an executor of their own.
    ///
    /// # Errors
    /// As [`Slot::run`].
    pub async fn run_async(&mut self, inputs: &Inputs<'_>) -> Result<RunOutput> {
        let deadline = Deadline::after(self.program.gpu.timeout());
        self.recover(deadline).await?;
        self.submit(&[inputs]).await?;
        self.receive(deadline).await
    }

    /// Whether no run is under way.
    pub fn is_free(&self) -> bool {
        self.in_flight.as_ref().is_none_or(Landing::is_over)
    }

    /// Wakes `waker` when no run is under way any more.
    pub fn wake_when_free(&self, waker: &Waker) {
        match &self.in_flight {
            Some(landing) => landing.wake_when_over(waker),
            None => waker.wake_by_ref(),
        }
    }

    /// Waits for a run that nobody received, and forgets it.
    ///
    /// # Errors
    /// [`Error::Timeout`] if it does not end in time, [`Error::DeviceLost`].
    pub async fn recover(&mut self, deadline: Deadline) -> Result<()> {
        if let Some(landing) = &self.in_flight {
            match self.program.gpu.device.wait_for(landing, deadline, "an earlier picture").await {
                Ok(()) => self.unmap(),
                // What became of that run concerns nobody.
                Err(Error::Driver { .. }) => self.give_staging_up(),
                Err(e) => return Err(e),
            }
            self.in_flight = None;
        }
        Ok(())
    }

    /// Uploads the inputs of each picture and starts the run. There may be fewer pictures than the
    /// program's batch: they are then repeated.
    ///
    /// # Errors
    /// [`Error::Tensor`] if an input is missing, unknown or of another shape, or if a run is under way;
    /// [`Error::DeviceLost`] or [`Error::Driver`] from the device.
    pub async fn submit(&mut self, pictures: &[&Inputs<'_>]) -> Result<()> {
        let start = Instant::now();
        let program = self.program.clone();
        let gpu = &program.gpu;
        gpu.device.check_lost()?;
        if self.in_flight.is_some() {
            return Err(Error::tensor("run", "slot", "one without a run", "a run under way"));
        }
        if pictures.is_empty() || pictures.len() > program.batch as usize {
            let expected = format!("1 to {}", program.batch);
            return Err(Error::tensor("run", "pictures", expected, pictures.len()));
        }
        for inputs in pictures {
            self.check(inputs)?;
        }
        let submitted = gpu.device.scoped("running the network", || {
            self.settle();
            self.fill();
            for (picture, inputs) in (0..program.batch).zip(pictures.iter().cycle()) {
                for (id, value) in *inputs {
                    self.give(program.names[id], picture, value);
                }
            }
            self.bind();
            let bytes = self.staging_bytes;
            let staging = self.staging.get_or_insert_with(|| staging(gpu, bytes)).clone();
            let submission = gpu.device.submit(Some(self.encode(&staging)));
            // From here on, also for who gives this future up before the device says whether it objects.
            self.in_flight = Some(gpu.device.land(&staging, bytes, submission, start));
            Ok(())
        });
        submitted.await.inspect_err(|_| self.forget())
    }

    /// After a submit that failed: what was made for it may be as invalid as what the driver objected
    /// to, and a map that is still pending would make every later submit fail.
    fn forget(&mut self) {
        self.in_flight = None;
        self.arena.clear();
        self.groups.fill(None);
        self.given.clear();
        self.give_staging_up();
    }

    /// Takes what the arena holds, which another program's run may have made grow.
    fn settle(&mut self) {
        let program = &self.program;
        let storage = self.arena.storage(&program.gpu, &program.storage, program.guard());
        if storage != self.storage {
            self.storage = storage;
            self.groups.fill(None);
        }
    }

    /// Gives the staging buffer back to the device. That it was not mapped, because the run or the map
    /// failed, has been told already.
    fn unmap(&self) {
        if let Some(staging) = &self.staging {
            self.program.gpu.device.unheard(|| staging.unmap());
        }
    }

    /// After a run that failed the next one takes another staging buffer: wgpu 30 keeps a map that was
    /// given up with its submission, and when that ends, answers the buffer's next map, which is that of
    /// a run still under way (`Buffer::map` of wgpu-core knows the buffer and not the map).
    fn give_staging_up(&mut self) {
        self.unmap();
        self.staging = None;
    }

    fn check(&self, inputs: &Inputs) -> Result<()> {
        let program = &self.program;
        for (id, place) in &program.names {
            let info = &program.tensors[place.0];
            let Role::Input(extent) = info.role else { continue };
            let given = inputs.iter().find(|(i, _)| i == id).map(|(_, v)| v.spec());
            extent.check("run", &info.name, &info.spec, given)?;
        }
        let is_input = |id: &TensorId| {
            let place = program.names.get(id);
            place.is_some_and(|p| matches!(program.tensors[p.0].role, Role::Input(_)))
        };
        match inputs.iter().find(|(id, _)| !is_input(id)) {
            Some((id, value)) => {
                Err(Error::tensor("run", &format!("{}", id.0), "an input", value.spec()))
            }
            None => Ok(()),
        }
    }

    /// Writes an input of a picture.
    fn give(&mut self, id: TensorId, picture: u32, value: &Value) {
        let program = self.program.clone();
        match program.places[id.0] {
            Some(Place::Given(number)) => self.give_alone((number, picture), id, value),
            Some(place) => {
                if let Some(Resource::Buffer(buffer)) = self.resource(place, picture) {
                    let offset = u64::from(picture) * program.tensors[id.0].stride;
                    program.gpu.device.write(&buffer, offset, value.bytes());
                }
            }
            // Nothing reads it.
            None => {}
        }
    }

    /// Writes an input of a size of its own, in a larger buffer if it needs one.
    fn give_alone(&mut self, at: (usize, u32), id: TensorId, value: &Value) {
        let program = self.program.clone();
        let gpu = &program.gpu;
        let bytes = value.bytes().len().max(4) as u64;
        let guard = program.guard();
        let Some(buffer) = self.arena.given(gpu, at, bytes + guard) else { return };
        if self.given.insert(at, buffer.clone()).as_ref() != Some(&buffer) {
            // Whoever binds it binds anew.
            for (group, step) in self.groups.iter_mut().zip(&program.steps) {
                let Step::Dispatch { bound, .. } = step else { continue };
                if bound.iter().any(|b| matches!(b.place, Place::Given(number) if number == at.0)) {
                    *group = None;
                }
            }
        }
        gpu.device.write(&buffer, 0, value.bytes());
        if guard > 0 {
            let words = (bytes / 4..buffer.size() / 4).map(|at| at as usize);
            let poison: Vec<u32> = words.map(|at| self.poison.word(id, at)).collect();
            gpu.device.write(&buffer, bytes, bytemuck::cast_slice(&poison));
        }
    }

    /// Fills what is guarded with poison.
    fn fill(&self) {
        if !self.program.options.guard {
            return;
        }
        let gpu = &self.program.gpu;
        for (index, info) in self.program.tensors.iter().enumerate() {
            let Some(place) = self.program.places[index] else { continue };
            let word = |at: usize| self.poison.word(TensorId(index), at);
            match (place, self.resource(place, 0)) {
                (Place::Given(_), _) | (_, None) => {}
                (Place::Fixed(_), Some(Resource::Texture(..))) => {}
                (place, Some(Resource::Buffer(buffer))) => {
                    let guard = buffer.size() - GUARD_BYTES;
                    let first = if matches!(place, Place::Fixed(_)) { guard } else { 0 };
                    let words = (first / 4) as usize..(buffer.size() / 4) as usize;
                    let poison: Vec<u32> = words.map(word).collect();
                    gpu.device.write(&buffer, first, bytemuck::cast_slice(&poison));
                }
                (_, Some(Resource::Texture(texture, _))) => {
                    let texels = texture.width() as usize * texture.height() as usize;
                    let bytes = texels * info.precision.texel_bytes() as usize;
                    let poison: Vec<u32> = (0..bytes / 4).map(word).collect();
                    gpu.device.write_texture(&texture, bytemuck::cast_slice(&poison));
                }
            }
        }
    }

    /// What holds a tensor, of a picture where each has its own.
    fn resource(&self, place: Place, picture: u32) -> Option<Resource> {
        match place {
            Place::Fixed(at) => self.program.fixed.get(at).cloned(),
            Place::Slot(at) => self.storage.get(at).cloned(),
            Place::Given(number) => {
                self.given.get(&(number, picture)).cloned().map(Resource::Buffer)
            }
        }
    }

    /// Makes the bind groups that are missing.
    fn bind(&mut self) {
        let program = self.program.clone();
        for (index, step) in program.steps.iter().enumerate() {
            let Step::Dispatch { pipeline, bound, uniform, picture, .. } = step else { continue };
            if self.groups[index].is_some() {
                continue;
            }
            let resources: Vec<Option<Resource>> =
                bound.iter().map(|b| self.resource(b.place, picture.unwrap_or(0))).collect();
            let mut entries = Vec::with_capacity(bound.len() + 1);
            for (bound, resource) in bound.iter().zip(&resources) {
                let resource = match resource {
                    Some(Resource::Buffer(buffer)) => {
                        let (offset, size) = match bound.part {
                            Some((offset, bytes)) => (offset, std::num::NonZeroU64::new(bytes)),
                            None => (0, None),
                        };
                        let buffer = wgpu::BufferBinding { buffer, offset, size };
                        wgpu::BindingResource::Buffer(buffer)
                    }
                    Some(Resource::Texture(_, view)) => wgpu::BindingResource::TextureView(view),
                    None => continue,
                };
                entries.push(wgpu::BindGroupEntry { binding: bound.binding, resource });
            }
            if let Some((binding, offset, bytes)) = uniform {
                entries.push(wgpu::BindGroupEntry {
                    binding: *binding,
                    resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &program.uniforms,
                        offset: *offset,
                        size: std::num::NonZeroU64::new(*bytes),
                    }),
                });
            }
            if program.gpu.device.fault(Call::BindGroup) == Some(Fault::Invalid) {
                entries.clear();
            }
            let group = program.gpu.device.handle.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(&pipeline.label),
                layout: &pipeline.layout,
                entries: &entries,
            });
            self.groups[index] = Some(group);
        }
    }

    fn encode(&self, staging: &wgpu::Buffer) -> wgpu::CommandBuffer {
        let program = &self.program;
        let mut encoder = program.gpu.device.handle.create_command_encoder(&Default::default());
        for (index, (_, range)) in program.stages.iter().enumerate() {
            // Passes end at copies, and where each command is timed.
            let apart = program.options.profile == Profile::Commands;
            let is_copy = |at: usize| matches!(program.steps[at], Step::Copy { .. });
            let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
            for at in range.clone() {
                match runs.last_mut() {
                    Some(run) if !apart && !is_copy(at) && !is_copy(run.start) => run.end = at + 1,
                    _ => runs.push(at..at + 1),
                }
            }
            let passes: Vec<usize> = (0..runs.len()).filter(|r| !is_copy(runs[*r].start)).collect();
            for (r, run) in runs.iter().enumerate() {
                let (first, last) = match program.options.profile {
                    Profile::Off => (None, None),
                    Profile::Commands => {
                        let at = run.start as u32 * 2;
                        (Some(at), Some(at + 1))
                    }
                    Profile::Stages => {
                        let at = index as u32 * 2;
                        let ends = |end: Option<&usize>| end == Some(&r);
                        (ends(passes.first()).then_some(at), ends(passes.last()).then_some(at + 1))
                    }
                };
                if let Step::Copy { from, to, width, height, row_bytes } = &program.steps[run.start]
                {
                    // Not every adapter has timestamps between passes: those of a copy are written by an
                    // empty one before it, and one behind it.
                    if apart {
                        self.begin_pass(&mut encoder, first, None);
                    }
                    self.copy(&mut encoder, (*from, *to), (*width, *height), *row_bytes);
                    if apart {
                        self.begin_pass(&mut encoder, None, last);
                    }
                    continue;
                }
                let mut pass = self.begin_pass(&mut encoder, first, last);
                for at in run.clone() {
                    self.dispatch(&mut pass, at);
                }
            }
        }
        self.read_back(&mut encoder, staging);
        encoder.finish()
    }

    /// Begins a pass that writes these timestamps.
    fn begin_pass<'a>(
        &self,
        encoder: &'a mut wgpu::CommandEncoder,
        first: Option<u32>,
        last: Option<u32>,
    ) -> wgpu::ComputePass<'a> {
        let timed = self.timestamps.as_ref().filter(|_| first.is_some() || last.is_some());
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: timed.map(|t| wgpu::ComputePassTimestampWrites {
                query_set: &t.set,
                beginning_of_pass_write_index: first,
                end_of_pass_write_index: last,
            }),
        })
    }

    fn dispatch(&self, pass: &mut wgpu::ComputePass, at: usize) {
        let Step::Dispatch { pipeline, grid, .. } = &self.program.steps[at] else { return };
        pass.set_pipeline(&pipeline.pipeline);
        pass.set_bind_group(0, self.groups[at].as_ref(), &[]);
        match grid {
            StepGrid::Direct([x, y, z]) => pass.dispatch_workgroups(*x, *y, *z),
            StepGrid::Indirect(place, offset) => {
                if let Some(Resource::Buffer(buffer)) = self.resource(*place, 0) {
                    pass.dispatch_workgroups_indirect(&buffer, *offset);
                }
            }
        }
    }

    fn copy(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (from, to): (Place, Place),
        (width, height): (u32, u32),
        row_bytes: u32,
    ) {
        let (from, to) = (self.resource(from, 0), self.resource(to, 0));
        let (Some(Resource::Buffer(from)), Some(Resource::Texture(to, _))) = (from, to) else {
            return;
        };
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row_bytes),
            rows_per_image: Some(height),
        };
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let from = wgpu::TexelCopyBufferInfo { buffer: &from, layout };
        encoder.copy_buffer_to_texture(from, to.as_image_copy(), size);
    }

    fn read_back(&self, encoder: &mut wgpu::CommandEncoder, staging: &wgpu::Buffer) {
        let program = &self.program;
        let guard = program.guard();
        for output in &program.outputs {
            let Storage::Buffer { bytes } = program.tensors[output.tensor.0].storage else {
                continue;
            };
            let Some(Resource::Buffer(buffer)) = self.resource(output.place, 0) else { continue };
            encoder.copy_buffer_to_buffer(&buffer, 0, staging, output.offset, bytes + guard);
        }
        if let Some(t) = &self.timestamps {
            encoder.resolve_query_set(&t.set, 0..(t.resolve.size() / 8) as u32, &t.resolve, 0);
            encoder.copy_buffer_to_buffer(&t.resolve, 0, staging, t.offset, t.resolve.size());
        }
    }

    /// Waits for the run that was submitted, and reads its outputs. After [`Error::Timeout`] the run
    /// is still under way, and [`Slot::recover`] waits for its end.
    ///
    /// # Errors
    /// [`Error::Tensor`] if none was submitted; [`Error::DeviceLost`], [`Error::Timeout`] or
    /// [`Error::Driver`] from the device.
    pub async fn receive(&mut self, deadline: Deadline) -> Result<RunOutput> {
        let none = || Error::tensor("run", "slot", "a run under way", "none");
        // Until the wait is over the run is under way, also for who gives this future up.
        let landing = self.in_flight.clone().ok_or_else(none)?;
        let gpu = self.program.gpu.clone();
        if let Err(e) = gpu.device.wait_for(&landing, deadline, "the network").await {
            if !matches!(e, Error::Timeout { .. }) {
                self.in_flight = None;
                self.give_staging_up();
            }
            return Err(e);
        }
        self.in_flight = None;
        let output = self.read(&landing);
        match &output {
            Err(Error::Driver { .. }) => {
                self.give_staging_up();
                // A device may be lost after the map.
                gpu.device.check_alive().await?;
            }
            _ => self.unmap(),
        }
        output
    }

    fn read(&self, landing: &Landing) -> Result<RunOutput> {
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

fn staging(gpu: &Gpu, bytes: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(wgpu::BufferDescriptor {
        label: Some("staging"),
        size: bytes,
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
