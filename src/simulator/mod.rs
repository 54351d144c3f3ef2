//! The simulated sensor: rigid parts are pressed into the gel, lit, and photographed.
//!
//! | module | step | what it does |
//! |---|---|---|
//! | [`outline`], [`pose`], [`raster`], [`options`] | | edges of parts, where they lie, a picture's pixels, what is forced by name |
//! | [`mesh`], [`relief`], [`own_part`] | parts | a part from a CAD file or a height map, as a height field; the class that it makes |
//! | `error` | | typed errors |
//! | [`gel`], [`contact`], [`shadow`] | mechanics, light | the elastic layer, contact with a rigid body; shadows |
//! | [`forced`], [`conditions`] | conditions | what differs from sensor to sensor, forced or drawn |
//! | [`clutter`], [`turned`], [`fasteners`], [`hook`], [`stud`], [`snaps`], [`distractors`] | parts | height fields of what presses on the gel |
//! | [`smooth`] | mechanics | smoothed reliefs |
//! | [`camera`], [`optics`], [`lamps`] | camera, light | parallax, distortion, defocus, noise; brightness of a slope, measured or modelled |
//! | [`surface`], [`tone`] | mechanics, light | the gel's surface under a body; what its depth and its rims do to the brightness |
//! | [`scene`], `footprint`, [`layout`], `company` | layout | draws a plain or a wide scene and makes one rigid body of it; parts side by side |
//! | [`coating`], [`markers`] | coating | the coating, its wear and its dust; its print |
//! | [`label`] | labels | boxes round the imprints, seen through the same camera |
//! | [`calibrate`] | truth | fits the optics to real presses and measures the distance to them |
//! | [`appearance`], [`painter`], [`press`], [`given`] | picture | a sensor's look; the picture it takes of a surface; a press as frames; a user's own sensor |
//! | [`render`] | picture | all of it for one seed |
//! | [`dataset`] | files | folders of pictures with COCO labels |
//!
//! There are two distributions. *Plain* is the paper's sensor. *Wide* is wider than any one sensor,
//! so that what a detector learns from it is the snap and not the sensor: it need not be right
//! about any sensor, but some picture of it should be near each. A fifth of it is plain.
//!
//! Millimetres have their origin in the gel's centre, x to the right, y down, depth into the gel
//! and towards the camera. Pixels count from the picture's upper left corner; whole numbers are
//! edges of pixels.
//!
//! What is physics and what is drawn. The gel's surface, the sideways motion of its print under
//! pressure, parallax and noise are solved for or follow measurements, and so does the plain
//! shading. In wide pictures these are approximations of a renderer: shading beyond its measured
//! strength ([`optics`], scaled), Lambert and Phong lamps with a gain ([`lamps`]), shadows of
//! parallel rays with softened edges ([`shadow`]), the gel's slide with a part ([`render`]), a
//! quarter of surfaces that are smoothed reliefs without mechanics ([`smooth`]), the coating's
//! thickness as a blur, and light that is never scattered from slope to slope.
//!
//! What is left out: friction, the gel's edge as a free side, slopes so steep that linear
//! elasticity fails, refraction in the acrylic, and in plain pictures shadows. Texture, dust and
//! scratches stay where they are when the gel under them moves. And nothing draws what some sensors
//! have: curved gels, cameras that look askew, bubbles, motion blur, auto-exposure, JPEG with
//! subsampled colours, print other than dots on a square grid, pictures of differences. The distance
//! to real pictures that [`calibrate`] reports is what that costs on a ball; no real picture of a
//! snap has been compared.

pub mod appearance;
pub mod calibrate;
pub mod camera;
pub mod clutter;
pub mod coating;
mod company;
pub mod conditions;
pub mod contact;
pub mod dataset;
pub mod distractors;
pub mod fasteners;
pub mod forced;
pub mod gel;
pub mod given;
pub mod hook;
pub mod label;
pub mod lamps;
pub mod layout;
pub mod markers;
pub mod mesh;
pub mod optics;
pub mod options;
pub mod outline;
pub mod own_part;
pub mod painter;
pub mod pose;
pub mod press;
pub mod raster;
pub mod relief;
pub mod render;
pub mod scene;
pub mod shadow;
pub mod smooth;
pub mod snaps;
pub mod stud;
pub mod surface;
pub mod tone;
pub mod turned;

mod error;
mod footprint;

pub use error::Error;

/// Does `work` in rayon's current pool if this thread is of one, else in a pool of its own, of as many threads as
/// there are cores; of this thread alone where others cannot be had, which rayon's global pool would panic at.
pub(crate) fn on_threads<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    if rayon::current_thread_index().is_some() {
        return work();
    }
    let this_alone = || rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    match rayon::ThreadPoolBuilder::new().build().or_else(|_| this_alone().build()) {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}
