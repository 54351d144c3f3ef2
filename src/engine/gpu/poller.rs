//! Waits for a device in a thread, and hears of its loss: what a browser does by itself.
//!
//! A future that waits for the device is woken by the [`Poller`] when the device is done.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::engine::gpu::landing::Landing;
use crate::engine::lock::lock;
use crate::error::{Error, Result};

/// Why a device is gone, once it is. Clones are one and the same.
#[derive(Clone, Debug, Default)]
pub(super) struct Loss(Arc<Mutex<Option<String>>>);

impl Loss {
    /// The first to say so is believed.
    pub fn tell(&self, message: String) {
        lock(&self.0).get_or_insert(message);
    }

    pub fn get(&self) -> Option<String> {
        lock(&self.0).clone()
    }
}

/// Polls a device. `wgpu` ends the thread where the driver says that the device is lost; wgpu-core 30 also
/// where a wait runs out just as another thread sees the queue empty, so a poll is tried twice.
pub(super) fn poll(
    device: &wgpu::Device,
    how: wgpu::PollType,
    loss: &Loss,
) -> Result<(), wgpu::PollError> {
    let polled = || catch_unwind(AssertUnwindSafe(|| device.poll(how.clone()))).ok();
    match polled().or_else(polled) {
        Some(told) => told.map(|_| ()),
        None => {
            loss.tell("the driver failed while it was waited for".into());
            Ok(())
        }
    }
}

/// Waits until `done`, the loss of the device or `limit`, and polls now and then, each time in a turn of its
/// own among `turns`, which `Device::turn` explains.
pub(super) fn wait(
    device: &wgpu::Device,
    loss: &Loss,
    turns: &Mutex<()>,
    done: &AtomicBool,
    limit: Duration,
) {
    let start = Instant::now();
    while !done.load(Ordering::Acquire) && loss.get().is_none() && start.elapsed() < limit {
        std::thread::sleep(SHORT_PAUSE);
        let _turn = lock(turns);
        let _ = poll(device, wgpu::PollType::Poll, loss);
    }
}

/// Probes whether a device still is, and tells `loss` if not. It reports its loss when all work is done that
/// it had, to a handler that may be another's, and until then takes every call and does nothing: so this
/// makes a buffer and sees whether there is one.
pub(super) fn probe(device: &wgpu::Device, loss: &Loss) {
    let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
    let validation = device.push_error_scope(wgpu::ErrorFilter::Validation);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: 4,
        usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: true,
    });
    let is_there = buffer.slice(..).get_mapped_range().is_ok();
    let is_full = pollster::block_on({
        drop(validation.pop());
        memory.pop()
    });
    if !is_there && is_full.is_none() {
        loss.tell("it takes no more calls".into());
    }
}

/// A thread that waits for submissions, in their order, so that the callbacks behind them run.
#[derive(Debug)]
pub(super) struct Poller {
    submissions: Sender<(wgpu::SubmissionIndex, Landing)>,
}

/// Between two polls of a device that said it was done, but not told whoever waits.
const SHORT_PAUSE: Duration = Duration::from_micros(200);
/// The longest of such pauses; each is twice the one before.
const LONG_PAUSE: Duration = Duration::from_millis(10);

impl Poller {
    /// # Errors
    /// [`Error::Driver`] where no thread can be had.
    pub fn new(device: &wgpu::Device, loss: &Loss) -> Result<Self> {
        let (submissions, received) = mpsc::channel::<(wgpu::SubmissionIndex, Landing)>();
        let (device, loss) = (device.clone(), loss.clone());
        // It ends when the sender is gone.
        let thread = std::thread::Builder::new().spawn(move || {
            for (index, landing) in received {
                let wait = wgpu::PollType::Wait { submission_index: Some(index), timeout: None };
                // A wait that ends early, or for what was never submitted, is made up for below.
                let _ = poll(&device, wait, &loss);
                let mut pause = SHORT_PAUSE;
                while !landing.is_over() {
                    if let Some(message) = loss.get() {
                        landing.tell(Err(message));
                        break;
                    }
                    std::thread::sleep(pause);
                    pause = LONG_PAUSE.min(2 * pause);
                    let _ = poll(&device, wgpu::PollType::Poll, &loss);
                    if pause == LONG_PAUSE {
                        probe(&device, &loss);
                    }
                }
            }
        });
        thread.map_err(|e| Error::Driver {
            stage: "opening the device".into(),
            message: format!("expected a thread that waits for it, got {e}"),
        })?;
        Ok(Self { submissions })
    }

    /// Sees to it that somebody tells `landing` what became of it.
    pub fn follow(&self, submission: wgpu::SubmissionIndex, landing: Landing) {
        // The thread outlives this sender.
        let _ = self.submissions.send((submission, landing));
    }
}
