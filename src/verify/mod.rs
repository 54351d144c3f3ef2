//! What holds a device to the reference, and what times it.
//!
//! | module | what it holds |
//! |---|---|
//! | `rounded` | tensors as a device stores or multiplies them |
//! | [`check`] | each kernel on a device against its reference, case by case |
//! | [`comparison`] | the whole network on a device, by operation and by outcome, against the reference |
//! | [`profile`], [`tune`] | where a graph's time goes on a device; which kernels are fastest on it |
//! | [`laboratory`] | these for a detector's own network |

pub mod check;
pub mod comparison;
pub mod laboratory;
pub mod profile;
mod rounded;
pub mod tune;

pub use laboratory::{Comparison, Stages, compare, stages};
