//! The device: giving it work, hearing of its errors and of its loss.

use std::future::poll_fn;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::Poll;
use std::time::Duration;

use web_time::Instant;

use crate::engine::gpu::adapter::AdapterChoice;
use crate::engine::gpu::clock::Clock;
use crate::engine::gpu::deadline::Deadline;
use crate::engine::gpu::faults::{Call, Fault, Faults};
use crate::engine::gpu::landing::Landing;
use crate::engine::gpu::loss::Loss;
use crate::engine::gpu::poller::{self, Poller};
use crate::engine::lock::lock;
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

/// An open device.
#[derive(Debug)]
pub(super) struct Device {
    pub handle: wgpu::Device,
    pub queue: wgpu::Queue,
    pub info: wgpu::AdapterInfo,
    pub options: GpuOptions,
    loss: Loss,
    /// Whether the device is the caller's, whose handlers hear of its loss and its errors.
    foreign: bool,
    /// Bytes that wait to be uploaded.
    pub uploads: Mutex<usize>,
    turns: Mutex<()>,
    poller: Arc<Poller>,
    pub clock: Clock,
}

impl Device {
    /// # Errors
    /// [`Error::Driver`] where no thread can be had that waits for it.
    pub fn new(
        (handle, queue): (wgpu::Device, wgpu::Queue),
        options: GpuOptions,
        loss: Loss,
        foreign: bool,
    ) -> Result<Self> {
        let poller = Arc::new(Poller::new(&handle, &loss)?);
        Ok(Self::with((handle, queue), options, (loss, poller), foreign))
    }

    /// The same device under other options.
    pub fn like(&self, options: GpuOptions) -> Self {
        let handles = (self.handle.clone(), self.queue.clone());
        Self::with(handles, options, (self.loss.clone(), self.poller.clone()), self.foreign)
    }

    fn with(
        (handle, queue): (wgpu::Device, wgpu::Queue),
        options: GpuOptions,
        (loss, poller): (Loss, Arc<Poller>),
        foreign: bool,
    ) -> Self {
        let info = handle.adapter_info();
        Self {
            handle,
            queue,
            info,
            options,
            loss,
            foreign,
            uploads: Mutex::default(),
            turns: Mutex::default(),
            poller,
            clock: Clock::default(),
        }
    }

