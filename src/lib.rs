//! Finds snap joints in pictures of a GelSight-like tactile sensor, on any GPU.
//!
//! The crate implements SMR-Net (Hou, "SMR-Net: Robot Snap Detection Based on Multi-Scale Features
//! and Self-Attention Network"): Faster R-CNN on a ResNet-34 with attention, multi-scale fusion and
//! a learned weighting of the scales. Every operation, from resizing the picture to the last
//! non-maximum suppression, is a WGSL compute shader; each look of the network is one submit and one readback.
//!
//! ```no_run
//! # #[cfg(feature = "picture")] {
//! use smr_gpu::{Config, GpuDetector, picture};
//!
//! let detector = GpuDetector::new(Config::new("weights/smrnet.safetensors"))?;
//! let picture = picture::read("image.png")?;
//! for snap in detector.detect(&picture)?.detections {
//!     println!("{} {:.2} at {:?} mm", snap.class, snap.score, snap.center_mm);
//! }
//! # }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//! A program that embeds the detector and has its pictures in memory needs none of these
//! (`default-features = false`): [`GpuDetector::detect_frame`] takes a camera's bytes.
//!
//! | feature | what it adds |
//! |---|---|
//! | `image` | [`GpuDetector::detect`], which takes the pictures of the crate [`image`] |
//! | `picture` | [`picture`]: pictures from PNG, JPEG, BMP and TIFF files; with `image` |
//! | `cpu` | [`Device::Cpu`]: the network on this machine's cores, by [`host`] |
//! | `serde` | [`Detections`] and what is in them can be serialised |
//! | `eval` | [`coco`] and [`metrics`]: labelled pictures, and how well a detector does on them |
//! | `simulator` | [`simulator`]: the simulated sensor; with `picture` |
//! | `cli` (default) | the program `smr-gpu`; with all of the others |
//!
//! # Architecture
//! From what all else uses to what uses all else:
//!
//! | module | what it holds |
//! |---|---|
//! | [`error`], [`shape`], [`tensor`] | typed errors, shapes, tensors in host memory |
//! | [`precision`] | how numbers are stored on a GPU: f32 or f16 |
//! | [`files`] | reading files that are files, of a size looked at first; writing them whole or not at all |
//! | [`cpu`] | the reference of each operation: from its definition, with f64 sums |
//! | [`ops`] | each operation: parameters, shape check, error bound, cases |
//! | [`graph`] | operations over named tensors, recorded for the GPU or walked on the CPU |
//! | [`shader`] | WGSL put together from its parts, checked and reflected by naga |
//! | [`kernels`], [`lower`] | each operation's kernels and their dispatches; the kernels chosen for a graph |
//! | [`gpu`] | the device, pipelines, memory, recordings, plans; alone to name wgpu |
//! | [`profile`], [`tune`] | where a graph's time goes on a device; which kernels are fastest on it |
//! | [`host`] | the graph in f32 on this machine's CPU, for machines without an adapter |
//! | [`check`] | each kernel on a device against its reference, case by case |
//! | [`model`] | SMR-Net's stages, its configuration and its weights |
//! | [`comparison`] | the whole network on a device, by operation and by outcome, against the reference |
//! | [`scale`] | how many millimetres a pixel shows, which part of a frame is gel, and how each is known |
//! | [`frame`] | pictures in memory, as cameras give them; what their bytes mean says [`PixelFormat`] |
//! | [`picture`] | pictures from untrusted files |
//! | [`sensor`] | what a sensor's pictures show: how much gel, and where |
//! | [`detector`] | [`GpuDetector`] |
//! | [`simulator`] | the simulated sensor: gel, contact, optics, camera, snaps |
//! | [`metrics`] | intersection over union, average precision, centre error |
//! | [`coco`] | labelled pictures from COCO annotations |
//! | [`evaluation`] | figures with their intervals, by condition; calibration of scores and deviations |
//! | [`tradeoff`] | error against run time, and which way to run a network to choose |
//!
//! An operation is one stem in five places: `wgsl/conv2d/`, `src/kernels/conv2d/`,
//! `src/ops/conv2d.rs`, `src/cpu/conv2d.rs`, `tests/ops/conv2d.rs`. The network is built once, as a
//! [`graph::Graph`]; both executors run that one graph, so they cannot drift apart.
//!
//! # How the paper was read
//! Where its text leaves a choice, the module that makes it says so: [`model`] for the stages,
//! [`ops`] for conventions of single operations (torchvision's throughout; RoIAlign with
//! `aligned = true`, which is not torchvision's default), [`simulator`] for the data, which the paper
//! does not publish.
#![warn(missing_docs)]

pub mod check;
#[cfg(feature = "eval")]
pub mod coco;
pub mod comparison;
mod cores;
pub mod cpu;
pub mod detector;
pub mod error;
#[cfg(feature = "eval")]
pub mod evaluation;
pub mod files;
pub mod frame;
pub mod gpu;
pub mod graph;
#[cfg(feature = "cpu")]
pub mod host;
pub mod kernels;
mod lock;
pub mod lower;
#[cfg(feature = "eval")]
pub mod metrics;
#[cfg(feature = "serde")]
mod milliseconds;
pub mod model;
pub mod ops;
#[cfg(feature = "picture")]
pub mod picture;
mod pixel_format;
pub mod precision;
pub mod profile;
mod rect;
pub mod scale;
pub mod sensor;
pub mod shader;
pub mod shape;
#[cfg(feature = "simulator")]
pub mod simulator;
pub mod tensor;
#[cfg(feature = "eval")]
pub mod tradeoff;
pub mod tune;

pub use detector::{
    Comparison, Config, Detection, Detections, Device, GpuDetector, Scene, Stream, WeightSource,
};
pub use error::{Error, Result};
pub use frame::Frame;
/// The crate whose pictures [`GpuDetector::detect`] takes.
#[cfg(feature = "image")]
pub use image;
pub use pixel_format::PixelFormat;
pub use precision::Precision;
pub use rect::Rect;
pub use scale::{Gel, Origin, Scale};
pub use sensor::Sensor;

/// The README's example runs as a test.
#[cfg(all(doctest, feature = "picture"))]
#[doc = include_str!("../README.md")]
struct Readme;
