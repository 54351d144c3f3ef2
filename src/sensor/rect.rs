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

/// Pixels that some of `parts` cover.
pub(crate) fn area(parts: &[Rect]) -> f64 {
    // Between the columns where a part begins or ends all rows are alike.
    let mut columns: Vec<u32> =
        parts.iter().flat_map(|part| [part.x, part.x + part.width]).collect();
    columns.sort_unstable();
    let strips = columns.windows(2).map(|ends| {
        let across = |part: &&Rect| part.x <= ends[0] && ends[1] <= part.x + part.width;
        let mut rows: Vec<[u32; 2]> =
            parts.iter().filter(across).map(|part| [part.y, part.y + part.height]).collect();
        rows.sort_unstable();
        let (mut covered, mut end) = (0, 0);
        for [from, to] in rows {
            covered += to.saturating_sub(from.max(end));
            end = end.max(to);
        }
        f64::from(ends[1] - ends[0]) * f64::from(covered)
    });
    strips.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(x: u32, y: u32, width: u32, height: u32) -> Rect {
        Rect { x, y, width, height }
    }

    #[test]
    fn what_two_parts_share_by_hand() {
        let (a, b) = (rect(10, 20, 30, 40), rect(25, 5, 50, 20));
        // Columns 25 to 40, rows 20 to 25.
        assert_eq!(
            (a.within(&b), b.within(&a)),
            (Some(rect(25, 20, 15, 5)), Some(rect(25, 20, 15, 5)))
        );
        assert_eq!(a.within(&rect(40, 20, 5, 5)), None);
        assert_eq!(a.within(&rect(10, 60, 5, 5)), None);
    }

    /// Edges at 2.5 and 10, and at 7.5 and 22.5.
    #[test]
    fn a_part_of_a_scaled_picture_by_hand() {
        assert_eq!(rect(10, 20, 30, 40).scaled([0.25, 0.375], [25, 37]), rect(3, 8, 7, 15));
        // No part is empty, nor outside.
        assert_eq!(rect(99, 99, 1, 1).scaled([0.1, 0.1], [10, 10]), rect(9, 9, 1, 1));
    }

    #[test]
    fn middles_by_hand() {
        let part = rect(10, 20, 35, 8);
        assert_eq!(part.middle(), [27.5, 24.0]);
        assert_eq!(part.central(2.0), rect(19, 20, 16, 8));
    }

    #[test]
    fn what_parts_cover_counts_once() {
        let rect = |x, y, width, height| Rect { x, y, width, height };
        assert_eq!(area(&[]), 0.0);
        assert_eq!(area(&[rect(3, 5, 4, 2)]), 8.0);
        // A common corner of 2 × 3, one inside another, and one apart in the same columns.
        let parts = [rect(0, 0, 10, 10), rect(8, 7, 10, 10), rect(2, 2, 3, 3), rect(0, 20, 10, 1)];
        assert_eq!(area(&parts), 100.0 + 100.0 - 6.0 + 10.0);
        assert_eq!(area(&[rect(0, 0, 2, 2), rect(2, 0, 2, 2), rect(0, 0, 2, 2)]), 8.0);
    }
}
