//! The two kinds of snap, as rigid height fields.
//!
//! Size must not give the class away. Both kinds draw their footprint's area from one
//! distribution, 20 to 49 mm²: a hook of 6–10 × 3–5 mm, a stud of 5–8 mm diameter. Some studs
//! are ovalised to the same area, so that proportions overlap too, and a turned hook's box is as
//! square as a stud's. A hook of which only the barb touches is small; such are few.

use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::profile::{rectangle, rounded_edge, smooth_min};

/// A kind of snap joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Kind {
    /// Cantilever hook.
    A,
    /// Annular split-ring stud.
    B,
}

impl Kind {
    /// The category's number in COCO files.
    pub fn category_id(self) -> u32 {
        match self {
            Self::A => 1,
            Self::B => 2,
        }
    }

    /// The category's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }
}

/// Kind A: an arm with a barb at its tip, seen from the barb's side. Lengths in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Hook {
    /// Length of the arm with its barb, along x.
    pub length: f64,
    /// Width at the barb, along y.
    pub width: f64,
    /// Width at the root over the width at the barb, at least 1.
    pub taper: f64,
    /// Thickness of the arm.
    pub thickness: f64,
    /// Height of the barb over the arm.
    pub undercut: f64,
    /// Length of the barb's flat top.
    pub land: f64,
    /// Angle of the lead-in slope, in radians.
    pub lead_in: f64,
    /// Radius of the edges.
    pub fillet: f64,
    /// Radius of the arm's corners.
    pub corner: f64,
}

impl Hook {
    fn sample(rng: &mut Pcg64, area: f64) -> Self {
        // All lengths 6–10 and widths 3–5 with this area.
        let length = rng.random_range((area / 5.0f64).max(6.0)..=(area / 3.0).min(10.0));
        Self {
            length,
            width: area / length,
            taper: if rng.random_bool(0.5) { rng.random_range(1.0..1.15) } else { 1.0 },
            thickness: rng.random_range(1.0..1.5),
            undercut: rng.random_range(0.5..0.8),
            land: rng.random_range(0.3..0.9),
            lead_in: rng.random_range(25f64..35.0).to_radians(),
            fillet: rng.random_range(0.1..0.25),
            corner: rng.random_range(0.15..0.5),
        }
    }

    /// Place along x of the barb's retention face, the arm's middle being 0.
    fn face(&self) -> f64 {
        let drop = self.undercut + 0.35 * self.thickness;
        self.length / 2.0 - drop / self.lead_in.tan() - self.land
    }

    fn height(&self, x: f64, y: f64) -> f64 {
        let half = self.length / 2.0;
        // From 0 at the barb's tip to 1 at the root.
        let along = ((half - x) / self.length).clamp(0.0, 1.0);
        let half_width = self.width / 2.0 * (1.0 + (self.taper - 1.0) * along);
        let outline = rectangle(x, y, [half, half_width], self.corner);
        let face = self.face();
        let land_end = face + self.land;
        let slope = (land_end - x) * self.lead_in.tan();
        let barb = smooth_min(0.0, slope, 0.12) + rounded_edge(x - face, self.fillet);
        let arm = smooth_min(-self.undercut, slope, 0.12);
        barb.max(arm) + rounded_edge(outline, self.fillet)
    }
}

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
    fn sample(rng: &mut Pcg64, area: f64) -> Self {
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

    fn height(&self, x: f64, y: f64) -> f64 {
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

/// A snap's shape in its own coordinates: x and y across the gel, heights towards it, the highest
/// point at 0.
#[derive(Debug, Clone, PartialEq)]
pub enum Snap {
    /// Kind A.
    Hook(Hook),
    /// Kind B.
    Stud(Stud),
}

impl Snap {
    /// Draws a snap of this kind. The footprint's area is uniform in 20 to 49 mm², whatever the
    /// kind.
    pub fn sample(rng: &mut Pcg64, kind: Kind) -> Self {
        let area = rng.random_range(20.0..49.0);
        match kind {
            Kind::A => Self::Hook(Hook::sample(rng, area)),
            Kind::B => Self::Stud(Stud::sample(rng, area)),
        }
    }

    /// Draws how deep the highest point goes into the gel, in millimetres.
    pub fn sample_depth(&self, rng: &mut Pcg64) -> f64 {
        match self {
            // Mostly the arm touches too; in the others only the barb, deep enough to be seen.
            Self::Hook(hook) if rng.random_bool(0.92) => hook.undercut + rng.random_range(0.2..0.8),
            Self::Hook(hook) => rng.random_range(0.35..hook.undercut - 0.05),
            Self::Stud(_) => rng.random_range(0.2..1.4),
        }
    }

    /// The kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Hook(_) => Kind::A,
            Self::Stud(_) => Kind::B,
        }
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Hook(hook) => hook.height(x, y),
            Self::Stud(stud) => stud.height(x, y),
        }
    }

    /// Radius of a circle round the origin that holds the part, in millimetres.
    pub fn reach(&self) -> f64 {
        match self {
            Self::Hook(h) => (h.length / 2.0).hypot(h.width * h.taper / 2.0),
            Self::Stud(s) => s.diameter / 2.0,
        }
    }
}
