//! The slots of a detector: as many pictures in flight as there are slots.

use std::future::poll_fn;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

use crate::error::Result;
use crate::gpu::{Alarm, Deadline, Program, Slot};

/// Slots of one program, handed out one at a time.
pub(super) struct Pool {
    program: Arc<Program>,
    most: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    free: Vec<Slot>,
    /// Slots whose run nobody waits for any more, but the device is not done with.
    late: Vec<Slot>,
    /// Slots that there are, in use or not.
    count: usize,
    waiting: Vec<Waker>,
}

/// What a caller gets.
enum Turn {
    Slot(Box<Slot>),
    /// There may be one more.
    Make,
}

/// A slot for one picture; it goes back when it is dropped.
pub(super) struct Lease<'a> {
    pool: &'a Pool,
    /// `None` until it is made.
    slot: Option<Slot>,
}

impl Pool {
    /// A pool of at most `most` slots, of which one is made now.
    pub async fn new(program: Arc<Program>, most: usize) -> Result<Self> {
        let slot = Slot::new(&program).await?;
        let state = State { free: vec![slot], count: 1, ..State::default() };
        Ok(Self { program, most: most.max(1), state: Mutex::new(state) })
    }

    /// What the slots run.
    pub fn program(&self) -> &Program {
        &self.program
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for a slot. Callers need not get theirs in the order in which they came.
    ///
    /// # Errors
    /// [`crate::Error::Timeout`] past the deadline; what making a slot returns.
    pub async fn take(&self, deadline: Deadline) -> Result<Lease<'_>> {
        let mut alarm = None;
        let turn = poll_fn(|context| self.poll_turn(context, deadline, &mut alarm)).await?;
        drop(alarm);
        let mut lease = Lease { pool: self, slot: None };
        lease.slot = Some(match turn {
            Turn::Slot(slot) => *slot,
            Turn::Make => Slot::new(&self.program).await?,
        });
        lease.recover(deadline).await?;
        Ok(lease)
    }

    fn poll_turn(
        &self,
        context: &mut Context,
        deadline: Deadline,
        alarm: &mut Option<Alarm>,
    ) -> Poll<Result<Turn>> {
        let mut state = self.state();
        if let Some(slot) = state.free.pop() {
            return Poll::Ready(Ok(Turn::Slot(Box::new(slot))));
        }
        if let Some(at) = state.late.iter().position(Slot::is_free) {
            return Poll::Ready(Ok(Turn::Slot(Box::new(state.late.swap_remove(at)))));
        }
        if state.count < self.most {
            state.count += 1;
            return Poll::Ready(Ok(Turn::Make));
        }
        if deadline.is_over() {
            let stage = match state.late.len() == state.count {
                true => "earlier pictures, whose time ran out: the device has not come back",
                false => "earlier pictures",
            };
            return Poll::Ready(Err(deadline.error(stage)));
        }
        state.late.iter().for_each(|slot| slot.wake_when_free(context.waker()));
        state.waiting.push(context.waker().clone());
        drop(state);
        *alarm = deadline.wake(self.program.gpu(), context.waker());
        Poll::Pending
    }
}

impl Deref for Lease<'_> {
    type Target = Slot;

    fn deref(&self) -> &Slot {
        match &self.slot {
            Some(slot) => slot,
            None => unreachable!("a lease has its slot until it is dropped"),
        }
    }
}

impl DerefMut for Lease<'_> {
    fn deref_mut(&mut self) -> &mut Slot {
        match &mut self.slot {
            Some(slot) => slot,
            None => unreachable!("a lease has its slot until it is dropped"),
        }
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        let mut state = self.pool.state();
        match self.slot.take() {
            // It could not be made.
            None => state.count -= 1,
            Some(slot) if slot.is_free() => state.free.push(slot),
            Some(slot) => state.late.push(slot),
        }
        let waiting = std::mem::take(&mut state.waiting);
        drop(state);
        waiting.into_iter().for_each(Waker::wake);
    }
}
