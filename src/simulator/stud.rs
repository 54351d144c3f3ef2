//! Kind B, an annular split-ring stud, as a rigid height field.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::forced::{Forced, Span};
use super::outline::{rounded_edge, smooth_min};

/// Kind B: a split ring with a bead round its top, seen end on. Lengths in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Stud {
    /// Outer diameter along x, bead included.
    pub diameter: f64,
    /// Outer diameter along x over that along y.
    pub oval: f64,
    /// How far the bead stands out from the ring.
    pub bead: f64,
    /// Thickness of the ring without its bead.
    pub wall: f64,
    /// Angle of the bead's lead-in from the flat top, in radians.
    pub lead_in: f64,
    /// Number of slots.
    pub slots: u32,
    /// Width of a slot.
    pub slot_width: f64,
    /// Direction of the first slot, in radians.
    pub slot_phase: f64,
    /// Radius of the edges.
    pub fillet: f64,
}

impl Stud {
    pub(super) fn sample(rng: &mut Pcg64, area: f64) -> Self {
        let oval = if rng.random_bool(0.6) { rng.random_range(1.0..1.5) } else { 1.0 };
        Self {
            diameter: (4.0 / std::f64::consts::PI * area * oval).sqrt(),
            oval,
            bead: rng.random_range(0.3..0.5),
            wall: rng.random_range(0.6..1.1),
            lead_in: rng.random_range(25f64..45.0).to_radians(),
            slots: rng.random_range(2..=4),
            slot_width: rng.random_range(0.6..1.2),
            slot_phase: rng.random_range(0.0..std::f64::consts::TAU),
            fillet: rng.random_range(0.1..0.2),
        }
    }

    pub(super) fn sample_wide(
        rng: &mut Pcg64,
        area: f64,
        slots: Option<u32>,
        hole: Option<f64>,
        bead: Option<Span>,
    ) -> Self {
        let oval = if rng.random_bool(0.5) { rng.random_range(1.0..1.5) } else { 1.0 };
        let diameter = (4.0 / std::f64::consts::PI * area * oval).sqrt();
        let drawn = rng.random_range(0.2..0.5);
        let bead = bead.map_or(drawn, |span| span.sample(rng));
        // Across the oval, where the hole is narrowest.
        let narrow = diameter / oval;
        let wall = match hole {
            None if rng.random_bool(0.6) => rng.random_range(0.4..1.4),
            None => (narrow - rng.random_range(1.0..2.5)) / 2.0 - bead,
            Some(hole) => (narrow - hole) / 2.0 - bead,
        };
        let wall = wall.clamp(0.3, (narrow / 2.0 - bead - 0.5).max(0.3));
        let slots = slots.unwrap_or_else(|| match rng.random_range(0..10) {
            0..3 => 2,
            3..5 => 3,
            5..8 => 4,
            _ => 6,
        });
        // Slots leave two thirds of the ring's circumference, and are narrower than the hole: a
        // disc with a slot across is a screw.
        let hole = narrow - 2.0 * (wall + bead);
        let most = (narrow * std::f64::consts::PI / (3.0 * f64::from(slots))).min(0.5 * hole);
        let most = most.clamp(0.45, 1.3);
        Self {
            diameter,
            oval,
            bead,
            wall,
            lead_in: rng.random_range(20f64..50.0).to_radians(),
            slots,
            slot_width: rng.random_range(0.4..most),
            slot_phase: rng.random_range(0.0..std::f64::consts::TAU),
            fillet: rng.random_range(0.05..0.2),
        }
    }

    /// The same ring without slots.
    pub fn unslotted(rng: &mut Pcg64, forced: &Forced) -> Self {
        let area = rng.random_range(14.0..60.0);
        Self { slots: 0, ..Self::sample_wide(rng, area, Some(2), None, forced.bead) }
            .edged(rng, forced)
    }

    pub(super) fn scaled(self, factor: f64) -> Self {
        Self {
            diameter: factor * self.diameter,
            bead: factor * self.bead,
            wall: factor * self.wall,
            slot_width: factor * self.slot_width,
            fillet: factor * self.fillet,
            ..self
        }
    }

    /// With the edges that are forced; an edge is at most round.
    pub(super) fn edged(mut self, rng: &mut Pcg64, forced: &Forced) -> Self {
        if let Some(fillet) = forced.fillet {
            self.fillet = fillet.sample(rng).min((self.wall + self.bead) / 2.0);
        }
        self
    }

    /// Diameter of the hole where it is narrowest.
    pub fn hole_mm(&self) -> f64 {
        (self.diameter / self.oval - 2.0 * (self.wall + self.bead)).max(0.0)
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let radius = self.diameter / 2.0;
        // Distance to the oval by its implicit function over the function's gradient.
        let v = y * self.oval;
        let rho = x.hypot(v);
        if rho < 1e-9 {
            return rounded_edge(self.wall + self.bead - radius, self.fillet);
        }
        let gradient = x.hypot(v * self.oval) / rho;
        let outer = (radius - rho) / gradient;
        let inner = self.wall + self.bead - outer;
        let mut outline = outer.min(inner);
        for i in 0..self.slots {
            let angle =
                self.slot_phase + f64::from(i) * std::f64::consts::TAU / f64::from(self.slots);
            let (sin, cos) = angle.sin_cos();
            if x * cos + y * sin > 0.0 {
                outline = outline.min((x * sin - y * cos).abs() - self.slot_width / 2.0);
            }
        }
        let slope = (outer - self.bead) * self.lead_in.tan();
        smooth_min(0.0, slope, 0.1) + rounded_edge(outline, self.fillet)
    }
}
