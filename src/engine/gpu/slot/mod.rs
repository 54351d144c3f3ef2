//! A [`Slot`]: what one run of a program needs for itself, so that several can be in flight.

mod encode;
mod output;

use std::collections::HashMap;
use std::sync::Arc;
use std::task::Waker;

use web_time::Instant;

use crate::engine::gpu::arena::Arena;
use crate::engine::gpu::context::Gpu;
use crate::engine::gpu::deadline::Deadline;
use crate::engine::gpu::landing::Landing;
use crate::engine::gpu::memory::Resource;
use crate::engine::gpu::poison::Poison;
use crate::engine::gpu::program::{GUARD_BYTES, Place, Profile, Program, ProgramOptions, Step};
use crate::engine::graph::{Graph, TensorId};
use crate::engine::kernels::Role;
use crate::engine::lower::{KernelChoice, Request, lower};
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

pub use output::RunOutput;

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
}

fn staging(gpu: &Gpu, bytes: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(wgpu::BufferDescriptor {
        label: Some("staging"),
        size: bytes,
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
