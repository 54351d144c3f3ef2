//! Wakes futures when their time is up: what a browser has a timer for.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::task::Waker;
use std::time::Instant;

use crate::engine::lock::lock;

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
    use std::time::Duration;

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
