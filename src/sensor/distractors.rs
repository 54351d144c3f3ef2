//! Rigid things that press on the gel and are no snaps.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::profile::{rectangle, rounded_edge, stroke};

/// The recess of a screw's head.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// A cross.
    Cross,
    /// One slot.
    Slot,
    /// A hexagon.
    Hex,
}

/// A line from point to point, in millimetres.
pub type Line = [[f64; 2]; 2];

/// A part that is no snap, in its own coordinates: heights towards the gel, at most 0.
#[derive(Debug, Clone, PartialEq)]
pub enum Distractor {
    /// A straight bar.
    Rib {
        /// Length along x.
        length: f64,
        /// Width along y.
        width: f64,
        /// Radius of its edges.
        fillet: f64,
    },
    /// A screw's head, domed, with a recess.
    Screw {
        /// Radius of the head.
        radius: f64,
        /// Recess.
        drive: Drive,
        /// Half width of the recess's strokes, or half the hexagon's width over its flats.
        recess: f64,
        /// How much lower the head's rim is than its middle.
        dome: f64,
    },
    /// A plate that ends at x = 0 and goes on for negative x.
    Edge {
        /// Radius of the edge.
        fillet: f64,
    },
    /// A plain round pin.
    Pin {
        /// Radius.
        radius: f64,
        /// Radius of its edge.
        fillet: f64,
    },
    /// Raised letters.
    Lettering {
        /// The letters' strokes.
        strokes: Vec<Line>,
        /// Half width of a stroke.
        half_width: f64,
        /// Half the text's size along x and y.
        half: [f64; 2],
    },
}

/// Capitals of straight strokes, on a field 4 wide and 6 high: `[x, y]` from point to point,
/// y downwards.
const LETTERS: [&[&[[u8; 2]]]; 14] = [
    &[&[[0, 6], [2, 0], [4, 6]], &[[1, 4], [3, 4]]],
    &[&[[4, 0], [0, 0], [0, 6], [4, 6]], &[[0, 3], [3, 3]]],
    &[&[[4, 0], [0, 0], [0, 6]], &[[0, 3], [3, 3]]],
    &[&[[0, 0], [0, 6]], &[[4, 0], [4, 6]], &[[0, 3], [4, 3]]],
    &[&[[2, 0], [2, 6]]],
    &[&[[0, 0], [0, 6]], &[[4, 0], [0, 3], [4, 6]]],
    &[&[[0, 0], [0, 6], [4, 6]]],
    &[&[[0, 6], [0, 0], [2, 4], [4, 0], [4, 6]]],
    &[&[[0, 6], [0, 0], [4, 6], [4, 0]]],
    &[&[[0, 0], [4, 0]], &[[2, 0], [2, 6]]],
    &[&[[0, 0], [2, 6], [4, 0]]],
    &[&[[0, 0], [4, 6]], &[[4, 0], [0, 6]]],
    &[&[[0, 0], [4, 0], [0, 6], [4, 6]]],
    &[&[[0, 0], [4, 0], [1, 6]]],
];

impl Distractor {
    /// Draws a distractor.
    pub fn sample(rng: &mut Pcg64) -> Self {
        match rng.random_range(0..10) {
            0..3 => Self::Rib {
                length: rng.random_range(7.0..25.0),
                width: rng.random_range(0.6..2.5),
                fillet: rng.random_range(0.1..0.3),
            },
            3..6 => {
                let radius = rng.random_range(2.0..4.0);
                let drive = match rng.random_range(0..3) {
                    0 => Drive::Cross,
                    1 => Drive::Slot,
                    _ => Drive::Hex,
                };
                let recess = match drive {
                    Drive::Hex => radius * rng.random_range(0.35..0.55),
                    Drive::Cross | Drive::Slot => rng.random_range(0.3..0.6),
                };
                Self::Screw { radius, drive, recess, dome: rng.random_range(0.0..0.5) }
            }
            6 => Self::Edge { fillet: rng.random_range(0.1..0.4) },
            7 => {
                Self::Pin { radius: rng.random_range(0.8..3.0), fillet: rng.random_range(0.1..0.5) }
            }
            _ => Self::lettering(rng),
        }
    }

    /// Draws a pin that ends in a half sphere.
    pub fn ball(rng: &mut Pcg64) -> Self {
        let radius = rng.random_range(1.5..12.0);
        Self::Pin { radius, fillet: radius }
    }

    fn lettering(rng: &mut Pcg64) -> Self {
        let count = rng.random_range(1..=5);
        let height: f64 = rng.random_range(2.5..6.0);
        let unit = height / 6.0;
        let half = [unit * (6.0 * f64::from(count) - 2.0) / 2.0, height / 2.0];
        let mut strokes = Vec::new();
        for i in 0..count {
            let letter = LETTERS[rng.random_range(0..LETTERS.len())];
            let at = |[x, y]: [u8; 2]| {
                [
                    unit * (f64::from(x) + 6.0 * f64::from(i)) - half[0],
                    unit * f64::from(y) - half[1],
                ]
            };
            for line in letter {
                strokes.extend(line.windows(2).map(|pair| [at(pair[0]), at(pair[1])]));
            }
        }
        Self::Lettering { strokes, half_width: height * rng.random_range(0.05..0.09), half }
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Rib { length, width, fillet } => rounded_edge(
                rectangle(x, y, [length / 2.0, width / 2.0], (*width / 4.0).min(0.3)),
                fillet.min(width / 3.0),
            ),
            Self::Screw { radius, drive, recess, dome } => {
                let r = x.hypot(y);
                let arm = radius * 0.6;
                let hole = match drive {
                    Drive::Slot => recess - y.abs(),
                    Drive::Cross => stroke(x, y, [-arm, 0.0], [arm, 0.0], *recess).max(stroke(
                        x,
                        y,
                        [0.0, -arm],
                        [0.0, arm],
                        *recess,
                    )),
                    Drive::Hex => {
                        let (sin, cos) = (0.75f64.sqrt(), 0.5);
                        recess
                            - y.abs().max((x * sin + y * cos).abs()).max((x * sin - y * cos).abs())
                    }
                };
                rounded_edge((radius - r).min(-hole), 0.15) - dome * (r / radius).powi(2)
            }
            Self::Edge { fillet } => rounded_edge(-x, *fillet),
            Self::Pin { radius, fillet } => rounded_edge(radius - x.hypot(y), fillet.min(*radius)),
            Self::Lettering { strokes, half_width, .. } => {
                let inside = strokes
                    .iter()
                    .map(|[a, b]| stroke(x, y, *a, *b, *half_width))
                    .fold(f64::NEG_INFINITY, f64::max);
                rounded_edge(inside, half_width.min(0.2))
            }
        }
    }

    /// Half the part's size along its own x and y; a straight edge has none.
    pub fn half_size(&self) -> Option<[f64; 2]> {
        match self {
            Self::Rib { length, width, .. } => Some([length / 2.0, width / 2.0]),
            Self::Screw { radius, .. } | Self::Pin { radius, .. } => Some([*radius; 2]),
            Self::Edge { .. } => None,
            Self::Lettering { half, half_width, .. } => {
                Some([half[0] + half_width, half[1] + half_width])
            }
        }
    }
}
