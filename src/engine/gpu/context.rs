//! The device: opening it, giving it work, hearing of its errors and of its loss.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use crate::engine::gpu::adapter::{AdapterChoice, caps, lacks, required_limits, wanted_features};
use crate::engine::gpu::faults::{Call, Fault, Faults};
use crate::engine::gpu::native::{self, Clock, Loss, Poller};
use crate::engine::gpu::pipeline::Pipelines;
use crate::engine::kernels::Caps;
use crate::engine::lock::lock;
use crate::engine::shader;
use crate::error::{Error, Result};

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
    pub bounds_checks: bool,
    /// For tests: calls to the device that fail.
    #[doc(hidden)]
    pub faults: Option<Faults>,
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self {
            adapter: AdapterChoice::Auto,
            timeout: Duration::from_secs(120),
            bounds_checks: false,
            faults: None,
        }
    }
}

/// Longest wait for the work under way when a device is closed, if its own limit is not longer.
const LAST_WAIT: Duration = Duration::from_secs(10);
/// The same on the host's own cores, whose work always ends: the process crashes if it ends first.
const LAST_SOFTWARE_WAIT: Duration = Duration::from_secs(120);

/// An open device with its compiled pipelines. Cheap to share behind an [`Arc`].
#[derive(Debug)]
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    caps: Caps,
    pub(super) options: GpuOptions,
    loss: Loss,
    /// Whether the device is the caller's, whose handlers hear of its loss and its errors.
    foreign: bool,
    /// Bytes that wait to be uploaded.
    pub(super) uploads: Mutex<usize>,
    turns: Mutex<()>,
    pub(super) poller: Arc<Poller>,
    pub(super) clock: Clock,
    pub(super) pipelines: Pipelines,
}

impl Gpu {
    /// Opens the device that `options` ask for, with the limits that the kernels need and no more.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if none matches, or with [`AdapterChoice::Auto`] none gives the limits;
    /// [`Error::Device`] if the chosen one cannot give them.
    pub async fn open(options: GpuOptions) -> Result<Arc<Self>> {
        let adapter = options.adapter.find().await?;
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
        let poller = Arc::new(Poller::new(&device, &loss)?);
        Ok(Self::new(device, queue, options, (loss, poller), false))
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
    /// use smr_gpu::engine::gpu::{Gpu, wgpu};
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
        let loss = Loss::default();
        let poller = Arc::new(Poller::new(&device, &loss)?);
        Ok(Self::new(device, queue, options, (loss, poller), true))
    }

    fn new(
        device: wgpu::Device,
        queue: wgpu::Queue,
        options: GpuOptions,
        watch: (Loss, Arc<Poller>),
        foreign: bool,
    ) -> Arc<Self> {
        let info = device.adapter_info();
        let caps = caps(&info, device.features(), &device.limits());
        Self::with((device, queue, info), (options, watch, foreign), caps, Vec::new())
    }

    fn with(
        (device, queue, info): (wgpu::Device, wgpu::Queue, wgpu::AdapterInfo),
        (options, (loss, poller), foreign): (GpuOptions, (Loss, Arc<Poller>), bool),
        caps: Caps,
        replacements: Vec<shader::Replacement>,
    ) -> Arc<Self> {
        Arc::new(Self {
            poller,
            caps,
            device,
            queue,
            info,
            options,
            loss,
            foreign,
            uploads: Mutex::default(),
            turns: Mutex::default(),
            clock: Clock::default(),
            pipelines: Pipelines::new(replacements),
        })
    }

    /// The same device with another text for one shader file, beside those that it has: for tests that ask
    /// what a fault in a shader would change, and for trying out a shader. Nothing vouches for that text, so
    /// this device compiles every shader with bounds checks, whatever its options say.
    pub fn with_replacement(&self, replacement: shader::Replacement) -> Arc<Self> {
        let options = GpuOptions { bounds_checks: true, ..self.options.clone() };
        let mut replacements = self.pipelines.replacements.clone();
        replacements.push(replacement);
        self.like(options, self.caps.clone(), replacements)
    }

    /// The same device taken for another: for tests of what other adapters run. What comes out is right where
    /// it has what `caps` say: its subgroups must have at least [`Caps::subgroup_min`] invocations, and at most
    /// [`Caps::subgroup_max`].
    pub fn with_caps(&self, caps: Caps) -> Arc<Self> {
        self.like(self.options.clone(), caps, self.pipelines.replacements.clone())
    }

    fn like(
        &self,
        options: GpuOptions,
        caps: Caps,
        replacements: Vec<shader::Replacement>,
    ) -> Arc<Self> {
        let device = (self.device.clone(), self.queue.clone(), self.info.clone());
        let watch = (self.loss.clone(), self.poller.clone());
        Self::with(device, (options, watch, self.foreign), caps, replacements)
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

    /// What is held by who gives the queue something, and by who polls without waiting. Once a device is lost,
    /// wgpu-core 30 gives its resources back in a poll, and takes its locks in another order there than a
    /// write does: on two threads at a time they would wait for each other for ever.
    pub(super) fn turn(&self) -> MutexGuard<'_, ()> {
        lock(&self.turns)
    }

    /// Waits for what was submitted.
    pub(super) fn wait(&self) {
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
