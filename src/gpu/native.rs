//! Waiting, clocks and threads: all that a browser has no need of.
//!
//! A future that waits for the device is woken by the [`Poller`] when the device is done, and by the
//! [`Clock`] when its time is up.

use std::collections::BTreeMap;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::Instant;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A thread that waits for submissions, in their order, so that the callbacks behind them run.
#[derive(Debug)]
pub(super) struct Poller {
    submissions: Sender<wgpu::SubmissionIndex>,
}

impl Poller {
    pub fn new(device: &wgpu::Device) -> Self {
        let (submissions, received) = mpsc::channel();
        let device = device.clone();
        // It ends when the sender is gone.
        std::thread::spawn(move || {
            for index in received {
                let wait = wgpu::PollType::Wait { submission_index: Some(index), timeout: None };
                // Whoever waits learns of a failure through its own callback.
                let _ = device.poll(wait);
            }
        });
        Self { submissions }
    }

    /// Sees to it that the callbacks behind a submission run.
    pub fn follow(&self, submission: wgpu::SubmissionIndex) {
        // The thread outlives this sender.
        let _ = self.submissions.send(submission);
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

impl Clock {
    /// Wakes `waker` at `time`.
    pub fn wake_at(&self, time: Instant, waker: Waker) {
        let (alarms, changed) = &*self.state;
        let mut alarms = lock(alarms);
        let number = alarms.next;
        alarms.next += 1;
        alarms.wakers.insert((time, number), waker);
        if !alarms.runs {
            alarms.runs = true;
            let state = self.state.clone();
            std::thread::spawn(move || Self::run(&state));
        }
        changed.notify_one();
    }

    fn run((alarms, changed): &(Mutex<Alarms>, Condvar)) {
        let mut alarms = lock(alarms);
        while !alarms.ended {
            let now = Instant::now();
            let later = alarms.wakers.split_off(&(now, u64::MAX));
            let due = std::mem::replace(&mut alarms.wakers, later);
            due.into_values().for_each(Waker::wake);
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
    use std::time::Duration;

    #[test]
    fn alarms_wake_in_the_order_of_their_times() {
        let clock = Clock::default();
        let start = Instant::now();
        let until = |time: Instant| {
            pollster::block_on(poll_fn(|context| {
                if Instant::now() >= time {
                    return Poll::Ready(());
                }
                clock.wake_at(time, context.waker().clone());
                Poll::Pending
            }));
        };
        std::thread::scope(|scope| {
            scope.spawn(|| until(start + Duration::from_millis(60)));
            until(start + Duration::from_millis(20));
            until(start);
        });
        assert!(start.elapsed() >= Duration::from_millis(60));
    }
}
