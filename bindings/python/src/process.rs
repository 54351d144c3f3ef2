//! Values that a forked process must not touch: the threads that they wait for were not forked with it.

use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::process;
use std::sync::OnceLock;

use pyo3::prelude::*;

use crate::errors;

/// The process whose threads compute, once there is a detector.
static OWNER: OnceLock<u32> = OnceLock::new();

/// Refuses a process that was forked from one with a detector.
///
/// # Errors
/// `smr_gpu.ForkError`.
pub fn check(py: Python<'_>) -> PyResult<()> {
    let (owner, own) = (*OWNER.get_or_init(process::id), process::id());
    match owner == own {
        true => Ok(()),
        false => Err(errors::forked(py, owner, own)),
    }
}

/// A value of the process that made it.
pub struct Owned<T> {
    value: ManuallyDrop<T>,
}

impl<T> Owned<T> {
    pub fn new(value: T) -> Self {
        Self { value: ManuallyDrop::new(value) }
    }
}

impl<T> Deref for Owned<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> Drop for Owned<T> {
    /// A forked process keeps it: giving it back would wait for threads that are not there.
    fn drop(&mut self) {
        if OWNER.get() == Some(&process::id()) {
            // SAFETY: nothing reads the value after `drop`.
            unsafe { ManuallyDrop::drop(&mut self.value) }
        }
    }
}
