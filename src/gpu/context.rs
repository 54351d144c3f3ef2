//! The device: choosing an adapter, opening it, compiling shaders, noticing its loss.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::time::Duration;

use crate::error::{Error, Result};
use crate::gpu::faults::{Call, Fault, Faults};
use crate::gpu::native::{self, Clock, Loss, Poller};
use crate::gpu::program::Resource;
use crate::kernels::{Caps, Command, Dispatch, MAX_WORKGROUPS, Recording, Storage};
use crate::lock::lock;
use crate::precision::Precision;
use crate::shader::{self, BindingKind, Variant};

/// Which adapter to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The fastest kind: discrete, integrated, virtual, then software.
    #[default]
    Auto,
    /// The same without software adapters.
    Hardware,
    /// Position in the list that [`adapters`] returns; past its end, part of a name ("4090").
    Index(usize),
    /// Part of the adapter's name, in any case.
    Name(String),
}

impl std::fmt::Display for AdapterChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Hardware => f.write_str("a hardware adapter"),
            Self::Index(i) => write!(f, "{i}"),
            Self::Name(n) => f.write_str(n),
        }
    }
}

/// How to open a device.
#[derive(Clone, Debug)]
pub struct GpuOptions {
    /// Which adapter.
    pub adapter: AdapterChoice,
    /// Longest wait for one run.
    pub timeout: Duration,
    /// Let wgpu add bounds checks to the shaders. They are written to stay in bounds, and tests
    /// with sentinels behind every buffer hold them to it, so this is off by default: it costs up
    /// to 1.7 times the run time on a software adapter.
    pub checked: bool,
    /// For tests: calls to the device that fail.
    #[doc(hidden)]
    pub faults: Option<Faults>,
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self {
            adapter: AdapterChoice::Auto,
            timeout: Duration::from_secs(120),
            checked: false,
            faults: None,
        }
    }
}

/// What is known of an adapter without opening it.
#[derive(Clone, Debug)]
pub struct AdapterReport {
    /// Name, backend, driver, kind.
    pub info: wgpu::AdapterInfo,
    /// What it offers.
    pub limits: wgpu::Limits,
    /// What it offers beside the core of WebGPU.
    pub features: wgpu::Features,
    /// What it lacks of the limits the shaders need, as `limit: required N, actual M`.
    pub lacks: Vec<String>,
}

/// Longest wait for the work under way when a device is closed, if its own limit is not longer.
const LAST_WAIT: Duration = Duration::from_secs(10);
/// The same on the host's own cores, whose work always ends: the process crashes if it ends first.
const LAST_SOFTWARE_WAIT: Duration = Duration::from_secs(120);

/// Bytes of weights that may wait to be uploaded, and that are passed on at a time.
const UPLOAD_BYTES: usize = 8 << 20;

/// What a binding of a shader that runs no workgroups holds: as much as its types have at least.
const WARM_BYTES: u64 = 16 << 10;

/// Shader, how it is read, and entry point.
type PipelineKey = (&'static str, Variant, &'static str);

/// A shader entry point, compiled, with its bindings by name.
#[derive(Debug)]
pub(super) struct Pipeline {
    pub label: String,
    pub pipeline: wgpu::ComputePipeline,
    pub layout: wgpu::BindGroupLayout,
    pub bindings: Vec<(String, u32, BindingKind)>,
    /// Whether it reads how many workgroups there are.
    pub reads_grid: bool,
}

/// An open device with its compiled pipelines. Cheap to share behind an [`Arc`].
#[derive(Debug)]
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    caps: Caps,
    options: GpuOptions,
    loss: Loss,
    /// Whether the device is the caller's, whose handlers hear of its loss and its errors.
    foreign: bool,
    /// Bytes that wait to be uploaded.
    uploads: Mutex<usize>,
    turns: Mutex<()>,
    pub(super) poller: Poller,
    pub(super) clock: Clock,
    /// Another text for one shader file; such a device compiles with bounds checks.
    replacement: Option<shader::Replacement>,
    modules: Mutex<HashMap<(&'static str, Variant), Arc<Module>>>,
    pipelines: Mutex<HashMap<PipelineKey, Arc<Pipeline>>>,
}

#[derive(Debug)]
struct Module {
    module: wgpu::ShaderModule,
    reflection: shader::Reflection,
}

