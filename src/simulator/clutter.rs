//! Things of no known kind: simple shapes put together at random, smooth or grained.
//!
//! Whatever else lies under a sensor has edges, steps, holes and grain as snaps have, in another order.

use std::f64::consts::{PI, TAU};

use glam::DVec2;
use rand::RngExt;
use rand_pcg::Pcg64;

use super::outline::{rectangle, rounded_edge, stroke};
use super::pose::Pose;

/// Height far outside all shapes, in millimetres.
const NOTHING_MM: f64 = -10.0;

/// An outline about the origin, lengths in millimetres.
#[derive(Debug, Clone, PartialEq)]
enum Outline {
    Rectangle {
        half: [f64; 2],
        corner: f64,
    },
    /// A regular polygon.
    Polygon {
        sides: u32,
        radius: f64,
    },
    Ring {
        radius: f64,
        half_width: f64,
    },
    /// A bar with round ends.
    Bar {
        half_length: f64,
        half_width: f64,
    },
    /// A round shape whose radius sways: at the angle θ by the sum of each share · cos(k θ + phase),
    /// with k from 1.
    Pebble {
        radius: f64,
        sway: [[f64; 2]; 4],
    },
}

impl Outline {
    fn sample(rng: &mut Pcg64) -> Self {
        let size = rng.random_range(0.7f64.ln()..5f64.ln()).exp();
        match rng.random_range(0..6) {
            0 | 1 => {
                let half = [size, size * rng.random_range(0.15..1.0)];
                Self::Rectangle { half, corner: half[1] * rng.random_range(0.02..0.6) }
            }
            2 => Self::Polygon { sides: rng.random_range(3..9), radius: size },
            3 => Self::Ring { radius: size, half_width: size * rng.random_range(0.08..0.35) },
            4 => Self::Bar { half_length: size, half_width: size * rng.random_range(0.08..0.3) },
            _ => {
                let mut harmonic = || [rng.random_range(0.0..0.15), rng.random_range(0.0..TAU)];
                let sway = std::array::from_fn(|_| harmonic());
                Self::Pebble { radius: size, sway }
            }
        }
    }

    /// How far a point lies inside, in millimetres; negative outside.
    fn inside(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Rectangle { half, corner } => rectangle(x, y, *half, *corner),
            Self::Polygon { sides, radius } => {
                let half = PI / f64::from(*sides);
                let turn = y.atan2(x).rem_euclid(2.0 * half) - half;
                radius * half.cos() - x.hypot(y) * turn.cos()
            }
            Self::Ring { radius, half_width } => half_width - (x.hypot(y) - radius).abs(),
            Self::Bar { half_length, half_width } => {
                stroke(x, y, [-half_length, 0.0], [*half_length, 0.0], *half_width)
            }
            Self::Pebble { radius, sway } => {
                let angle = y.atan2(x);
                let harmonics = sway.iter().zip(1u32..);
                let waves = harmonics
                    .map(|([share, phase], k)| share * (f64::from(k) * angle + phase).cos());
                radius * (1.0 + waves.sum::<f64>()) - x.hypot(y)
            }
        }
    }

    /// Radius of a circle about the origin that holds it.
    fn reach(&self) -> f64 {
        match self {
            Self::Rectangle { half, .. } => half[0].hypot(half[1]),
            Self::Polygon { radius, .. } => *radius,
            Self::Ring { radius, half_width } => radius + half_width,
            Self::Bar { half_length, half_width } => half_length + half_width,
            Self::Pebble { radius, sway } => {
                radius * (1.0 + sway.iter().map(|[share, _]| share).sum::<f64>())
            }
        }
    }
}

/// A shape that stands out, or one that is cut into what stands before it.
#[derive(Debug, Clone, PartialEq)]
struct Piece {
    outline: Outline,
    pose: Pose,
    /// Height of its top or floor, in millimetres; at most 0.
    top: f64,
    /// Slope of its top along its own x and y.
    slope: [f64; 2],
    /// Radius of its edge.
    fillet: f64,
    is_hole: bool,
}

impl Piece {
    fn sample(rng: &mut Pcg64, first: bool) -> Self {
        let outline = Outline::sample(rng);
        let spread = if first { 0.0 } else { 3.0 };
        let mut offset = || (2.0 * rng.random_range(0.0..1.0) - 1.0) * spread;
        let center = [offset(), offset()];
        let is_hole = !first && rng.random_bool(0.35);
        let top = match (first, is_hole) {
            (true, _) => 0.0,
            (_, true) => -rng.random_range(0.2..1.5),
            (_, false) => -rng.random_range(0.0..0.9),
        };
        let flat = rng.random_bool(0.6);
        let mut slope = || if flat { 0.0 } else { (2.0 * rng.random_range(0.0..1.0) - 1.0) * 0.25 };
        let slope = [slope(), slope()];
        let fillet = rng.random_range(0.05f64.ln()..0.8f64.ln()).exp();
        let pose =
            Pose { origin_mm: center.into(), x: DVec2::from_angle(rng.random_range(-PI..PI)) };
        Self { outline, pose, top, slope, fillet, is_hole }
    }

    /// The height at a point of what has the height `below` without this piece.
    fn over(&self, below: f64, x: f64, y: f64) -> f64 {
        let [u, v] = self.pose.own(DVec2::new(x, y)).into();
        let inside = self.outline.inside(u, v);
        if self.is_hole {
            return below.min(rounded_edge(-inside, self.fillet).max(self.top));
        }
        // Its highest corner is at `top`.
        let tilted = self.slope[0] * u + self.slope[1] * v
            - self.slope[0].hypot(self.slope[1]) * self.outline.reach();
        below.max(self.top + tilted.min(0.0) + rounded_edge(inside, self.fillet))
    }
}

