//! The two kinds of snap, as rigid height fields.
//!
//! Size must not give the class away. Both kinds draw their footprint's area from one
//! distribution, 20 to 49 mm²: a hook of 6–10 × 3–5 mm, a stud of 5–8 mm diameter. Some studs
//! are ovalised to the same area, so that proportions overlap too, and a turned hook's box is as
//! square as a stud's; for that 17 % of studs are longer than 8 mm, and 9 % narrower than 5 mm. A
//! hook of which only the barb touches is small; such are few.
//!
//! [`Snap::sample_wide`] draws from wider ranges, 14 to 60 mm² for both kinds: other proportions
//! and barbs, hooks that lie on their side so that their profile presses, studs of 2, 3, 4 and 6
//! slots, with thin and thick walls and small holes.

use std::sync::Arc;

use rand::RngExt;
use rand_pcg::Pcg64;

use super::forced::{Forced, Span};
use super::outline::{rectangle, rounded_edge, smooth_min};
use super::own_part::OwnPart;

/// A kind of snap joint.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind {
    /// Cantilever hook.
    A,
    /// Annular split-ring stud.
    B,
    /// A part of one's own.
    Own(Arc<OwnPart>),
}

impl Kind {
    /// Its name, the class's.
    pub fn name(&self) -> &str {
        match self {
            Self::A => "A",
            Self::B => "B",
            Self::Own(part) => &part.name,
        }
    }
}

/// The shape of a hook's barb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Barb {
    /// A steep retention face, a land, and a lead-in that falls to the tip.
    Ramp,
    /// A block.
    Square,
    /// A half round across the arm.
    Round,
    /// A lead-in on both sides; the angle of the retention face, in radians.
    TwoRamps(f64),
}

/// Greatest undercut that is drawn, in millimetres.
const MOST_UNDERCUT_MM: f64 = 1.1;

/// Kind A: an arm with a barb at its tip, seen from the barb's side. Lengths in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Hook {
    /// Length of the arm with its barb, along x.
    pub length: f64,
    /// Width at the barb, along y.
    pub width: f64,
    /// Width at the root over the width of the arm behind the barb, at least 1.
    pub taper: f64,
    /// Width of the barb over that of the arm behind it, at least 1.
    pub flare: f64,
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
    /// Shape of the barb.
    pub barb: Barb,
    /// Whether the hook lies on its side: its profile presses, arm and barb at one height. The
    /// barb then stands towards y, or against it.
    pub on_side: Option<Side>,
    /// Whether the wall or plate that it grows from presses too. That is a part of its own.
    pub wall: bool,
}

/// Where the barb of a hook on its side stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Towards y.
    Left,
    /// Against y.
    Right,
}

impl Hook {
    fn sample(rng: &mut Pcg64, area: f64) -> Self {
        // All lengths 6–10 and widths 3–5 with this area.
        let length = rng.random_range((area / 5.0f64).max(6.0)..=(area / 3.0).min(10.0));
        Self {
            length,
            width: area / length,
            taper: if rng.random_bool(0.5) { rng.random_range(1.0..1.15) } else { 1.0 },
            flare: 1.0,
            thickness: rng.random_range(1.0..1.5),
            undercut: rng.random_range(0.5..0.8),
            land: rng.random_range(0.3..0.9),
            lead_in: rng.random_range(25f64..35.0).to_radians(),
            fillet: rng.random_range(0.1..0.25),
            corner: rng.random_range(0.15..0.5),
            barb: Barb::Ramp,
            on_side: None,
            wall: false,
        }
    }

    fn sample_wide(rng: &mut Pcg64, area: f64, on_side: bool, wall: bool) -> Self {
        let length = rng.random_range((area / 6.0f64).max(5.0)..=(area / 2.5).clamp(5.1, 12.0));
        let barb = match rng.random_range(0..10) {
            0..5 => Barb::Ramp,
            5..7 => Barb::Square,
            7 => Barb::Round,
            _ => Barb::TwoRamps(rng.random_range(35f64..65.0).to_radians()),
        };
        let side = if rng.random_bool(0.5) { Side::Left } else { Side::Right };
        Self {
            length,
            width: (area / length).clamp(2.5, 6.0),
            taper: if rng.random_bool(0.4) { rng.random_range(1.0..1.4) } else { 1.0 },
            flare: 1.0,
            thickness: rng.random_range(1.0..1.8),
            undercut: rng.random_range(0.45..1.1),
            land: rng.random_range(0.2..1.2),
            lead_in: rng.random_range(22f64..50.0).to_radians(),
            fillet: rng.random_range(0.05..0.3),
            corner: rng.random_range(0.1..0.8),
            barb,
            on_side: on_side.then_some(side),
            wall,
        }
    }