/// What the kernels use, and no more. Of the size of textures and buffers no more is asked than there is:
/// kernels look at what they get.
fn required_limits(adapter: &wgpu::Limits) -> wgpu::Limits {
    let usual = wgpu::Limits::default();
    wgpu::Limits {
        max_texture_dimension_2d: usual
            .max_texture_dimension_2d
            .min(adapter.max_texture_dimension_2d),
        max_storage_buffers_per_shader_stage: STORAGE_BUFFERS,
        max_storage_textures_per_shader_stage: STORAGE_TEXTURES,
        max_uniform_buffers_per_shader_stage: 1,
        max_storage_buffer_binding_size: usual
            .max_storage_buffer_binding_size
            .min(adapter.max_storage_buffer_binding_size),
        max_buffer_size: usual.max_buffer_size.min(adapter.max_buffer_size),
        max_compute_workgroup_storage_size: WORKGROUP_BYTES,
        max_compute_invocations_per_workgroup: INVOCATIONS,
        max_compute_workgroup_size_x: INVOCATIONS,
        max_compute_workgroup_size_y: ROWS,
        max_compute_workgroup_size_z: 1,
        max_compute_workgroups_per_dimension: MAX_WORKGROUPS,
        ..least_limits()
    }
}

/// Storage buffers that an entry point binds at most.
const STORAGE_BUFFERS: u32 = 8;
/// Storage textures that an entry point binds at most.
const STORAGE_TEXTURES: u32 = 2;
/// Bytes of workgroup memory that an entry point uses at most.
const WORKGROUP_BYTES: u32 = 16 << 10;
/// Invocations of the largest workgroups, which lie in x.
const INVOCATIONS: u32 = 256;
/// Invocations of a workgroup in y.
const ROWS: u32 = 8;

/// The least limits that wgpu has a name for, of which nothing but textures of two dimensions is used.
fn least_limits() -> wgpu::Limits {
    wgpu::Limits {
        max_texture_dimension_1d: 0,
        max_texture_dimension_3d: 0,
        max_texture_array_layers: 1,
        max_bind_groups: 1,
        max_bindings_per_bind_group: 16,
        max_dynamic_uniform_buffers_per_pipeline_layout: 0,
        max_sampled_textures_per_shader_stage: 0,
        max_samplers_per_shader_stage: 0,
        max_vertex_buffers: 0,
        max_vertex_attributes: 0,
        max_vertex_buffer_array_stride: 0,
        max_inter_stage_shader_variables: 0,
        max_color_attachments: 0,
        max_color_attachment_bytes_per_sample: 0,
        ..wgpu::Limits::downlevel_webgl2_defaults()
    }
}

/// A side of a texture that is no power of two and holds `texels`: lavapipe (Mesa 22.3) compiles a shader
/// for textures whose sides are, and once more for others.
fn uneven(texels: u32) -> u32 {
    match texels {
        0 => 0,
        1 | 2 => 3,
        more => more + u32::from(more.is_power_of_two()),
    }
}

/// What kernels may count on.
fn caps(info: &wgpu::AdapterInfo, features: wgpu::Features, limits: &wgpu::Limits) -> Caps {
    let sizes = (info.subgroup_min_size, info.subgroup_max_size);
    let one_size = sizes.0 == sizes.1 && features.contains(wgpu::Features::SUBGROUP);
    Caps {
        subgroup: Some(sizes.0).filter(|_| one_size),
        // `uneven` may add one.
        texture_side: limits.max_texture_dimension_2d.saturating_sub(1),
        buffer_bytes: limits.max_storage_buffer_binding_size,
    }
}

/// Features that kernels use where an adapter has them.
fn wanted_features() -> wgpu::Features {
    wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::SUBGROUP
}

/// The process's one instance. It is never dropped: with the last one the Vulkan loader unloads the
/// driver, and what lavapipe leaves to be called at the process's end is then no longer there, which
/// ended one in twenty programs that stopped soon after their device.
fn instance() -> &'static wgpu::Instance {
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        let mut desc = wgpu::InstanceDescriptor::new_without_display_handle();
        desc.backends = wgpu::Backends::PRIMARY;
        // wgpu need not look at every indirect grid once more on the device: `indirect_grid` keeps to
        // the limits whatever the count, and nothing that is dispatched so reads how many workgroups
        // there are. `Program` refuses what does, and a test of `crate::lower` looks at every kernel.
        desc.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
        wgpu::Instance::new(desc)
    })
}

