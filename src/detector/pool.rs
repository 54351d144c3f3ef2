//! The memory of a detector's runs: as many in flight as there are arenas, of whichever programs.

use std::future::poll_fn;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};

use crate::engine::gpu::{
    Alarm, Arena, Deadline, Gpu, Inputs, Program, RunOutput, Slot, add_waker,
};
use crate::engine::lock::lock;
use crate::error::Result;

/// Arenas, handed out one at a time.
pub(crate) struct Pool {
    gpu: Arc<Gpu>,
    most: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    free: Vec<Arc<Arena>>,
    /// Arenas with a run that nobody waits for any more, but the device is not done with.
    late: Vec<(Arc<Arena>, Slot)>,
    /// Arenas that there are, in use or not.
    count: usize,
    waiting: Vec<Waker>,
}

/// A program, and what binds it to each arena in which it ran.
pub(crate) struct Slots {
    program: Arc<Program>,
    pool: Arc<Pool>,
    idle: Mutex<Vec<Slot>>,
}

/// An arena for one run of a program; it goes back when this is dropped.
struct Lease<'a> {
    of: &'a Slots,
    arena: Arc<Arena>,
    /// `None` until it is made.
    slot: Option<Slot>,
}

impl Pool {
    /// A pool of at most `most` arenas.
    pub fn new(gpu: Arc<Gpu>, most: usize) -> Self {
        Self { gpu, most: most.max(1), state: Mutex::default() }
    }

    /// The device.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// An arena that no run uses, or the first; none while all are in use. It stays in the pool.
    fn spare(&self) -> Option<Arc<Arena>> {
        let mut state = lock(&self.state);
        if state.count == 0 {
            state.count = 1;
            state.free.push(Arc::default());
        }
        state.free.last().cloned()
    }

    /// Waits for an arena. Callers need not get theirs in the order in which they came.
    ///
    /// # Errors
    /// [`crate::error::Error::Timeout`] past the deadline.
    async fn take(&self, deadline: Deadline) -> Result<Arc<Arena>> {
        let mut alarm = None;
        poll_fn(|context| self.poll_take(context, deadline, &mut alarm)).await
    }

    fn poll_take(
        &self,
        context: &mut Context,
        deadline: Deadline,
        alarm: &mut Option<Alarm>,
    ) -> Poll<Result<Arc<Arena>>> {
        let mut state = lock(&self.state);
        if let Some(arena) = state.free.pop() {
            return Poll::Ready(Ok(arena));
        }
        if let Some(at) = state.late.iter().position(|(_, slot)| slot.is_free()) {
            return Poll::Ready(Ok(state.late.swap_remove(at).0));
        }
        if state.count < self.most {
            state.count += 1;
            return Poll::Ready(Ok(Arc::default()));
        }
        if deadline.is_over() {
            let stage = match state.late.len() == state.count {
                true => "earlier pictures, whose time ran out: the device has not come back",
                false => "earlier pictures",
            };
            return Poll::Ready(Err(deadline.error(stage)));
        }
        state.late.iter().for_each(|(_, slot)| slot.wake_when_free(context.waker()));
        add_waker(&mut state.waiting, context.waker());
        drop(state);
        *alarm = self.gpu.wake_at(deadline, context.waker());
        Poll::Pending
    }
}

impl Slots {
    /// Makes a slot now, if there is memory that no run uses.
    ///
    /// # Errors
    /// What making a slot returns.
    pub async fn new(program: Arc<Program>, pool: Arc<Pool>) -> Result<Self> {
        let slot = match pool.spare() {
            Some(arena) => Some(Slot::sharing(&program, &arena).await?),
            None => None,
        };
        Ok(Self { program, pool, idle: Mutex::new(slot.into_iter().collect()) })
    }

    /// What they run.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Runs pictures, when there is memory for them.
    ///
    /// # Errors
    /// [`crate::error::Error::Timeout`] past the deadline; what making a slot and its run return.
    pub async fn run(&self, pictures: &[&Inputs<'_>], deadline: Deadline) -> Result<RunOutput> {
        let arena = self.pool.take(deadline).await?;
        let mut lease = Lease { of: self, arena, slot: None };
        let idle = self.idle_in(&lease.arena);
        let slot = lease.slot.insert(match idle {
            Some(slot) => slot,
            None => Slot::sharing(&self.program, &lease.arena).await?,
        });
        slot.recover(deadline).await?;
        slot.submit(pictures).await?;
        slot.receive(deadline).await
    }

    fn idle_in(&self, arena: &Arc<Arena>) -> Option<Slot> {
        let mut idle = lock(&self.idle);
        let at = idle.iter().position(|slot| slot.is_in(arena))?;
        Some(idle.swap_remove(at))
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        let arena = self.arena.clone();
        let mut state = lock(&self.of.pool.state);
        match self.slot.take() {
            Some(slot) if !slot.is_free() => state.late.push((arena, slot)),
            slot => {
                lock(&self.of.idle).extend(slot);
                state.free.push(arena);
            }
        }
        let waiting = std::mem::take(&mut state.waiting);
        drop(state);
        waiting.into_iter().for_each(Waker::wake);
    }
}
