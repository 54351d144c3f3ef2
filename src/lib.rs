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
//! (`default-features = false`): [`GpuDetector::detect`] takes a camera's bytes.
//!
//! | feature | what it adds |
//! |---|---|
//! | `image` | [`GpuDetector::detect`], which takes the pictures of the crate [`image`] |
//! | `picture` | [`picture`]: pictures from PNG, JPEG, BMP and TIFF files; with `image` |
//! | `cpu` | [`Device::Cpu`]: the network on this machine's cores, by [`engine::cpu`] |
//! | `embedded-weights` (default) | the small network is part of the program: [`smr::catalog`] |
//! | `serde` | [`Detections`] and what is in them can be serialised |
//! | `eval` | [`evaluation`]: labelled pictures, and how well a detector does on them |
//! | `simulator` | [`simulator`]: the simulated sensor; with `picture` |
//! | `cli` (default) | the program `smr-gpu`; with all of the others but `embedded-weights` |
//!
//! # Architecture
//! From what all else uses to what uses all else:
//!
//! | module | what it holds |
//! |---|---|
//! | [`error`] | typed errors |
//! | [`files`] | reading files that are files, of a size looked at first; writing them whole or not at all |
//! | [`engine`] | operations, their kernels, and what runs a graph of them; it knows nothing of snaps |
//! | [`picture`] | pictures from untrusted files |
//! | [`sensor`] | frames in memory; which part of them is gel, at which scale, and how that is known |
//! | [`smr`] | the model: SMR-Net's stages, its configuration and its weights |
//! | [`detector`] | [`GpuDetector`]: a frame in, snaps out |
//! | [`verify`] | what holds a device to the reference, and what times it |
//! | [`evaluation`] | labelled pictures, figures with their intervals, error against run time |
//! | [`simulator`] | the simulated sensor: gel, contact, optics, camera, snaps |
//! | `cli` | the program `smr-gpu` |
//!
//! # How the paper was read
//! Where its text leaves a choice, the module that makes it says so: [`smr`] for the stages,
//! [`engine::ops`] for conventions of single operations (torchvision's throughout; RoIAlign with
//! `aligned = true`, which is not torchvision's default), [`simulator`] for the data, which the paper
//! does not publish.
#![warn(missing_docs)]

pub mod detector;
pub mod engine;
pub mod error;
#[cfg(feature = "eval")]
pub mod evaluation;
pub mod files;
#[cfg(feature = "picture")]
pub mod picture;
pub mod sensor;
#[cfg(feature = "simulator")]
pub mod simulator;
pub mod smr;
pub mod verify;

pub use detector::{CachingDetector, Config, Detection, Detections, Device, GpuDetector, Savings};
pub use engine::precision::Precision;
pub use error::{Error, Result};
/// The crate whose pictures [`GpuDetector::detect`] takes.
#[cfg(feature = "image")]
pub use image;
pub use sensor::{Frame, Gel, Origin, PixelFormat, Rect, Scale, Sensor};
pub use smr::WeightSource;

/// The README's example runs as a test.
#[cfg(all(doctest, feature = "picture"))]
#[doc = include_str!("../README.md")]
struct Readme;