    /// With a barb drawn from twice as wide a range of shapes.
    fn with_varied_barb(mut self, rng: &mut Pcg64) -> Self {
        self.barb = match rng.random_range(0..4) {
            0 => Barb::Ramp,
            1 => Barb::Square,
            2 => Barb::Round,
            _ => Barb::TwoRamps(rng.random_range(25f64..80.0).to_radians()),
        };
        self.undercut = rng.random_range(0.25..1.1);
        self.land = rng.random_range(0.1..0.4 * self.length);
        self.lead_in = rng.random_range(15f64..65.0).to_radians();
        self.fillet = rng.random_range(0.05f64.ln()..0.6f64.ln()).exp();
        self.corner = rng.random_range(0.05..0.35 * self.width);
        self.flare = if rng.random_bool(0.5) { rng.random_range(1.0..1.8) } else { 1.0 };
        // Some of the arm stays behind the barb.
        while self.face() < -0.15 * self.length && self.land > 0.05 {
            self.land *= 0.7;
            self.lead_in = (1.1 * self.lead_in).min(1.2);
        }
        self
    }

    fn scaled(self, factor: f64) -> Self {
        Self {
            length: factor * self.length,
            width: factor * self.width,
            thickness: factor * self.thickness,
            // A deeper press than gels are drawn for would show no more of it.
            undercut: (factor * self.undercut).min(MOST_UNDERCUT_MM),
            land: factor * self.land,
            fillet: factor * self.fillet,
            corner: factor * self.corner,
            ..self
        }
    }

    /// Distance inside the outline of a hook that lies on its back.
    fn outline(&self, x: f64, y: f64) -> f64 {
        let half = self.length / 2.0;
        // From 0 at the barb's tip to 1 at the root.
        let along = ((half - x) / self.length).clamp(0.0, 1.0);
        let half_width = self.width / 2.0 * (1.0 + (self.taper - 1.0) * along) / self.flare;
        let arm = rectangle(x, y, [half, half_width], self.corner.min(half_width));
        if self.flare <= 1.0 {
            return arm;
        }
        let length = half - self.face();
        let barb = [length / 2.0, self.width / 2.0];
        arm.max(rectangle(x - half + barb[0], y, barb, self.corner.min(barb[0])))
    }

    /// Place along x of the barb's retention face, the arm's middle being 0.
    fn face(&self) -> f64 {
        match self.barb {
            Barb::Ramp => {}
            // A quarter of the arm at most, or the hook is a tab of two steps.
            Barb::Square => return self.length / 2.0 - (0.7 + self.land).min(0.25 * self.length),
            Barb::Round => return self.length / 2.0 - 0.3 - 2.0 * self.undercut,
            Barb::TwoRamps(_) => {
                let run = self.undercut / self.lead_in.tan();
                return self.length / 2.0 - 0.3 - run - self.land;
            }
        }
        let drop = self.undercut + 0.35 * self.thickness;
        self.length / 2.0 - drop / self.lead_in.tan() - self.land
    }

    fn height(&self, x: f64, y: f64) -> f64 {
        if let Some(side) = self.on_side {
            return rounded_edge(
                self.profile(x, if side == Side::Left { y } else { -y }),
                self.fillet,
            );
        }
        let face = self.face();
        let land_end = face + self.land;
        let slope = (land_end - x) * self.lead_in.tan();
        let edge = rounded_edge(self.outline(x, y), self.fillet);
        match self.barb {
            Barb::Ramp => {}
            Barb::Square => return rounded_edge(x - face, self.fillet).max(-self.undercut) + edge,
            Barb::Round => {
                let from = (x - face - self.undercut) / self.undercut;
                let bow = (1.0 - from * from).max(0.0).sqrt() - 1.0;
                return self.undercut * bow + edge;
            }
            Barb::TwoRamps(angle) => {
                let top = smooth_min((x - face) * angle.tan(), slope, 0.12);
                return smooth_min(0.0, top, 0.12).max(-self.undercut) + edge;
            }
        }
        let barb = smooth_min(0.0, slope, 0.12) + rounded_edge(x - face, self.fillet);
        let arm = smooth_min(-self.undercut, slope, 0.12);
        barb.max(arm) + edge
    }

