//! What can be forced of a picture by name.

use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Thickness of the gel where nothing is strong: the paper's.
pub(super) const MILD_GEL_MM: f64 = 4.0;

/// What a picture's shading comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optics {
    /// A mixture of a measured sensor's lights.
    Measured,
    /// Lamps at finite angles over a matt coating.
    Lamps,
}

/// How the gel's surface follows what presses on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mechanics {
    /// The elastic layer in contact.
    Elastic,
    /// The part's own relief, smoothed: no mechanics, but what other renderers draw.
    Smoothed,
}

/// The recess of a screw's head.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Drive {
    /// A cross.
    Cross,
    /// One slot.
    Slot,
    /// A hexagon.
    Hex,
}

impl Drive {
    pub(super) fn sample(rng: &mut Pcg64) -> Self {
        match rng.random_range(0..3) {
            0 => Self::Cross,
            1 => Self::Slot,
            _ => Self::Hex,
        }
    }
}
