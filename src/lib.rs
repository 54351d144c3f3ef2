//! Finds snap joints in pictures of a GelSight-like tactile sensor, on any GPU.
//!
//! The crate implements SMR-Net (Hou, "SMR-Net: Robot Snap Detection Based on Multi-Scale Features
//! and Self-Attention Network"): Faster R-CNN on a ResNet-34 with attention, multi-scale fusion and
//! a learned weighting of the scales. Every operation, from resizing the picture to the last
//! non-maximum suppression, is a WGSL compute shader; a picture takes one submit and one readback.
//!
//! ```no_run
//! use smr_gpu::{Config, GpuDetector, picture};
//!
//! let detector = GpuDetector::new(Config::new("weights/smrnet.safetensors"))?;
//! let picture = picture::read("image.png")?;
//! for snap in detector.detect(&picture)?.detections {
//!     println!("{} {:.2} at {:?} mm", snap.class, snap.score, snap.center_mm);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Architecture
//! Imports run one way, from top to bottom:
//!
//! | module | what it holds |
//! |---|---|
//! | [`error`], [`shape`], [`tensor`] | typed errors, shapes, tensors in host memory |
//! | [`files`] | reading files that are files, of a size looked at first; writing them whole or not at all |
//! | [`cpu`] | the reference of each operation: from its definition, with f64 sums |
//! | [`gpu`] | the device, shaders and their reflection, recordings, plans; alone to name wgpu |
//! | [`ops`] | each operation: parameters, shape check, dispatches, error bound, cases |
//! | [`graph`] | operations over named tensors, recorded for the GPU or walked on the CPU |
//! | [`host`] | the graph in f32 on this machine's CPU, for machines without an adapter |
//! | [`model`] | SMR-Net's stages, its configuration and its weights |
//! | [`comparison`] | the whole network on a device, by operation and by outcome, against the reference |
//! | [`detector`] | [`GpuDetector`] |
//! | [`picture`] | pictures from files that nobody vouches for |
//! | [`sensor`] | the simulated sensor: gel, contact, optics, camera, snaps |
//! | [`coco`] | labelled pictures from COCO annotations |
//! | [`metrics`] | intersection over union, average precision, centre error |
//!
//! An operation is one stem in four places: `wgsl/conv2d.wgsl`, `src/ops/conv2d.rs`,
//! `src/cpu/conv2d.rs`, `tests/ops/conv2d.rs`. The network is built once, as a [`graph::Graph`];
//! both executors run that one graph, so they cannot drift apart.
//!
//! # How the paper was read
//! Where its text leaves a choice, the module that makes it says so: [`model`] for the stages,
//! [`ops`] for conventions of single operations (torchvision's throughout; RoIAlign with
//! `aligned = true`, which is not torchvision's default), [`sensor`] for the data, which the paper
//! does not publish.
#![warn(missing_docs)]

pub mod check;
pub mod coco;
pub mod comparison;
pub mod cpu;
pub mod detector;
pub mod error;
pub mod files;
pub mod gpu;
pub mod graph;
pub mod host;
pub mod kernels;
pub mod lower;
pub mod metrics;
pub mod model;
pub mod ops;
pub mod picture;
pub mod sensor;
pub mod shader;
pub mod shape;
pub mod tensor;

pub use detector::{Comparison, Config, Detection, Detections, Device, GpuDetector, WeightSource};
pub use error::{Error, Result};

/// The README's example runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
