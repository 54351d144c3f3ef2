//! A [`Landing`]: what a run copied to a staging buffer, on its way to the host.

use std::sync::{Arc, Mutex};
use std::task::{Poll, Waker};

use web_time::Instant;

use crate::engine::lock::lock;

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
    /// What nobody knows the end of.
    pub fn new(start: Instant) -> Self {
        Self { state: Arc::default(), start }
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

    /// What the driver said, once it did; until then `waker` is to be woken.
    pub fn poll(&self, waker: &Waker) -> Poll<Result<(), String>> {
        let mut state = lock(&self.state);
        match &state.result {
            Some(result) => Poll::Ready(result.clone()),
            None => {
                add_waker(&mut state.wakers, waker);
                Poll::Pending
            }
        }
    }
}

/// Adds a waker once, however often its task is polled before it is woken.
pub(crate) fn add_waker(wakers: &mut Vec<Waker>, waker: &Waker) {
    if !wakers.iter().any(|known| known.will_wake(waker)) {
        wakers.push(waker.clone());
    }
}
