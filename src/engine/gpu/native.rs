//! Waiting, clocks and threads: all that a browser has no need of.
//!
//! A future that waits for the device is woken by the [`Poller`] when the device is done, and by the
//! [`Clock`] when its time is up.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::task::Waker;
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
/// own among `turns`, which `Gpu::turn` explains.
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

/// Looks whether a device still is, and tells `loss` if not. It reports its loss when all work is done that
/// it had, to a handler that may be another's, and until then takes every call and does nothing: so this
/// makes a buffer and looks whether there is one.
pub(super) fn look(device: &wgpu::Device, loss: &Loss) {
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

/// Between two looks at a device that said it was done, but not told whoever waits.
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
                        look(&device, &loss);
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

/// A thread that wakes futures at a time of their own.
#[derive(Debug, Default)]
pub(super) struct Clock {
    state: Arc<(Mutex<Alarms>, Condvar)>,
}

#[derive(Debug, Default)]
struct Alarms {
    /// By time, and by a number that tells alarms of one time apart.
    wakers: BTreeMap<(Instant, u64), Waker>,
    next: u64,
    runs: bool,
    ended: bool,
}

/// A time at which somebody is woken, unless this is dropped before.
#[derive(Debug)]
pub(crate) struct Alarm {
    key: (Instant, u64),
    state: Arc<(Mutex<Alarms>, Condvar)>,
}

impl Drop for Alarm {
    fn drop(&mut self) {
        lock(&self.state.0).wakers.remove(&self.key);
    }
}

impl Clock {
    /// Wakes `waker` at `time`.
    pub fn wake_at(&self, time: Instant, waker: Waker) -> Alarm {
        let (alarms, changed) = &*self.state;
        let mut alarms = lock(alarms);
        let key = (time, alarms.next);
        alarms.next += 1;
        alarms.wakers.insert(key, waker);
        if !alarms.runs {
            alarms.runs = true;
            let state = self.state.clone();
            let thread = std::thread::Builder::new().spawn(move || Self::run(&state));
            if thread.is_err() {
                // Without a thread that keeps the time, whoever waits looks at it again and again.
                alarms.runs = false;
                alarms.wakers.values().for_each(Waker::wake_by_ref);
            }
        }
        changed.notify_one();
        Alarm { key, state: self.state.clone() }
    }

    fn run((mutex, changed): &(Mutex<Alarms>, Condvar)) {
        let mut alarms = lock(mutex);
        while !alarms.ended {
            let now = Instant::now();
            let later = alarms.wakers.split_off(&(now, u64::MAX));
            let due = std::mem::replace(&mut alarms.wakers, later);
            if !due.is_empty() {
                // A woken task may drop alarms, which takes the lock.
                drop(alarms);
                due.into_values().for_each(Waker::wake);
                alarms = lock(mutex);
                continue;
            }
            let first = alarms.wakers.first_key_value().map(|((time, _), _)| *time);
            alarms = match first {
                None => changed.wait(alarms).unwrap_or_else(PoisonError::into_inner),
                Some(time) => {
                    let wait = changed.wait_timeout(alarms, time.saturating_duration_since(now));
                    wait.unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }
}

impl Drop for Clock {
    fn drop(&mut self) {
        lock(&self.state.0).ended = true;
        self.state.1.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::poll_fn;
    use std::task::Poll;

    #[test]
    fn alarms_wake_in_the_order_of_their_times() {
        let clock = Clock::default();
        let start = Instant::now();
        let until = |time: Instant| {
            let mut alarm = None;
            pollster::block_on(poll_fn(|context| {
                if Instant::now() >= time {
                    return Poll::Ready(());
                }
                alarm = Some(clock.wake_at(time, context.waker().clone()));
                Poll::Pending
            }));
            drop(alarm);
        };
        std::thread::scope(|scope| {
            scope.spawn(|| until(start + Duration::from_millis(60)));
            until(start + Duration::from_millis(20));
            until(start);
        });
        assert!(start.elapsed() >= Duration::from_millis(60));
        assert!(lock(&clock.state.0).wakers.is_empty());
    }

    /// A picture that came in time leaves nothing that waits for its limit.
    #[test]
    fn an_alarm_that_nobody_needs_is_forgotten() {
        let clock = Clock::default();
        let alarm = clock.wake_at(Instant::now() + Duration::from_secs(120), Waker::noop().clone());
        assert_eq!(lock(&clock.state.0).wakers.len(), 1);
        drop(alarm);
        assert!(lock(&clock.state.0).wakers.is_empty());
    }
}
