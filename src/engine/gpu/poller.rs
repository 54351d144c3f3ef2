//! Waits for a device in a thread: what a browser does by itself.
//!
//! A future that waits for the device is woken by the [`Poller`] when the device is done.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::engine::gpu::landing::Landing;
use crate::engine::gpu::loss::Loss;
use crate::engine::lock::lock;
use crate::error::{Error, Result};

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

/// Waits until what was submitted is done, the device is lost or `limit` is over, and polls now and then, each
/// time in a turn of its own among `turns`, which `Device::turn` explains.
pub(super) fn wait(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    loss: &Loss,
    turns: &Mutex<()>,
    limit: Duration,
) {
    let start = Instant::now();
    let done = Arc::new(AtomicBool::new(false));
    let told = done.clone();
    {
        let _turn = lock(turns);
        queue.on_submitted_work_done(move || told.store(true, Ordering::Release));
    }
    while !done.load(Ordering::Acquire) && loss.get().is_none() && start.elapsed() < limit {
        std::thread::sleep(SHORT_PAUSE);
        let _turn = lock(turns);
        let _ = poll(device, wgpu::PollType::Poll, loss);
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
                        pollster::block_on(loss.probe(&device));
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