/// Waves on the surface: a thread, a knurl, a weave.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grain {
    pitch_mm: f64,
    height_mm: f64,
    /// Its x is the direction of the waves.
    pose: Pose,
    /// Across as well as along.
    both: bool,
}

impl Grain {
    fn sample(rng: &mut Pcg64) -> Self {
        let pitch_mm = rng.random_range(0.4f64.ln()..2.5f64.ln()).exp();
        Self {
            pitch_mm,
            height_mm: pitch_mm * rng.random_range(0.05..0.35),
            pose: Pose { origin_mm: DVec2::ZERO, x: DVec2::from_angle(rng.random_range(-PI..PI)) },
            both: rng.random_bool(0.5),
        }
    }

    /// At most 0.
    fn height(&self, x: f64, y: f64) -> f64 {
        let [along, across] = self.pose.own(DVec2::new(x, y)).into();
        let wave = |along: f64| ((TAU * along / self.pitch_mm).cos() - 1.0) / 2.0;
        let other = if self.both { wave(across) } else { 0.0 };
        self.height_mm * (wave(along) + other)
    }
}

/// A thing of one to six shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Clutter {
    pieces: Vec<Piece>,
    grain: Option<Grain>,
}

impl Clutter {
    /// Draws a thing.
    pub fn sample(rng: &mut Pcg64) -> Self {
        let count = rng.random_range(1..=6);
        let pieces = (0..count).map(|i| Piece::sample(rng, i == 0)).collect();
        let grain = rng.random_bool(0.35).then(|| Grain::sample(rng));
        Self { pieces, grain }
    }

    /// Height in millimetres; at most 0, falling steeply outside.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let smooth = self.pieces.iter().fold(NOTHING_MM, |below, piece| piece.over(below, x, y));
        smooth + self.grain.map_or(0.0, |grain| grain.height(x, y))
    }

    /// Half its size along x and y, as seen from its origin.
    pub fn half_size(&self) -> [f64; 2] {
        let solid = self.pieces.iter().filter(|piece| !piece.is_hole);
        solid.fold([0.0; 2], |half, piece| {
            let reach = piece.outline.reach();
            [0, 1].map(|axis| half[axis].max(piece.pose.origin_mm[axis].abs() + reach))
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn piece(outline: Outline, top: f64, is_hole: bool) -> Piece {
        let pose = Pose { origin_mm: DVec2::ZERO, x: DVec2::X };
        Piece { outline, pose, top, slope: [0.0; 2], fillet: 0.1, is_hole }
    }

    #[test]
    fn pieces_stand_on_each_other_and_holes_are_cut() {
        let plate = Outline::Rectangle { half: [4.0, 2.0], corner: 0.1 };
        let disc = Outline::Polygon { sides: 8, radius: 1.0 };
        let pieces = vec![piece(plate, -0.5, false), piece(disc.clone(), 0.0, false)];
        let stepped = Clutter { pieces: pieces.clone(), grain: None };
        assert_eq!([stepped.height(0.0, 0.0), stepped.height(3.0, 0.0)], [0.0, -0.5]);
        assert!(stepped.height(4.5, 0.0) < -2.0);
        assert_eq!(stepped.half_size()[1], 4f64.hypot(2.0));
        let hole = piece(disc, -0.8, true);
        let drilled = Clutter { pieces: vec![pieces[0].clone(), hole], grain: None };
        assert_eq!([drilled.height(0.0, 0.0), drilled.height(3.0, 0.0)], [-0.8, -0.5]);
    }

    /// Of an octagon with a corner at (1, 0), the flat's middle lies at cos(π/8) in the direction π/8.
    #[test]
    fn distances_inside() {
        let octagon = Outline::Polygon { sides: 8, radius: 1.0 };
        assert!(octagon.inside(1.0, 0.0).abs() < 1e-12);
        let (sin, cos) = (PI / 8.0).sin_cos();
        assert!((octagon.inside(0.5 * cos, 0.5 * sin) - (cos - 0.5)).abs() < 1e-12);
        let ring = Outline::Ring { radius: 2.0, half_width: 0.5 };
        assert_eq!([ring.inside(2.0, 0.0), ring.inside(0.0, 0.0)], [0.5, -1.5]);
        let pebble =
            Outline::Pebble { radius: 2.0, sway: [[0.1, 0.0], [0.0; 2], [0.0; 2], [0.0; 2]] };
        assert!((pebble.inside(0.0, 0.0) - 2.2).abs() < 1e-12);
        assert!((pebble.inside(-1.8, 0.0)).abs() < 1e-12);
    }

    #[test]
    fn nothing_is_higher_than_0_or_outside_its_size() {
        let rng = &mut Pcg64::seed_from_u64(7);
        for _ in 0..200 {
            let thing = Clutter::sample(rng);
            let half = thing.half_size();
            for i in 0..400 {
                let at = [i % 20, i / 20].map(|at| f64::from(at) - 9.5);
                let height = thing.height(at[0], at[1]);
                assert!(height <= 0.0, "{thing:?}");
                let outside = (0..2).any(|axis| at[axis].abs() > half[axis]);
                assert!(!outside || height < 0.0, "{thing:?}");
            }
        }
    }
}
