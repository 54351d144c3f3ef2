//! The reference: each operation from its definition, with f64 sums and no GPU.
//!
//! The functions take tensors that `ops` has checked; a shape that does not fit is a bug here.

mod conv2d;

pub use conv2d::{ConvShape, conv2d};
