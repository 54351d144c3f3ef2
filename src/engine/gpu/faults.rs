//! [`Faults`]: a call to the device fails on purpose, so that a test sees what becomes of it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::ThreadId;
use std::time::Duration;

use crate::engine::lock::lock;

/// What the engine asks of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Call {
    /// Make a buffer.
    Buffer,
    /// Make a texture.
    Texture,
    /// Compile a pipeline.
    Pipeline,
    /// Make a bind group.
    BindGroup,
    /// Write to a buffer or texture.
    Write,
    /// Submit commands.
    Submit,
    /// Map a buffer.
    Map,
}

/// How a call fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The call is made so that wgpu refuses it, and what it gives is as wgpu leaves it.
    Invalid,
    /// The call is made, but the driver is said to have had no memory for it.
    OutOfMemory,
    /// The device is destroyed before the call.
    Lost,
    /// The answer comes so much later; of [`Call::Map`] alone.
    Late(Duration),
    /// wgpu refuses at once; of [`Call::Map`] alone.
    Refused,
    /// wgpu takes it, and gives up later; of [`Call::Map`] alone.
    Aborted,
}

/// Counts the calls to the devices that were opened with it, and lets one of them fail. Clones are one
/// and the same.
#[derive(Clone, Debug, Default)]
pub struct Faults(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    calls: HashMap<Call, usize>,
    next: Option<(Call, usize, Fault)>,
    /// What is still to be told to the thread that called.
    untold: Vec<(ThreadId, String)>,
    strays: Vec<String>,
}

impl Call {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::Buffer,
        Self::Texture,
        Self::Pipeline,
        Self::BindGroup,
        Self::Write,
        Self::Submit,
        Self::Map,
    ];
}

impl Faults {
    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.0)
    }

    /// Counts from 0 again, and lets nothing fail.
    pub fn watch(&self) {
        let mut state = self.state();
        state.calls.clear();
        state.next = None;
    }

    /// Counts from 0 again, and lets the call of this kind fail that has the number `at`: kinds are
    /// counted each for itself, since several threads call.
    pub fn fail(&self, call: Call, at: usize, fault: Fault) {
        self.watch();
        self.state().next = Some((call, at, fault));
    }

    /// How many calls of a kind there were since it began to count.
    pub fn calls(&self, call: Call) -> usize {
        self.state().calls.get(&call).copied().unwrap_or(0)
    }

    /// Whether the fault that was asked for is still to come.
    pub fn is_due(&self) -> bool {
        self.state().next.is_some()
    }

    /// Errors that were told to nobody.
    pub fn strays(&self) -> Vec<String> {
        let state = self.state();
        let untold = state.untold.iter().map(|(_, message)| message);
        state.strays.iter().chain(untold).cloned().collect()
    }

    pub(super) fn stray(&self, message: String) {
        self.state().strays.push(message);
    }

    /// What the next call is to suffer.
    pub(super) fn next(&self, call: Call) -> Option<Fault> {
        let mut state = self.state();
        let count = state.calls.entry(call).or_default();
        let at = *count;
        *count += 1;
        let (.., fault) = state.next.take_if(|(kind, next, _)| (*kind, *next) == (call, at))?;
        if fault == Fault::OutOfMemory {
            let message = format!("{call:?}: out of memory, as a test wished");
            state.untold.push((std::thread::current().id(), message));
        }
        Some(fault)
    }

    /// What a call of this thread suffered and nobody was told yet.
    pub(super) fn take(&self) -> Option<String> {
        let here = std::thread::current().id();
        let mut state = self.state();
        let at = state.untold.iter().position(|(thread, _)| *thread == here)?;
        Some(state.untold.swap_remove(at).1)
    }
}
