//! Until when a caller waits.

use std::task::Waker;
use std::time::Duration;

use web_time::Instant;

use crate::engine::gpu::clock::{Alarm, Clock};
use crate::error::Error;

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
    pub(crate) async fn beside<T>(self, work: impl Future<Output = T>) -> (T, Self) {
        let began = Instant::now();
        let given = work.await;
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
    pub(super) fn wake(&self, clock: &Clock, waker: &Waker) -> Option<Alarm> {
        Some(clock.wake_at(self.at?, waker.clone()))
    }
}
