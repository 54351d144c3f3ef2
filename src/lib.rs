//! Snap joints in tactile pictures, found by WGSL compute shaders.
#![warn(missing_docs)]

pub mod cpu;
pub mod error;
pub mod gpu;
pub mod ops;
pub mod shape;
pub mod tensor;

pub use error::{Error, Result};
