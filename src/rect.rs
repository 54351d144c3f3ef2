//! Parts of pictures.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A part of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rect {
    /// Column of the left edge.
    pub x: u32,
    /// Row of the upper edge.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Rect {
    /// Whether it holds a pixel, and lies in a picture of this width and height.
    pub(crate) fn is_in(&self, width: u32, height: u32) -> bool {
        let fits = |at: u32, length: u32, all: u32| length > 0 && at < all && length <= all - at;
        fits(self.x, self.width, width) && fits(self.y, self.height, height)
    }

    /// Its middle, in pixels.
    pub(crate) fn middle(&self) -> [f32; 2] {
        [(self.x, self.width), (self.y, self.height)]
            .map(|(at, length)| at as f32 + length as f32 / 2.0)
    }

    /// What two parts of a picture share; `None` for no pixel.
    pub(crate) fn within(&self, other: &Self) -> Option<Self> {
        let side = |at: u32, length: u32, other_at: u32, other_length: u32| {
            let first = at.max(other_at);
            let end = (at + length).min(other_at + other_length);
            (end > first).then(|| (first, end - first))
        };
        let (x, width) = side(self.x, self.width, other.x, other.width)?;
        let (y, height) = side(self.y, self.height, other.y, other.height)?;
        Some(Self { x, y, width, height })
    }

    /// The largest part in its middle whose longer side is at most `aspect` times the shorter, in whole
    /// pixels; up and left by half a pixel where the middle is between two.
    pub(crate) fn central(&self, aspect: f32) -> Self {
        let most = (self.width.min(self.height) as f32 * aspect) as u32;
        let (width, height) = (self.width.min(most), self.height.min(most));
        let (x, y) = (self.x + (self.width - width) / 2, self.y + (self.height - height) / 2);
        Self { x, y, width, height }
    }

    /// The same part of a picture that was scaled to `frame`, in whole pixels.
    pub(crate) fn scaled(&self, [x, y]: [f64; 2], [width, height]: [u32; 2]) -> Self {
        let edge =
            |at: u32, scale: f64, all: u32| ((f64::from(at) * scale).round() as u32).min(all);
        let side = |at: u32, length: u32, scale: f64, all: u32| {
            let first = edge(at, scale, all - 1);
            (first, edge(at + length, scale, all).saturating_sub(first).max(1))
        };
        let (left, columns) = side(self.x, self.width, x, width);
        let (top, rows) = side(self.y, self.height, y, height);
        Self { x: left, y: top, width: columns, height: rows }
    }
}

impl fmt::Display for Rect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x, y, width, height } = self;
        write!(f, "{width} × {height} at ({x}, {y})")
    }
}
