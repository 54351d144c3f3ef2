//! Everything that touches wgpu: the device, programs and their runs.
//!
//! A [`Program`] is what a graph was lowered to, on a device: pipelines and weights, shared by all runs.
//! A [`Slot`] is one run's worth of memory, so that several pictures can be in flight; slots of programs
//! that take turns share an `Arena`.

mod adapter;
mod arena;
mod context;
mod faults;
mod landing;
mod memory;
mod native;
mod pipeline;
mod poison;
mod program;
mod slot;

pub use adapter::{AdapterChoice, AdapterReport, adapters};
pub(crate) use arena::Arena;
pub use context::{Gpu, GpuOptions};
#[doc(hidden)]
pub use faults::{Call, Fault, Faults};
pub use landing::Deadline;
pub(crate) use landing::add_waker;
pub(crate) use native::Alarm;
pub use poison::Poison;
pub use program::{Profile, Program, ProgramOptions};
pub use slot::{Inputs, RunOutput, Slot};
/// The crate whose devices [`Gpu::from_device`] takes.
pub use wgpu;
