//! A fully connected layer.

mod gemm;
mod planar;

pub(super) use gemm::Gemm;
pub(super) use planar::Planar;
