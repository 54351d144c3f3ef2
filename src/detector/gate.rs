//! [`Gate`]: what one caller does at a time, while the others wait without blocking their threads.

use std::future::poll_fn;
use std::sync::Mutex;
use std::task::{Poll, Waker};

use crate::engine::gpu::add_waker;
use crate::engine::lock::lock;

/// Lets one caller pass at a time. All who wait are woken when it is free, so one that nobody polls any more
/// holds up none.
#[derive(Debug, Default)]
pub(super) struct Gate(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    passed: bool,
    waiting: Vec<Waker>,
}

/// A caller that passed; the gate is free when this is dropped.
#[derive(Debug)]
pub(super) struct Passed<'a>(&'a Gate);

impl Gate {
    /// Waits until no other caller is past the gate.
    pub async fn pass(&self) -> Passed<'_> {
        poll_fn(|context| {
            let mut state = lock(&self.0);
            if state.passed {
                add_waker(&mut state.waiting, context.waker());
                return Poll::Pending;
            }
            state.passed = true;
            Poll::Ready(())
        })
        .await;
        Passed(self)
    }
}

impl Drop for Passed<'_> {
    fn drop(&mut self) {
        let mut state = lock(&self.0.0);
        state.passed = false;
        let waiting = std::mem::take(&mut state.waiting);
        drop(state);
        waiting.into_iter().for_each(Waker::wake);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::pin::pin;
    use std::task::Context;

    /// The first of two that wait is given up: the second passes all the same.
    #[test]
    fn one_at_a_time_and_none_forgotten() {
        let gate = Gate::default();
        let first = pollster::block_on(gate.pass());
        let mut context = Context::from_waker(Waker::noop());
        let mut given_up = Box::pin(gate.pass());
        let mut second = pin!(gate.pass());
        assert!(given_up.as_mut().poll(&mut context).is_pending());
        assert!(second.as_mut().poll(&mut context).is_pending());
        drop(first);
        drop(given_up);
        let Poll::Ready(second) = second.poll(&mut context) else { panic!("the gate is free") };
        assert!(pin!(gate.pass()).poll(&mut context).is_pending());
        drop(second);
        assert!(pin!(gate.pass()).poll(&mut context).is_ready());
    }
}
