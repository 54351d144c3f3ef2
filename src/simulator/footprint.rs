//! A part's outline on the gel, and how far it is from another's.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec2;

/// A part's outline on the gel: a turned rectangle, or an ellipse.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    /// In millimetres.
    pub center: DVec2,
    /// Half its size along its own x and y.
    pub half: [f64; 2],
    /// In radians.
    pub yaw: f64,
    /// Whether it is an ellipse.
    pub round: bool,
}

/// Directions that [`Footprint::distance`] tries beside the outlines' own.
const DIRECTIONS: u32 = 90;

impl Footprint {
    /// A rectangle.
    pub fn of(center: impl Into<DVec2>, half: [f64; 2], yaw: f64) -> Self {
        Self { center: center.into(), half, yaw, round: false }
    }

    /// A lower bound of the distance to another, by the axes of both; negative where they overlap.
    pub fn gap(&self, other: &Self) -> f64 {
        let axes = [self.yaw, self.yaw + FRAC_PI_2, other.yaw, other.yaw + FRAC_PI_2];
        self.parted(other, axes)
    }

    /// The distance to another, negative where they overlap: of convex outlines the most by which a direction
    /// parts them.
    pub fn distance(&self, other: &Self) -> f64 {
        let all = (0..DIRECTIONS).map(|i| PI * f64::from(i) / f64::from(DIRECTIONS));
        let offset = other.center - self.center;
        self.gap(other).max(self.parted(other, all.chain([offset.y.atan2(offset.x)])))
    }

    /// The most by which one of these directions parts both.
    fn parted(&self, other: &Self, directions: impl IntoIterator<Item = f64>) -> f64 {
        let offset = other.center - self.center;
        let parts = |angle: f64| {
            let along = offset.dot(DVec2::from_angle(angle)).abs();
            along - self.extent(angle) - other.extent(angle)
        };
        directions.into_iter().map(parts).fold(f64::NEG_INFINITY, f64::max)
    }

    /// How far it reaches from its centre in this direction.
    pub fn extent(&self, angle: f64) -> f64 {
        let (sin, cos) = (angle - self.yaw).sin_cos();
        let (a, b) = (self.half[0] * cos.abs(), self.half[1] * sin.abs());
        if self.round { a.hypot(b) } else { a + b }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squares of side 2, side by side and corner to corner; a disc of radius 1 before a corner.
    #[test]
    fn distances_by_hand() {
        let at = |center: [f64; 2]| Footprint::of(center, [1.0; 2], 0.0);
        let square = at([0.0; 2]);
        assert!((square.distance(&at([5.0, 0.0])) - 3.0).abs() < 1e-9);
        assert!((square.distance(&at([5.0, 5.0])) - 18f64.sqrt()).abs() < 1e-9);
        // By the axes alone a corner is as far as its nearer side.
        assert!((square.gap(&at([5.0, 5.0])) - 3.0).abs() < 1e-9);
        let disc = Footprint { round: true, ..at([4.0, 4.0]) };
        assert!((square.distance(&disc) - (18f64.sqrt() - 1.0)).abs() < 1e-9);
        assert!((square.distance(&at([1.5, 0.0])) + 0.5).abs() < 1e-9);
    }
}
