//! The network in f32, or with products in bf16 or of 8 bits, on this machine's CPU, for machines without an adapter.
//!
//! A [`CpuPlan`] is a [`Graph`] made ready: each operation by a kernel with
//! its weights packed, each tensor in a buffer that is reused when it is dead. Maps lie with a
//! pixel's channels side by side, so that a convolution is a matrix product over them; where a
//! kernel wants the other order, the plan puts a conversion.
//!
//! | file | what it holds |
//! |---|---|
//! | `kernel`, `scratch` | what every kernel offers, memory that stays for the next |
//! | `words`, `tiles` | numbers as they are multiplied, f32, bf16 or of 8 bits; their products |
//! | `gemm`, `packs` | matrix products, weights packed for them |
//! | `epilogue`, `winograd`, `conv2d`, `linear` | convolutions and fully connected layers, as matrix products |
//! | `crop_resize` | the network's input |
//! | `pooling`, `maps` | CBAM's poolings and gates, the largest in windows, interpolation, weighted sums |
//! | `proposals`, `roi_align` | the best anchors, and features of each box |
//! | `reference` | everything else, which is small: as [`crate::engine::reference`] does |
//! | `select` | which of them computes an operation |
//! | `plan` | [`CpuPlan`] |
//!
//! It knows no GPU. Results are within the bounds to which a shader is held, but not bit for bit
//! those of another machine: the matrix product chooses its order by the CPU.

mod conv2d;
mod crop_resize;
mod epilogue;
mod gemm;
mod kernel;
mod linear;
mod maps;
mod packs;
mod plan;
mod pooling;
mod proposals;
mod reference;
mod roi_align;
mod scratch;
mod select;
mod tiles;
mod winograd;
mod words;

#[cfg(doc)]
use crate::engine::graph::Graph;

pub use plan::CpuPlan;
pub(crate) use plan::Given;
pub(crate) use words::in_8_bits;
pub use words::multiplies;