fn rank(info: &wgpu::AdapterInfo) -> u8 {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Cpu => 3,
        wgpu::DeviceType::Other => 4,
    }
}

async fn list() -> Vec<wgpu::Adapter> {
    let mut found = instance().enumerate_adapters(wgpu::Backends::PRIMARY).await;
    found.sort_by_key(|a| rank(&a.get_info()));
    found
}

/// The first adapter whose name has this part; a blank is a part of none.
fn named<'a>(found: &'a [wgpu::Adapter], part: &str) -> Option<&'a wgpu::Adapter> {
    let part = part.trim().to_lowercase();
    if part.is_empty() {
        return None;
    }
    found.iter().find(|a| a.get_info().name.to_lowercase().contains(&part))
}

fn lacks(limits: &wgpu::Limits) -> Vec<String> {
    let mut lacks = Vec::new();
    required_limits(limits).check_limits_with_fail_fn(limits, false, |name, required, actual| {
        lacks.push(format!("{name}: required {required}, actual {actual}"));
    });
    lacks
}

/// All adapters, best first; a position in this list is an [`AdapterChoice::Index`].
pub async fn adapters() -> Vec<AdapterReport> {
    list()
        .await
        .iter()
        .map(|a| AdapterReport {
            info: a.get_info(),
            limits: a.limits(),
            features: a.features(),
            lacks: lacks(&a.limits()),
        })
        .collect()
}

