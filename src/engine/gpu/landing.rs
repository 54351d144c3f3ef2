//! A [`Landing`]: what a run copied to a staging buffer, on its way to the host.

use std::future::poll_fn;
use std::sync::{Arc, Mutex};
use std::task::{Poll, Waker};
use std::time::{Duration, Instant};

use crate::engine::gpu::context::Gpu;
use crate::engine::gpu::faults::{Call, Fault};
use crate::engine::gpu::native::Alarm;
use crate::engine::lock::lock;
use crate::error::{Error, Result};

/// Until when a caller waits, and what it asked for.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    /// `None` for a time past the end of the clock, and before a run of its own began.
    at: Option<Instant>,
    limit: Duration,
    /// Whether each run has the limit for itself.
    is_of_each_run: bool,
}

impl Deadline {
    /// So long from now.
    pub fn after(limit: Duration) -> Self {
        Self { at: Instant::now().checked_add(limit), limit, is_of_each_run: false }
    }

    /// So long from the beginning of each run: for pictures that are begun before anybody asks for them.
    pub(crate) fn of_each_run(limit: Duration) -> Self {
        Self { at: None, limit, is_of_each_run: true }
    }

    /// That of a run that begins now.
    pub(crate) fn of_run(self) -> Self {
        if self.is_of_each_run { Self::after(self.limit) } else { self }
    }

    /// What `work` gives, and the deadline as much later as it took: what is made ready once is not a picture's
    /// own.
    pub(crate) fn beside<T>(self, work: impl FnOnce() -> T) -> (T, Self) {
        let began = Instant::now();
        let given = work();
        let at = self.at.and_then(|at| at.checked_add(began.elapsed()));
        (given, Self { at, ..self })
    }

    /// Whether the time is up.
    pub fn is_over(&self) -> bool {
        self.at.is_some_and(|at| Instant::now() >= at)
    }

    /// The error of a wait for `stage` that took too long.
    pub fn error(&self, stage: &str) -> Error {
        Error::Timeout { stage: stage.into(), seconds: self.limit.as_secs_f64() }
    }

    /// Wakes a future when the time is up, unless the alarm is dropped before.
    pub(crate) fn wake(&self, gpu: &Gpu, waker: &Waker) -> Option<Alarm> {
        Some(gpu.clock.wake_at(self.at?, waker.clone()))
    }
}

/// A staging buffer that the host asked for. Clones are one and the same.
#[derive(Clone, Debug)]
pub(super) struct Landing {
    state: Arc<Mutex<State>>,
    pub start: Instant,
}

#[derive(Debug, Default)]
struct State {
    /// What the driver said, once it did.
    result: Option<Result<(), String>>,
    wakers: Vec<Waker>,
}

impl Landing {
    /// Asks for the first `bytes` of `staging`, to which `submission` copies.
    pub fn new(
        gpu: &Gpu,
        staging: &wgpu::Buffer,
        bytes: u64,
        submission: wgpu::SubmissionIndex,
        start: Instant,
    ) -> Self {
        let state = Arc::new(Mutex::new(State::default()));
        let landing = Self { state, start };
        let told = landing.clone();
        let fault = gpu.fault(Call::Map);
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
        gpu.poller.follow(submission, landing.clone());
        landing
    }

    /// Says what became of it; the first to say so is believed.
    pub fn tell(&self, result: Result<(), String>) {
        let mut state = lock(&self.state);
        state.result.get_or_insert(result);
        let wakers = std::mem::take(&mut state.wakers);
        drop(state);
        wakers.into_iter().for_each(Waker::wake);
    }

    /// Wakes `waker` when it is.
    pub fn wake_when_over(&self, waker: &Waker) {
        let mut state = lock(&self.state);
        match state.result {
            Some(_) => waker.wake_by_ref(),
            None => add_waker(&mut state.wakers, waker),
        }
    }

    /// Whether the device is done with the buffer, for good or ill.
    pub fn is_over(&self) -> bool {
        lock(&self.state).result.is_some()
    }

    /// Waits until the host can read the buffer.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::Timeout`] past the deadline, or [`Error::Driver`] if the map is
    /// refused.
    pub async fn wait(&self, gpu: &Gpu, deadline: Deadline, stage: &str) -> Result<()> {
        let mut alarm = None;
        let told = poll_fn(|context| {
            let mut state = lock(&self.state);
            if let Some(result) = &state.result {
                return Poll::Ready(Some(result.clone()));
            }
            if deadline.is_over() {
                return Poll::Ready(None);
            }
            add_waker(&mut state.wakers, context.waker());
            drop(state);
            alarm = deadline.wake(gpu, context.waker());
            Poll::Pending
        })
        .await;
        drop(alarm);
        // A lost device refuses the map, or never answers.
        if !matches!(told, Some(Ok(()))) {
            gpu.check_alive()?;
        }
        match told {
            Some(Ok(())) => Ok(()),
            Some(Err(message)) => Err(Error::Driver { stage: stage.into(), message }),
            None => Err(deadline.error(stage)),
        }
    }
}

/// Adds a waker once, however often its task is polled before it is woken.
pub(crate) fn add_waker(wakers: &mut Vec<Waker>, waker: &Waker) {
    if !wakers.iter().any(|known| known.will_wake(waker)) {
        wakers.push(waker.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::gpu::GpuOptions;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::task::{Context, Wake};

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
        let landing = Landing { state: Arc::default(), start: Instant::now() };
        let woken = [(); 2].map(|()| Arc::new(Woken::default()));
        let deadline = Deadline::after(Duration::from_secs(60));
        let mut wait = Box::pin(landing.wait(&gpu, deadline, "a test"));
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
