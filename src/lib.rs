//! Finds snap joints in pictures of a GelSight-like tactile sensor, on any GPU or on this machine's cores.
//!
//! ```no_run
//! use smr_gpu::{Config, Frame, GpuDetector, PixelFormat, Sensor};
//!
//! // Once: loads the weights, opens the device, compiles the shaders.
//! let detector = GpuDetector::new(Config {
//!     sensor: Sensor::named("gelsight-mini"),
//!     ..Config::find("small")?
//! })?;
//! // For each frame of a camera: its bytes, as they are.
//! let bytes = vec![0; 3280 * 2464 * 3];
//! let found = detector.detect(Frame::new(&bytes, 3280, 2464, PixelFormat::Bgr8))?;
//! for snap in &found {
//!     println!("{} {:.2} at {:?} mm", snap.class, snap.score, snap.center_mm);
//! }
//! # Ok::<(), smr_gpu::Error>(())
//! ```
//!
//! | to | take |
//! |---|---|
//! | build a detector | [`GpuDetector::new`] with a [`Config`]: weights ([`WeightSource`]), [`Device`], [`Sensor`], thresholds, what may be left out ([`Savings`]), [`Precision`] |
//! | find snaps | [`GpuDetector::detect`] a [`Frame`], of a camera's bytes in any [`PixelFormat`], or with the feature `image` a picture; [`GpuDetector::detect_async`] with an executor of your own; [`GpuDetector::detect_many`] for many, several in flight |
//! | follow a camera of which few frames change | [`CachingDetector`] |
//! | read what was found | [`Detections`] of [`Detection`]s: class, score, box in pixels, centre in millimetres, direction, each with its deviation |
//! | say what a pixel shows | [`Scale`] and its [`Origin`]; the part of the frame that is [`Gel`], a [`Rect`] |
//! | handle what goes wrong | [`Error`], which names the file, tensor or stage, with what was expected and what came |
//!
//! A detector is `Send` and `Sync`: share it behind an [`std::sync::Arc`]; as many pictures as
//! [`Config::in_flight`] says are computed at a time. A GPU that was lost is opened anew
//! ([`Config::rebuild_on_loss`]).
//!
//! # Features
//! A program that embeds the detector and has its pictures in memory needs none of these
//! (`default-features = false`).
//!
//! | feature | what it adds |
//! |---|---|
//! | `image` | [`GpuDetector::detect`] takes the pictures of the crate [`image`] |
//! | `picture` | [`picture`]: pictures from untrusted PNG, JPEG, BMP and TIFF files; with `image` |
//! | `cpu` | [`Device::Cpu`]: the network on this machine's cores |
//! | `embedded-weights` (default) | the small network is part of the program: [`Config::find`] |
//! | `serde` | [`Detections`] and what is in them can be serialised |
//! | `eval` | labelled pictures, and how well a detector does on them |
//! | `simulator` | the simulated sensor; with `picture` |
//! | `cli` (default) | the program `smr-gpu`; with all of the others but `embedded-weights` |
//!
//! # Architecture
//! The crate implements SMR-Net (Hou, "SMR-Net: Robot Snap Detection Based on Multi-Scale Features and
//! Self-Attention Network"): Faster R-CNN on a ResNet-34 with attention, multi-scale fusion and a learned
//! weighting of the scales. Every operation, from resizing the picture to the last non-maximum suppression, is
//! a WGSL compute shader; each run of the network is one submit and one readback. From what all else uses to
//! what uses all else:
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
//! What is not at the root is for the program, its tests and people who work on the engine: it is in
//! [`internals`] and changes with them.
//!
//! Where the paper's text leaves a choice, the module that makes it says so: [`smr`] for the stages,
//! [`engine::ops`] for conventions of single operations (torchvision's throughout; RoIAlign with
//! `aligned = true`, which is not torchvision's default), [`simulator`] for the data, which the paper
//! does not publish.
#![warn(missing_docs)]

#[doc(hidden)]
pub mod detector;
#[doc(hidden)]
pub mod engine;
#[doc(hidden)]
pub mod error;
#[cfg(feature = "eval")]
#[doc(hidden)]
pub mod evaluation;
#[doc(hidden)]
pub mod files;
#[cfg(feature = "picture")]
pub mod picture;
#[doc(hidden)]
pub mod sensor;
#[cfg(feature = "simulator")]
#[doc(hidden)]
pub mod simulator;
#[doc(hidden)]
pub mod smr;
#[doc(hidden)]
pub mod verify;

pub use detector::{
    CachingDetector, Config, Detection, Detections, Device, GpuDetector, Saving, Savings,
};
pub use engine::gpu::AdapterChoice;
pub use engine::precision::Precision;
pub use error::{Error, Result};
/// The crate whose pictures [`GpuDetector::detect`] takes.
#[cfg(feature = "image")]
pub use image;
pub use sensor::{Frame, Gel, Origin, PixelFormat, Rect, Scale, Sensor};
pub use smr::WeightSource;

/// Unstable: what the program, its tests and people who work on the engine use. It may change with any
/// version.
pub mod internals {
    #[cfg(feature = "eval")]
    #[doc(inline)]
    pub use crate::evaluation;
    #[cfg(feature = "simulator")]
    #[doc(inline)]
    pub use crate::simulator;
    #[doc(inline)]
    pub use crate::{detector, engine, files, sensor, smr, verify};
}

/// The guide's examples run as tests.
#[cfg(all(doctest, feature = "picture"))]
#[doc = include_str!("../docs/guide/rust.md")]
struct Guide;
