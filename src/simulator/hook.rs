//! Kind A, a cantilever hook, as a rigid height field.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::outline::{rectangle, rounded_edge, smooth_min};

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
    pub(super) fn sample(rng: &mut Pcg64, area: f64) -> Self {
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

    pub(super) fn sample_wide(rng: &mut Pcg64, area: f64, on_side: bool, wall: bool) -> Self {
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
    pub(super) fn with_varied_barb(mut self, rng: &mut Pcg64) -> Self {
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

    pub(super) fn scaled(self, factor: f64) -> Self {
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

    pub(super) fn height(&self, x: f64, y: f64) -> f64 {
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
    pub(super) fn profile_height(&self) -> f64 {
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
