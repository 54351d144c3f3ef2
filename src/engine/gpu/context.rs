//! An open device with its compiled pipelines.

use std::sync::Arc;
use std::task::Waker;
use std::time::Duration;

use crate::engine::gpu::adapter::{caps, lacks, required_limits, wanted_features};
use crate::engine::gpu::clock::Alarm;
use crate::engine::gpu::deadline::Deadline;
use crate::engine::gpu::device::{Device, GpuOptions};
use crate::engine::gpu::loss::Loss;
use crate::engine::gpu::pipeline::Pipelines;
use crate::engine::kernels::Caps;
use crate::engine::shader;
use crate::error::{Error, Result};

#[cfg(doc)]
use crate::engine::gpu::AdapterChoice;

/// An open device with its compiled pipelines. Cheap to share behind an [`Arc`].
#[derive(Debug)]
pub struct Gpu {
    pub(super) device: Device,
    caps: Caps,
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
        Ok(Self::new(Device::new((device, queue), options, loss, false)?))
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
        Ok(Self::new(Device::new((device, queue), options, Loss::default(), true)?))
    }

    fn new(device: Device) -> Arc<Self> {
        let caps = caps(&device.info, device.handle.features(), &device.handle.limits());
        Arc::new(Self { device, caps, pipelines: Pipelines::new(Vec::new()) })
    }

    /// The same device with another text for one shader file, beside those that it has: for tests that ask
    /// what a fault in a shader would change, and for trying out a shader. Nothing vouches for that text, so
    /// this device compiles every shader with bounds checks, whatever its options say.
    pub fn with_replacement(&self, replacement: shader::Replacement) -> Arc<Self> {
        let options = GpuOptions { bounds_checks: true, ..self.device.options.clone() };
        let mut replacements = self.pipelines.replacements.clone();
        replacements.push(replacement);
        let (device, caps) = (self.device.like(options), self.caps.clone());
        Arc::new(Self { device, caps, pipelines: Pipelines::new(replacements) })
    }

    /// The same device taken for another: for tests of what other adapters run. What comes out is right where
    /// it has what `caps` say: its subgroups must have at least [`Caps::subgroup_min`] invocations, and at most
    /// [`Caps::subgroup_max`].
    pub fn with_caps(&self, caps: Caps) -> Arc<Self> {
        let device = self.device.like(self.device.options.clone());
        let pipelines = Pipelines::new(self.pipelines.replacements.clone());
        Arc::new(Self { device, caps, pipelines })
    }

    /// The adapter's name, backend and driver.
    pub fn info(&self) -> &wgpu::AdapterInfo {
        &self.device.info
    }

    /// What kernels may count on.
    pub fn caps(&self) -> &Caps {
        &self.caps
    }

    /// Whether stages can be timed on the device.
    pub fn has_timestamps(&self) -> bool {
        self.device.handle.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// The longest wait for one run.
    pub fn timeout(&self) -> Duration {
        self.device.options.timeout
    }

    /// Destroys the device, as a driver reset would: every later run returns
    /// [`Error::DeviceLost`].
    pub fn destroy(&self) {
        self.device.handle.destroy();
    }

    /// Wakes `waker` when `deadline` is over, unless the alarm is dropped before.
    pub(crate) fn wake_at(&self, deadline: Deadline, waker: &Waker) -> Option<Alarm> {
        deadline.wake(&self.device.clock, waker)
    }
}
