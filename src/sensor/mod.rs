//! The simulated sensor: rigid parts are pressed into the gel, lit, and photographed.
//!
//! | step | module | what it does |
//! |---|---|---|
//! | parts | [`snaps`], [`distractors`], [`profile`] | height fields of what presses on the gel |
//! | layout | [`scene`] | draws a scene from a seed and makes one rigid body of it |
//! | mechanics | [`gel`], [`contact`] | the gel's surface under that body |
//! | light | [`optics`], [`coating`] | brightness of a slope; the coating, its wear and its dust |
//! | camera | [`camera`] | parallax, defocus, noise, 8 bits |
//! | labels | [`label`] | boxes round the imprints, seen through the same camera |
//! | picture | [`render`] | all of it for one seed |
//! | files | [`dataset`] | folders of pictures with COCO labels |
//! | truth | [`calibrate`] | fits the optics to real presses and measures the distance to them |
//!
//! Millimetres have their origin in the gel's centre, x to the right, y down, depth into the gel
//! and towards the camera. Pixels count from the picture's upper left corner; whole numbers are
//! edges of pixels.
//!
//! What is left out: friction, the gel's edge as a free side, slopes so steep that linear
//! elasticity fails, refraction in the acrylic, and shadows. The distance to real pictures that
//! [`calibrate`] reports is what that costs on a ball; no real picture of a snap has been
//! compared.

pub mod calibrate;
pub mod camera;
pub mod coating;
pub mod conditions;
pub mod contact;
pub mod dataset;
pub mod distractors;
pub mod frame;
pub mod gel;
pub mod label;
pub mod lamps;
pub mod layout;
pub mod look;
pub mod markers;
pub mod optics;
pub mod profile;
pub mod render;
pub mod scene;
pub mod shadow;
pub mod smooth;
pub mod snaps;
pub mod surface;

mod error;

pub use error::Error;
