//! Everything that touches wgpu: the device, programs and their runs.
//!
//! A [`Program`] is what a graph was lowered to, on a device: pipelines and weights, shared by all runs.
//! A [`Slot`] is one run's worth of memory, so that several pictures can be in flight; slots of programs
//! that take turns share an `Arena`.
//!
//! | file | what it holds |
//! |---|---|
//! | `quirks` | what is one driver's affair |
//! | `adapter` | which adapters there are, what they give, and which is taken |
//! | `faults`, `clock`, `deadline`, `landing` | calls that fail in tests; when and what waiting futures hear |
//! | `loss` | whether a device is gone, and why |
//! | `poller` | waits for a device in a thread |
//! | `browser` | `poller` and `clock` in a browser, which waits for a device by itself |
//! | `device` | the open device: its queue, turns, error scopes |
//! | `memory` | buffers and textures, and how bytes come to lie there |
//! | `pipeline` | shaders compiled, each once a device |
//! | `context` | [`Gpu`]: a device with its pipelines |
//! | `poison` | what memory holds before a run, in tests |
//! | `program` | what a graph was lowered to, on a device |
//! | `arena` | memory that slots share |
//! | `slot` | one run's worth of memory, and the run |

mod adapter;
mod arena;
#[cfg(target_family = "wasm")]
mod browser;
#[cfg(not(target_family = "wasm"))]
mod clock;
mod context;
mod deadline;
mod device;
mod faults;
mod landing;
mod loss;
mod memory;
mod pipeline;
mod poison;
#[cfg(not(target_family = "wasm"))]
mod poller;
mod program;
mod quirks;
mod slot;

#[cfg(target_family = "wasm")]
use browser::{clock, poller};

pub use adapter::{AdapterChoice, AdapterReport, adapters};
pub(crate) use arena::Arena;
pub(crate) use clock::Alarm;
pub use context::Gpu;
pub use deadline::Deadline;
pub use device::GpuOptions;
#[doc(hidden)]
pub use faults::{Call, Fault, Faults};
pub(crate) use landing::add_waker;
pub use poison::Poison;
pub use program::{Profile, Program, ProgramOptions};
pub use slot::{Inputs, RunOutput, Slot};
/// The crate whose devices [`Gpu::from_device`] takes.
pub use wgpu;