impl Gpu {
    /// Opens the device that `options` ask for, with the limits that the kernels need and no more.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if none matches, or with [`AdapterChoice::Auto`] none gives the limits;
    /// [`Error::Device`] if the chosen one cannot give them.
    pub async fn open(options: GpuOptions) -> Result<Arc<Self>> {
        let found = list().await;
        let describe = |a: &wgpu::Adapter| match &lacks(&a.limits())[..] {
            [] => a.get_info().name,
            lacks => format!("{} (lacks {})", a.get_info().name, lacks.join("; ")),
        };
        let none = || Error::NoAdapter {
            wanted: options.adapter.to_string(),
            found: match found.is_empty() {
                true => "none was found".into(),
                false => {
                    let all = found.iter().map(describe).enumerate();
                    let all: Vec<_> = all.map(|(i, name)| format!("{i}: {name}")).collect();
                    format!("found {}", all.join(", "))
                }
            },
        };
        let adapter = match &options.adapter {
            AdapterChoice::Auto => found.iter().find(|a| lacks(&a.limits()).is_empty()),
            AdapterChoice::Hardware => found.iter().find(|a| {
                let software = a.get_info().device_type == wgpu::DeviceType::Cpu;
                !software && lacks(&a.limits()).is_empty()
            }),
            AdapterChoice::Index(i) => found.get(*i).or_else(|| named(&found, &i.to_string())),
            AdapterChoice::Name(part) => named(&found, part),
        }
        .ok_or_else(none)?;
        let info = adapter.get_info();
        let refused = |message: String| Error::Device { adapter: info.name.clone(), message };
        let missing = lacks(&adapter.limits());
        if !missing.is_empty() {
            return Err(refused(missing.join("; ")));
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("smr-gpu"),
            required_features: adapter.features() & wanted_features(),
            required_limits: required_limits(&adapter.limits()),
            ..Default::default()
        };
        let (device, queue) =
            adapter.request_device(&descriptor).await.map_err(|e| refused(e.to_string()))?;
        let loss = Loss::default();
        let told = loss.clone();
        device.set_device_lost_callback(move |reason, message| {
            told.tell(format!("{reason:?}: {message}"));
        });
        // Every call of this crate is within a scope, so an error that none caught is no run's and
        // fails none; without a handler it would end the process.
        let faults = options.faults.clone();
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            if let Some(faults) = &faults {
                faults.stray(e.to_string());
            }
        }));
        Ok(Self::with(device, queue, options, loss, false, None))
    }

    /// Takes a device that a program has already, for runs of at most `timeout`. Its handlers stay what
    /// they are: they hear of its loss and of the program's own errors, and this crate's errors come
    /// back from its calls. A device that is lost is not replaced. Work that is under way when this is
    /// dropped is the program's to wait for, before its process ends on a software adapter.
    ///
    /// Whoever polls the device runs this crate's callbacks, and the other way round.
    ///
    /// # Errors
    /// [`Error::Device`] with the limits, as `limit: required N, actual M`, that the device was not
    /// opened with: [`wgpu::Limits::default`] has them all.
    ///
    /// ```
    /// use smr_gpu::gpu::{Gpu, wgpu};
    /// use smr_gpu::{Config, GpuDetector};
    /// use std::time::Duration;
    ///
    /// async fn detector(device: wgpu::Device, queue: wgpu::Queue) -> smr_gpu::Result<GpuDetector> {
    ///     let gpu = Gpu::from_device(device, queue, Duration::from_secs(10))?;
    ///     GpuDetector::on_device(gpu, Config::new("weights/smrnet.safetensors")).await
    /// }
    /// ```
    pub fn from_device(
        device: wgpu::Device,
        queue: wgpu::Queue,
        timeout: Duration,
    ) -> Result<Arc<Self>> {
        let missing = lacks(&device.limits());
        if !missing.is_empty() {
            let adapter = device.adapter_info().name;
            return Err(Error::Device { adapter, message: missing.join("; ") });
        }
        let options = GpuOptions { timeout, ..GpuOptions::default() };
        Ok(Self::with(device, queue, options, Loss::default(), true, None))
    }

    fn with(
        device: wgpu::Device,
        queue: wgpu::Queue,
        options: GpuOptions,
        loss: Loss,
        foreign: bool,
        replacement: Option<shader::Replacement>,
    ) -> Arc<Self> {
        let info = device.adapter_info();
        Arc::new(Self {
            poller: Poller::new(&device, &loss),
            caps: caps(&info, device.features(), &device.limits()),
            device,
            queue,
            info,
            options,
            loss,
            foreign,
            uploads: Mutex::default(),
            turns: Mutex::default(),
            clock: Clock::default(),
            replacement,
            modules: Mutex::default(),
            pipelines: Mutex::default(),
        })
    }

    /// The same device with another text for one shader file: for tests that ask what a fault in a
    /// shader would change, and for trying out a shader. Nothing vouches for that text, so this
    /// device compiles every shader with bounds checks, whatever its options say.
    pub fn with_replacement(&self, replacement: shader::Replacement) -> Arc<Self> {
        let options = GpuOptions { checked: true, ..self.options.clone() };
        let (device, queue) = (self.device.clone(), self.queue.clone());
        let loss = self.loss.clone();
        Self::with(device, queue, options, loss, self.foreign, Some(replacement))
    }

    /// The adapter's name, backend and driver.
    pub fn info(&self) -> &wgpu::AdapterInfo {
        &self.info
    }

    /// What kernels may count on.
    pub fn caps(&self) -> &Caps {
        &self.caps
    }

    /// Whether stages can be timed on the device.
    pub fn has_timestamps(&self) -> bool {
        self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// The longest wait for one run.
    pub fn timeout(&self) -> Duration {
        self.options.timeout
    }

    /// Destroys the device, as a driver reset would: every later run returns
    /// [`Error::DeviceLost`].
    pub fn destroy(&self) {
        self.device.destroy();
    }

    /// What a test wants of this call.
    pub(super) fn fault(&self, call: Call) -> Option<Fault> {
        let fault = self.options.faults.as_ref()?.next(call);
        if fault == Some(Fault::Lost) {
            self.device.destroy();
        }
        fault
    }

    /// # Errors
    /// [`Error::DeviceLost`] once the driver has reported the loss.
    pub(super) fn check_lost(&self) -> Result<()> {
        self.loss.get().map_or(Ok(()), |message| Err(Error::DeviceLost(message)))
    }

    /// Asks whether the device still is.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] if it is gone.
    pub(super) fn check_alive(&self) -> Result<()> {
        // It has the driver's own words, if there are any.
        {
            let _turn = self.turn();
            let _ = native::poll(&self.device, wgpu::PollType::Poll, &self.loss);
        }
        self.check_lost()?;
        native::look(&self.device, &self.loss);
        self.check_lost()
    }

    /// Does `work`, whose errors are told elsewhere.
    pub(super) fn unheard(&self, work: impl FnOnce()) {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        work();
        drop(validation.pop());
        drop(internal.pop());
        drop(memory.pop());
    }

    /// Runs `work` and returns what the driver objected to, under the name `stage`.
    pub(super) async fn scoped<T>(
        &self,
        stage: &str,
        work: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let result = work();
        // All three leave the stack before the first wait: the guards are not `Send`.
        let pops = (validation.pop(), internal.pop(), memory.pop());
        let errors = [pops.0.await, pops.1.await, pops.2.await];
        let told = errors.into_iter().flatten().map(|e| e.to_string()).next();
        let told = told.or_else(|| self.options.faults.as_ref()?.take());
        if told.is_some() {
            // What a lost device was given is no good for what follows.
            self.check_alive()?;
        }
        self.check_lost()?;
        match told {
            Some(message) => Err(Error::Driver { stage: stage.into(), message }),
            None => result,
        }
    }

    /// Makes a buffer.
    pub(super) fn create_buffer(&self, mut desc: wgpu::BufferDescriptor) -> wgpu::Buffer {
        if self.fault(Call::Buffer) == Some(Fault::Invalid) {
            desc.usage = wgpu::BufferUsages::empty();
        }
        self.device.create_buffer(&desc)
    }

    /// Writes to a buffer before the next submission.
    pub(super) fn write(&self, buffer: &wgpu::Buffer, mut offset: u64, bytes: &[u8]) {
        if self.fault(Call::Write) == Some(Fault::Invalid) {
            offset = buffer.size();
        }
        let _turn = self.turn();
        self.queue.write_buffer(buffer, offset, bytes);
    }

    /// What is held by who gives the queue something, and by who polls without waiting. Once a device is lost,
    /// wgpu-core 30 gives its resources back in a poll, and takes its locks in another order there than a
    /// write does: on two threads at a time they would wait for each other for ever.
    fn turn(&self) -> MutexGuard<'_, ()> {
        lock(&self.turns)
    }

    /// Waits for what was submitted.
    fn wait(&self) {
        let done = Arc::new(AtomicBool::new(false));
        let told = done.clone();
        {
            let _turn = self.turn();
            self.queue.on_submitted_work_done(move || told.store(true, Ordering::Release));
        }
        native::wait(&self.device, &self.loss, &self.turns, &done, self.options.timeout);
    }

    /// Submits commands, or only what was written.
    pub(super) fn submit(&self, commands: Option<wgpu::CommandBuffer>) -> wgpu::SubmissionIndex {
        let invalid = (self.fault(Call::Submit) == Some(Fault::Invalid)).then(|| {
            let mut encoder = self.device.create_command_encoder(&Default::default());
            encoder.push_debug_group("never popped");
            encoder.finish()
        });
        let _turn = self.turn();
        self.queue.submit(commands.into_iter().chain(invalid))
    }

    /// Creates what holds a tensor. Behind a buffer lie `guard` bytes more.
    pub(super) fn create(&self, storage: Storage, guard: u64) -> Resource {
        match storage {
            Storage::Buffer { bytes } => {
                Resource::Buffer(self.create_buffer(wgpu::BufferDescriptor {
                    label: None,
                    size: bytes.next_multiple_of(4) + guard,
                    usage: wgpu::BufferUsages::STORAGE
                        | wgpu::BufferUsages::INDIRECT
                        | wgpu::BufferUsages::COPY_SRC
                        | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                }))
            }
            Storage::Texture { width, height, precision } => {
                let (mut width, height) = (uneven(width), uneven(height));
                if self.fault(Call::Texture) == Some(Fault::Invalid) {
                    width = 0;
                }
                let texture = self.create_texture(width, height, precision);
                let view = texture.create_view(&Default::default());
                Resource::Texture(texture, view)
            }
        }
    }

    fn create_texture(&self, width: u32, height: u32, precision: Precision) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: texture_format(precision),
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    }

    /// Fills a texture.
    pub(super) fn write_texture(&self, texture: &wgpu::Texture, bytes: &[u8]) {
        self.write_rows(texture, texture.width(), 0, bytes);
    }

    /// Writes rows of `width` texels to a texture, from row `first` on.
    fn write_rows(&self, texture: &wgpu::Texture, width: u32, first: u32, bytes: &[u8]) {
        let row = row_bytes(texture, width);
        let height = (bytes.len() / row.max(1) as usize) as u32;
        let refused = self.fault(Call::Write) == Some(Fault::Invalid);
        let bytes = if refused { &[] } else { bytes };
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row),
            rows_per_image: Some(height),
        };
        let to = wgpu::TexelCopyTextureInfo {
            origin: wgpu::Origin3d { x: 0, y: first, z: 0 },
            ..texture.as_image_copy()
        };
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let _turn = self.turn();
        self.queue.write_texture(to, bytes, layout, size);
    }

    /// Writes a constant to the front of a buffer, a part at a time: what waits to be uploaded takes as
    /// much memory again.
    pub(super) fn upload(&self, buffer: &wgpu::Buffer, bytes: &[u8]) {
        for (index, part) in bytes.chunks(UPLOAD_BYTES).enumerate() {
            self.write(buffer, (index * UPLOAD_BYTES) as u64, part);
            self.pass_uploads_on(part.len());
        }
    }

    /// The same for rows of `width` texels of a texture, some rows at a time.
    pub(super) fn upload_texture(&self, texture: &wgpu::Texture, width: u32, bytes: &[u8]) {
        let row = (row_bytes(texture, width) as usize).max(1);
        let rows = (UPLOAD_BYTES / row).max(1);
        for (index, part) in bytes.chunks(rows * row).enumerate() {
            self.write_rows(texture, width, (index * rows) as u32, part);
            self.pass_uploads_on(part.len());
        }
    }

    /// Counts `bytes` that wait to be uploaded, and passes them on before they are many.
    fn pass_uploads_on(&self, bytes: usize) {
        let mut waiting = lock(&self.uploads);
        *waiting += bytes;
        if *waiting >= UPLOAD_BYTES {
            *waiting = 0;
            // A device that is lost or late says so when the program first runs.
            self.submit(None);
            self.wait();
        }
    }

    fn module(&self, shader: &'static shader::Shader, variant: &Variant) -> Result<Arc<Module>> {
        let key = (shader.stem, variant.clone());
        let mut modules = lock(&self.modules);
        if let Some(module) = modules.get(&key) {
            return Ok(module.clone());
        }
        let reflection = shader::reflect_with(shader, variant, self.replacement.as_ref())?;
        let desc = wgpu::ShaderModuleDescriptor {
            label: Some(shader.stem),
            source: wgpu::ShaderSource::Wgsl(reflection.text.as_str().into()),
        };
        let module = if self.options.checked {
            self.device.create_shader_module(desc)
        } else {
            // SAFETY: the shaders are this crate's own; each index is below the sizes in its
            // `Params`, which `record` takes from the bound tensors, every loop is bounded by
            // those sizes, and the tests run each with sentinels behind every buffer.
            unsafe {
                self.device
                    .create_shader_module_trusted(desc, wgpu::ShaderRuntimeChecks::unchecked())
            }
        };
        let module = Arc::new(Module { module, reflection });
        modules.insert(key, module.clone());
        Ok(module)
    }

    /// Compiles what the dispatches of `recording` need and is not compiled yet, on all cores, while
    /// this thread does `meanwhile`.
    pub(super) fn compile<T>(
        &self,
        recording: &Recording,
        meanwhile: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let mut wanted: HashMap<PipelineKey, &Dispatch> = HashMap::new();
        for command in recording.commands() {
            if let Command::Dispatch(dispatch) = command {
                let key = (dispatch.shader.stem, dispatch.variant.clone(), dispatch.entry);
                wanted.entry(key).or_insert(dispatch);
            }
        }
        let known = lock(&self.pipelines);
        wanted.retain(|key, _| !known.contains_key(key));
        drop(known);
        // Several entries of a module next to each other wait for it together.
        let mut wanted: Vec<_> = wanted.into_iter().collect();
        wanted.sort_by(|a, b| (a.0.2, &a.0).cmp(&(b.0.2, &b.0)));
        let next = AtomicUsize::new(0);
        let compile = || -> Result<()> {
            while let Some((_, dispatch)) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
                let pipeline = self.pipeline(dispatch)?;
                if self.info.device_type == wgpu::DeviceType::Cpu {
                    self.warm(&pipeline, &dispatch.params);
                }
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            let threads = cores.min(wanted.len());
            let threads: Vec<_> = (0..threads).map(|_| scope.spawn(compile)).collect();
            let result = meanwhile();
            for thread in threads {
                match thread.join() {
                    Ok(compiled) => compiled?,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            result
        })
    }

    /// The pipeline for a dispatch, compiled on first use.
    pub(super) fn pipeline(&self, dispatch: &Dispatch) -> Result<Arc<Pipeline>> {
        let shader = dispatch.shader;
        let key = (shader.stem, dispatch.variant.clone(), dispatch.entry);
        let known = |key: &PipelineKey| lock(&self.pipelines).get(key).cloned();
        if let Some(pipeline) = known(&key) {
            return Ok(pipeline);
        }
        let label = format!("{}::{} {}", shader.stem, dispatch.entry, dispatch.variant);
        let label = label.trim_end();
        // What the driver objects to is told to the thread that asked, and kept for nobody.
        let build = || self.build_pipeline(dispatch, label);
        let built = pollster::block_on(self.scoped(&format!("compiling {label}"), build));
        let pipeline = built.inspect_err(|_| {
            let key = (shader.stem, dispatch.variant.clone());
            lock(&self.modules).remove(&key);
        })?;
        let mut pipelines = lock(&self.pipelines);
        Ok(pipelines.entry(key).or_insert(Arc::new(pipeline)).clone())
    }

    /// Runs no workgroups of a pipeline: lavapipe makes machine code at the first dispatch, one pipeline
    /// after the other, and so it does while weights are read. What goes wrong is told by the first run.
    fn warm(&self, pipeline: &Pipeline, params: &[u8]) {
        let buffer = |usage| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("warm"),
                size: WARM_BYTES.max(params.len() as u64).next_multiple_of(4),
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        self.unheard(|| {
            let views = [Precision::F32, Precision::F16].map(|precision| {
                let texture = self.create_texture(uneven(1), uneven(1), precision);
                texture.create_view(&Default::default())
            });
            let uniform = buffer(wgpu::BufferUsages::UNIFORM);
            let bindings = pipeline.bindings.iter();
            let buffers: Vec<_> = bindings.map(|_| buffer(wgpu::BufferUsages::STORAGE)).collect();
            let entry = |((_, binding, kind), buffer): (&(String, u32, BindingKind), _)| {
                let buffer: &wgpu::Buffer = buffer;
                wgpu::BindGroupEntry {
                    binding: *binding,
                    resource: match kind {
                        BindingKind::Texture(precision) => {
                            let view = &views[usize::from(precision.is_half())];
                            wgpu::BindingResource::TextureView(view)
                        }
                        BindingKind::Uniform => uniform.as_entire_binding(),
                        BindingKind::Read | BindingKind::ReadWrite => buffer.as_entire_binding(),
                    },
                }
            };
            let entries: Vec<_> = pipeline.bindings.iter().zip(&buffers).map(entry).collect();
            let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("warm"),
                layout: &pipeline.layout,
                entries: &entries,
            });
            let mut encoder = self.device.create_command_encoder(&Default::default());
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline.pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(0, 0, 0);
            drop(pass);
            // One at a time: weights are uploaded between them.
            {
                let _turn = self.turn();
                self.queue.write_buffer(&uniform, 0, params);
                self.queue.submit([encoder.finish()]);
            }
            self.wait();
        });
    }

    fn build_pipeline(&self, dispatch: &Dispatch, label: &str) -> Result<Pipeline> {
        let shader = dispatch.shader;
        let module = self.module(shader, &dispatch.variant)?;
        let entry = module.reflection.entries.iter().find(|e| e.name == dispatch.entry);
        let entry = entry.ok_or_else(|| Error::Shader {
            file: format!("{}.wgsl", shader.stem),
            line: 0,
            message: format!("no entry point `{}`", dispatch.entry),
        })?;
        let buffer = |ty| wgpu::BindingType::Buffer {
            ty,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let layout_entries: Vec<_> = entry
            .bindings
            .iter()
            .map(|(_, binding, kind)| wgpu::BindGroupLayoutEntry {
                binding: *binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: match kind {
                    BindingKind::Uniform => buffer(wgpu::BufferBindingType::Uniform),
                    BindingKind::Read => {
                        buffer(wgpu::BufferBindingType::Storage { read_only: true })
                    }
                    BindingKind::ReadWrite => {
                        buffer(wgpu::BufferBindingType::Storage { read_only: false })
                    }
                    BindingKind::Texture(precision) => wgpu::BindingType::StorageTexture {
                        access: wgpu::StorageTextureAccess::ReadOnly,
                        format: texture_format(*precision),
                        view_dimension: wgpu::TextureViewDimension::D2,
                    },
                },
                count: None,
            })
            .collect();
        let layout = self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(label),
            entries: &layout_entries,
        });
        let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(label),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let refused = self.fault(Call::Pipeline) == Some(Fault::Invalid);
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label),
            layout: Some(&pipeline_layout),
            module: &module.module,
            entry_point: Some(if refused { "none" } else { dispatch.entry }),
            compilation_options: wgpu::PipelineCompilationOptions {
                // Every shader writes its workgroup memory before it reads it.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            // Drivers that keep compiled shaders do so without one: docs/rejected.md.
            cache: None,
        });
        let bindings = entry.bindings.clone();
        let reads_grid = entry.reads_grid;
        Ok(Pipeline { label: label.to_owned(), pipeline, layout, bindings, reads_grid })
    }
}

