//! Runs a graph of operations on a GPU, on this machine's cores, or with the f64 reference. It knows
//! nothing of snaps.
//!
//! | module | what it holds |
//! |---|---|
//! | `lock`, `cores`, `milliseconds`, `digest` | locks, threads, how times are serialised, hashes |
//! | [`shape`], [`tensor`], [`precision`] | shapes, tensors in host memory, how a GPU stores them: f32 or f16 |
//! | [`pixel_order`] | which bytes of a pixel are which colour |
//! | [`mod@reference`] | each operation from its definition, with f64 sums |
//! | [`ops`] | each operation: parameters, shape check, error bound, cases |
//! | [`graph`] | operations over named tensors |
//! | [`lifetimes`] | which tensors may share what holds them |
//! | [`shader`] | WGSL put together from its parts, checked and reflected by naga |
//! | [`kernels`] | what runs an operation on a device: its dispatches and their shaders |
//! | [`lower`] | the kernels chosen for a graph, and what memory its tensors share |
//! | [`gpu`] | the device, pipelines, memory, recordings; alone to name wgpu |
//! | [`tuned`] | the kernels that were measured to be fastest on an adapter, as a file |
//! | [`cpu`] | the graph in f32 on this machine's cores, for machines without an adapter |
//!
//! An operation is one stem in five places: `wgsl/conv2d/`, `src/engine/kernels/conv2d/`,
//! `src/engine/ops/conv2d.rs`, `src/engine/reference/conv2d.rs`, `tests/ops/conv2d.rs`. Every executor runs
//! the one [`graph::Graph`], so they cannot drift apart.

pub(crate) mod cores;
#[cfg(feature = "cpu")]
pub mod cpu;
pub(crate) mod digest;
pub mod gpu;
pub mod graph;
pub mod kernels;
pub mod lifetimes;
pub(crate) mod lock;
pub mod lower;
#[cfg(feature = "serde")]
pub(crate) mod milliseconds;
pub mod ops;
pub mod pixel_order;
pub mod precision;
pub mod reference;
pub mod shader;
pub mod shape;
pub mod tensor;
pub mod tuned;
