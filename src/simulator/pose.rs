//! Where a part lies on the gel.

use glam::DVec2;

/// Where a part's own frame lies on the gel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The frame's origin in millimetres from the gel's centre.
    pub origin_mm: DVec2,
    /// Direction of its x on the gel, of length 1; its y is a quarter turn further.
    pub x: DVec2,
}

impl Pose {
    /// The place on the gel of a point of the frame.
    pub fn gel(&self, [u, v]: [f64; 2]) -> DVec2 {
        self.origin_mm + self.x * u + self.x.perp() * v
    }

    /// The point of the frame at a place on the gel.
    pub fn own(&self, place: DVec2) -> DVec2 {
        let from = place - self.origin_mm;
        DVec2::new(self.x.dot(from), self.x.perp().dot(from))
    }
}