impl Drop for Gpu {
    /// A process that exits while a software driver still works can crash: wait for it, but not for
    /// ever.
    fn drop(&mut self) {
        if self.foreign {
            return;
        }
        let wait = match self.info.device_type {
            wgpu::DeviceType::Cpu => LAST_SOFTWARE_WAIT,
            _ => LAST_WAIT,
        };
        let timeout = self.timeout().max(wait);
        let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(timeout) };
        if let Err(wgpu::PollError::Timeout) = native::poll(&self.device, wait, &self.loss) {
            // To drop the queue would wait without a limit: a device that hangs keeps its own.
            std::mem::forget((self.device.clone(), self.queue.clone()));
        }
    }
}

/// The format of a texture of four channels.
fn texture_format(precision: Precision) -> wgpu::TextureFormat {
    match precision {
        Precision::F32 => wgpu::TextureFormat::Rgba32Float,
        Precision::F16 => wgpu::TextureFormat::Rgba16Float,
    }
}

/// Bytes of `width` texels of a texture of four channels.
fn row_bytes(texture: &wgpu::Texture, width: u32) -> u32 {
    let precision = match texture.format() {
        wgpu::TextureFormat::Rgba16Float => Precision::F16,
        _ => Precision::F32,
    };
    width * precision.texel_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels;

    #[test]
    fn what_is_asked_is_enough_for_every_shader() {
        let sizes = [None, Some(4), Some(8), Some(16), Some(32), Some(64)];
        let mut most = [0; 7];
        for (shader, variant) in sizes
            .into_iter()
            .flat_map(|subgroup| kernels::shaders(&Caps { subgroup, ..Caps::default() }))
        {
            let reflection = shader::reflect(shader, &variant).expect("a shader");
            for entry in reflection.entries {
                let count = |is: fn(&BindingKind) -> bool| {
                    entry.bindings.iter().filter(|b| is(&b.2)).count() as u32
                };
                let [x, y, z] = entry.workgroup_size;
                let used = [
                    count(|kind| matches!(kind, BindingKind::Read | BindingKind::ReadWrite)),
                    count(|kind| matches!(kind, BindingKind::Texture(_))),
                    entry.workgroup_bytes,
                    x * y * z,
                    y,
                    z,
                    count(|kind| *kind == BindingKind::Uniform),
                ];
                most.iter_mut().zip(used).for_each(|(most, used)| *most = used.max(*most));
            }
        }
        let asked = [STORAGE_BUFFERS, STORAGE_TEXTURES, WORKGROUP_BYTES, INVOCATIONS, ROWS, 1, 1];
        let enough = most.iter().zip(asked).all(|(used, asked)| *used <= asked);
        assert!(enough, "used {most:?}, asked {asked:?}");
    }

    /// A Raspberry Pi 4's, of what its Vulkan driver says: of textures, attachments and inputs it has
    /// less than WebGPU's defaults.
    #[test]
    fn an_adapter_with_small_textures_lacks_nothing() {
        let small = wgpu::Limits {
            max_texture_dimension_1d: 4096,
            max_texture_dimension_2d: 4096,
            max_texture_dimension_3d: 2048,
            max_color_attachments: 4,
            max_inter_stage_shader_variables: 15,
            max_storage_textures_per_shader_stage: 4,
            ..wgpu::Limits::default()
        };
        assert!(!wgpu::Limits::default().check_limits(&small));
        assert_eq!(lacks(&small), [""; 0]);
        assert_eq!(required_limits(&small).max_texture_dimension_2d, 4096);
        let one = wgpu::Limits { max_storage_textures_per_shader_stage: 0, ..small };
        let want =
            format!("max_storage_textures_per_shader_stage: required {STORAGE_TEXTURES}, actual 0");
        assert_eq!(lacks(&one), [want]);
    }
}
