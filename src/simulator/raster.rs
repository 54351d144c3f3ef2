//! The picture's frame: how many pixels, and how much of the gel each of them shows.

use serde::{Deserialize, Serialize};

use crate::sensor;

/// Shortest and longest field of view in millimetres along the frame's longer side.
pub const FIELD_MM: [f64; 2] = [sensor::FIELD_MM[0] as f64, sensor::FIELD_MM[1] as f64];
/// Shortest and longest side of a frame that is drawn, in pixels.
pub const SIDE_PX: [usize; 2] = [32, 4000];

/// A box in pixels: `x0, y0, x1, y1` as edges of pixels, so the whole picture is 0 to its size.
pub type PixelBox = [f64; 4];

/// A sensor's frame: the picture's size and its scale on the undeformed gel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Raster {
    /// Pixels along x.
    pub width: usize,
    /// Pixels along y.
    pub height: usize,
    /// Side of a pixel on the undeformed gel, in millimetres.
    pub mm_per_pixel: f64,
}

impl Raster {
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

    /// Whether its sides are within [`SIDE_PX`].
    pub fn is_drawable(&self) -> bool {
        [self.width, self.height].iter().all(|side| (SIDE_PX[0]..=SIDE_PX[1]).contains(side))
    }

    /// Millimetres along the longer side.
    pub fn longer_mm(&self) -> f64 {
        self.longer_px() as f64 * self.mm_per_pixel
    }

    /// Place on the flat gel, in millimetres from the frame's middle, that a place in the picture shows.
    pub fn to_mm(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [width, height] = self.size_px();
        [(x - width / 2.0) * self.mm_per_pixel, (y - height / 2.0) * self.mm_per_pixel]
    }

    /// Place in the picture that shows a place on the flat gel, [`to_mm`](Self::to_mm) backwards.
    pub fn to_px(&self, place_mm: [f64; 2]) -> [f64; 2] {
        let (size_px, size_mm) = (self.size_px(), self.size_mm());
        [0, 1].map(|axis| (place_mm[axis] / size_mm[axis] + 0.5) * size_px[axis])
    }
}
