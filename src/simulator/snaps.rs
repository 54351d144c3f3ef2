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

use super::forced::Forced;
use super::hook::Hook;
use super::own_part::OwnPart;
use super::stud::Stud;

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