    /// What a test wants of this call.
    pub(super) fn fault(&self, call: Call) -> Option<Fault> {
        let fault = self.options.faults.as_ref()?.next(call);
        if fault == Some(Fault::Lost) {
            self.handle.destroy();
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
    pub(super) async fn check_alive(&self) -> Result<()> {
        // It has the driver's own words, if there are any.
        {
            let _turn = self.turn();
            let _ = poller::poll(&self.handle, wgpu::PollType::Poll, &self.loss);
        }
        self.check_lost()?;
        self.loss.probe(&self.handle).await;
        self.check_lost()
    }

    /// Does `work`, whose errors are told elsewhere.
    pub(super) fn unheard(&self, work: impl FnOnce()) {
        let memory = self.handle.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.handle.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.handle.push_error_scope(wgpu::ErrorFilter::Validation);
        work();
        drop(validation.pop());
        drop(internal.pop());
        drop(memory.pop());
    }

    /// Runs `work` at once, and returns, when the future is ready, what the driver objected to, under the name
    /// `stage`. In a browser the driver answers later; elsewhere the future is ready.
    pub(super) fn scoped<T>(
        &self,
        stage: &str,
        work: impl FnOnce() -> Result<T>,
    ) -> impl Future<Output = Result<T>> {
        let memory = self.handle.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.handle.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.handle.push_error_scope(wgpu::ErrorFilter::Validation);
        let result = work();
        // All three leave the stack before the first wait: it holds what other work was given by then.
        let pops = (validation.pop(), internal.pop(), memory.pop());
        async move {
            let errors = [pops.0.await, pops.1.await, pops.2.await];
            let told = errors.into_iter().flatten().map(|e| e.to_string()).next();
            let told = told.or_else(|| self.options.faults.as_ref()?.take());
            if told.is_some() {
                // What a lost device was given is no good for what follows.
                self.check_alive().await?;
            }
            self.check_lost()?;
            match told {
                Some(message) => Err(Error::Driver { stage: stage.into(), message }),
                None => result,
            }
        }
    }

    /// What is held by who gives the queue something, and by who polls without waiting. Once a device is lost,
    /// wgpu-core 30 gives its resources back in a poll, and takes its locks in another order there than a
    /// write does: on two threads at a time they would wait for each other for ever.
    pub(super) fn turn(&self) -> MutexGuard<'_, ()> {
        lock(&self.turns)
    }

    /// Waits for what was submitted, but in a browser, which limits by itself what waits.
    pub(super) fn wait(&self) {
        poller::wait(&self.handle, &self.queue, &self.loss, &self.turns, self.options.timeout);
    }

    /// Submits commands, or only what was written.
    pub(super) fn submit(&self, commands: Option<wgpu::CommandBuffer>) -> wgpu::SubmissionIndex {
        let invalid = (self.fault(Call::Submit) == Some(Fault::Invalid)).then(|| {
            let mut encoder = self.handle.create_command_encoder(&Default::default());
            encoder.push_debug_group("never popped");
            encoder.finish()
        });
        let _turn = self.turn();
        self.queue.submit(commands.into_iter().chain(invalid))
    }

    /// Asks for the first `bytes` of `staging`, to which `submission` copies.
    pub(super) fn land(
        &self,
        staging: &wgpu::Buffer,
        bytes: u64,
        submission: wgpu::SubmissionIndex,
        start: Instant,
    ) -> Landing {
        let landing = Landing::new(start);
        let told = landing.clone();
        let fault = self.fault(Call::Map);
        if let Some(Fault::Refused | Fault::Invalid) = fault {
            // A buffer is not mapped twice.
            staging.slice(..bytes).map_async(wgpu::MapMode::Read, |_| ());
        }
        staging.slice(..bytes).map_async(wgpu::MapMode::Read, move |result| {
            let result = result.map_err(|e| e.to_string());
            match fault {
                Some(Fault::Late(by)) => drop(std::thread::spawn(move || {
                    std::thread::sleep(by);
                    told.tell(result);
                })),
                _ => told.tell(result),
            }
        });
        if let Some(Fault::Aborted) = fault {
            staging.unmap();
        }
        self.poller.follow(submission, landing.clone());
        landing
    }

    /// Waits until the host can read the buffer.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::Timeout`] past the deadline, or [`Error::Driver`] if the map is
    /// refused.
    pub(super) async fn wait_for(
        &self,
        landing: &Landing,
        deadline: Deadline,
        stage: &str,
    ) -> Result<()> {
        let mut alarm = None;
        let told = poll_fn(|context| match landing.poll(context.waker()) {
            Poll::Ready(result) => Poll::Ready(Some(result)),
            Poll::Pending if deadline.is_over() => Poll::Ready(None),
            Poll::Pending => {
                alarm = deadline.wake(&self.clock, context.waker());
                Poll::Pending
            }
        })
        .await;
        drop(alarm);
        // A lost device refuses the map, or never answers.
        if !matches!(told, Some(Ok(()))) {
            self.check_alive().await?;
        }
        match told {
            Some(Ok(())) => Ok(()),
            Some(Err(message)) => Err(Error::Driver { stage: stage.into(), message }),
            None => Err(deadline.error(stage)),
        }
    }
}

impl Drop for Device {
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
        let timeout = self.options.timeout.max(wait);
        let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(timeout) };
        if let Err(wgpu::PollError::Timeout) = poller::poll(&self.handle, wait, &self.loss) {
            // To drop the queue would wait without a limit: a device that hangs keeps its own.
            std::mem::forget((self.handle.clone(), self.queue.clone()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::gpu::Gpu;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::task::{Context, Wake, Waker};

    #[derive(Default)]
    struct Woken(AtomicUsize);

    impl Wake for Woken {
        fn wake(self: Arc<Self>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Who polls for another reason, as a `select` does, leaves one waker all the same.
    #[test]
    fn polled_often_and_woken_once() {
        let gpu = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
        let landing = Landing::new(Instant::now());
        let woken = [(); 2].map(|()| Arc::new(Woken::default()));
        let deadline = Deadline::after(Duration::from_secs(60));
        let mut wait = Box::pin(gpu.device.wait_for(&landing, deadline, "a test"));
        for woken in &woken {
            let waker = Waker::from(woken.clone());
            for _ in 0..3 {
                let polled = wait.as_mut().poll(&mut Context::from_waker(&waker));
                assert!(polled.is_pending());
                landing.wake_when_over(&waker);
            }
        }
        landing.tell(Ok(()));
        assert_eq!(woken.map(|woken| woken.0.load(Ordering::Relaxed)), [1, 1]);
    }
}