    /// Size along y of the hook's profile.
    fn profile_height(&self) -> f64 {
        self.thickness + self.undercut
    }

    /// Distance inside the profile of a hook on its side.
    fn profile(&self, x: f64, y: f64) -> f64 {
        let (half, high) = (self.length / 2.0, self.profile_height() / 2.0);
        let arm_top = self.thickness - high;
        let arm = rectangle(x, y + high - self.thickness / 2.0, [half, self.thickness / 2.0], 0.1);
        let face = self.face();
        let retention = match self.barb {
            Barb::TwoRamps(angle) => (x - face) * angle.sin() - (y - arm_top) * angle.cos(),
            _ => x - face,
        };
        let lead = match self.barb {
            Barb::Square => half - x,
            Barb::Round => {
                let middle = face + self.undercut;
                return arm.max(self.undercut - (x - middle).hypot(y - arm_top));
            }
            _ => {
                let (sin, cos) = self.lead_in.sin_cos();
                (face + self.land - x) * sin + (high - y) * cos
            }
        };
        let barb = retention.min(high - y).min(lead).min(y - arm_top + self.thickness / 2.0);
        // A ramp goes on into the arm; other lead-ins end on it, and its tip stays square.
        let arm = if self.barb == Barb::Ramp { arm.min(lead) } else { arm };
        arm.max(barb.min(half - x))
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

    fn sample_wide(
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

    fn scaled(self, factor: f64) -> Self {
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
    fn edged(mut self, rng: &mut Pcg64, forced: &Forced) -> Self {
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

/// A snap's shape in its own coordinates: x and y across the gel, heights towards it, the highest
/// point at 0.
#[derive(Debug, Clone, PartialEq)]
pub enum Snap {
    /// Kind A.
    Hook(Hook),
    /// Kind B.
    Stud(Stud),
    /// A part of one's own.
    Own(Arc<OwnPart>),
}

impl Snap {
    /// Draws a snap of this kind. The footprint's area is uniform in 20 to 49 mm², whatever the
    /// kind.
    pub fn sample(rng: &mut Pcg64, kind: &Kind) -> Self {
        let area = rng.random_range(20.0..49.0);
        match kind {
            Kind::Own(part) => Self::Own(part.clone()),
            Kind::A => Self::Hook(Hook::sample(rng, area)),
            Kind::B => Self::Stud(Stud::sample(rng, area)),
        }
    }

    /// Draws a snap of this kind for a wide picture. The footprint's area is drawn evenly over its
    /// logarithm in 14 to 60 mm², whatever the kind; a hook on its side is slimmer.
    pub fn sample_wide(rng: &mut Pcg64, kind: &Kind, forced: &Forced) -> Self {
        let area = rng.random_range(14f64.ln()..60f64.ln()).exp();
        let on_side = rng.random_bool(0.12) && !forced.mild;
        let wall = rng.random_bool(0.4) && !forced.mild;
        let drawn = match kind {
            Kind::Own(part) => Self::Own(part.clone()),
            Kind::A => {
                let (on_side, wall) = (forced.side.unwrap_or(on_side), forced.wall.unwrap_or(wall));
                let hook = Hook::sample_wide(rng, area, on_side, wall);
                Self::Hook(match forced.barbs {
                    Some(true) => hook.with_varied_barb(rng),
                    _ => hook,
                })
            }
            Kind::B => {
                let slots = forced.slots.map(|span| span.sample(rng).round() as u32);
                let hole = forced.hole.map(|span| span.sample(rng));
                let stud = Stud::sample_wide(rng, area, slots, hole, forced.bead);
                Self::Stud(stud.edged(rng, forced))
            }
        };
        match forced.size {
            Some(size) => drawn.sized(size.sample(rng)),
            None => drawn,
        }
    }

    /// Scaled so that its longer side has this length in millimetres; a part of one's own has its size.
    fn sized(self, size_mm: f64) -> Self {
        let [a, b] = self.half_size();
        let factor = size_mm / (2.0 * a.max(b));
        match self {
            Self::Own(part) => Self::Own(part),
            Self::Hook(hook) => Self::Hook(hook.scaled(factor)),
            Self::Stud(stud) => Self::Stud(stud.scaled(factor)),
        }
    }

    /// Draws how deep the highest point of a wide picture's snap goes into the gel, in
    /// millimetres. A quarter are faint, 0.3 to 0.8 mm; the arms of most faint hooks graze the gel,
    /// for which their barbs are made low enough.
    pub fn sample_wide_depth(&mut self, rng: &mut Pcg64) -> f64 {
        let faint = rng.random_bool(0.25);
        let low = rng.random_range(0.3..0.8);
        let grazing = rng.random_bool(0.75);
        match self {
            Self::Own(part) => part.sample_wide_depth(rng),
            Self::Hook(Hook { on_side: None, undercut, .. }) if faint => {
                if grazing {
                    *undercut = undercut.min(low - rng.random_range(0.05..0.15));
                }
                low
            }
            _ if faint => low,
            Self::Hook(Hook { on_side: None, undercut, .. }) => {
                *undercut + rng.random_range(0.2..0.9)
            }
            _ => rng.random_range(0.5..1.5),
        }
    }

    /// Half the part's size along its own x and y.
    pub fn half_size(&self) -> [f64; 2] {
        match self {
            Self::Hook(h) if h.on_side.is_some() => [h.length / 2.0, h.profile_height() / 2.0],
            Self::Hook(h) => [h.length / 2.0, h.width * (h.taper / h.flare).max(1.0) / 2.0],
            Self::Stud(s) => [s.diameter / 2.0, s.diameter / s.oval / 2.0],
            Self::Own(part) => part.relief.half_size(),
        }
    }

    /// Draws how deep the highest point goes into the gel, in millimetres.
    pub fn sample_depth(&self, rng: &mut Pcg64) -> f64 {
        match self {
            // Mostly the arm touches too; in the others only the barb, deep enough to be seen.
            Self::Hook(hook) if rng.random_bool(0.92) => hook.undercut + rng.random_range(0.2..0.8),
            Self::Hook(hook) => rng.random_range(0.35..hook.undercut - 0.05),
            Self::Stud(_) => rng.random_range(0.2..1.4),
            Self::Own(part) => part.sample_depth(rng),
        }
    }

    /// The kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Hook(_) => Kind::A,
            Self::Stud(_) => Kind::B,
            Self::Own(part) => Kind::Own(part.clone()),
        }
    }

    /// The direction that a label states of a part turned by this yaw, in degrees: none of what has none.
    pub fn direction(&self, yaw_deg: f64) -> Option<f64> {
        match self {
            Self::Hook(_) => Some(yaw_deg),
            Self::Stud(_) => None,
            Self::Own(part) => part.direction(yaw_deg),
        }
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Hook(hook) => hook.height(x, y),
            Self::Stud(stud) => stud.height(x, y),
            Self::Own(part) => part.relief.height(x, y),
        }
    }

    /// Radius of a circle round the origin that holds the part, in millimetres.
    pub fn reach(&self) -> f64 {
        match self {
            Self::Hook(_) | Self::Own(_) => {
                let [x, y] = self.half_size();
                x.hypot(y)
            }
            Self::Stud(s) => s.diameter / 2.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hook of 8 mm on its side, whose arm lies from −1 to 0.2 mm in y and whose barb reaches 1 mm.
    /// Its lead-in of 45° comes down to 0.35 × 1.2 = 0.42 mm below the arm's upper side at the tip.
    #[test]
    fn a_ramp_cuts_the_arm_s_tip() {
        let hook = Hook {
            length: 8.0,
            width: 4.0,
            taper: 1.0,
            flare: 1.0,
            thickness: 1.2,
            undercut: 0.8,
            land: 0.5,
            lead_in: 45f64.to_radians(),
            fillet: 0.1,
            corner: 0.3,
            barb: Barb::Ramp,
            on_side: Some(Side::Left),
            wall: false,
        };
        // Just inside of the tip, to either side of the slope.
        assert!(hook.profile(3.95, -0.30) > 0.0, "the lower part of the tip is there");
        assert!(hook.profile(3.95, -0.02) < 0.0, "the upper part is cut away");
        // Another lead-in ends on the arm.
        let blunt = Hook { barb: Barb::TwoRamps(45f64.to_radians()), ..hook };
        assert!(blunt.profile(3.9, 0.0) > 0.0, "the tip is square");
    }
}
