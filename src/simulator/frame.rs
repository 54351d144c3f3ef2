//! The picture's frame: how many pixels, and how much of the gel each of them shows.

use serde::{Deserialize, Serialize};

/// Shortest and longest field of view in millimetres along the frame's longer side.
pub const FIELD_MM: [f64; 2] = [10.0, 60.0];

/// A sensor's frame: the picture's size and its scale on the undeformed gel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Pixels along x.
    pub width: usize,
    /// Pixels along y.
    pub height: usize,
    /// Side of a pixel on the undeformed gel, in millimetres.
    pub mm_per_pixel: f64,
}

impl Frame {
    /// The paper's sensor: 40 × 40 mm of gel on 1000 × 1000 pixels.
    pub const PAPER: Self = Self { width: 1000, height: 1000, mm_per_pixel: 0.04 };
    /// GelSight Mini: 20.3 × 15.2 mm on 320 × 240 pixels.
    pub const GELSIGHT_MINI: Self = Self { width: 320, height: 240, mm_per_pixel: 0.0634 };

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Pixels along x and y.
    pub fn size_px(&self) -> [f64; 2] {
        [self.width as f64, self.height as f64]
    }

    /// Millimetres along x and y.
    pub fn size_mm(&self) -> [f64; 2] {
        self.size_px().map(|side| side * self.mm_per_pixel)
    }

    /// Pixels along the longer side.
    pub fn longer_px(&self) -> usize {
        self.width.max(self.height)
    }

    /// Millimetres along the longer side.
    pub fn longer_mm(&self) -> f64 {
        self.longer_px() as f64 * self.mm_per_pixel
    }

    /// Place on the flat gel, in millimetres from its middle, that a place in the picture shows.
    pub fn to_mm(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [width, height] = self.size_px();
        [(x - width / 2.0) * self.mm_per_pixel, (y - height / 2.0) * self.mm_per_pixel]
    }
}
