//! Rigid things that press on the gel and are no snaps.

use std::sync::Arc;

use rand::RngExt;
use rand_pcg::Pcg64;

use super::clutter::Clutter;
use super::fasteners::Fastener;
use super::forced::Forced;
use super::options::Drive;
use super::outline::{rectangle, rounded_edge, smooth_min, stroke};
use super::relief::Relief;
use super::snaps::Snap;
use super::stud::Stud;
use super::turned::Turned;

/// A line from point to point, in millimetres.
pub type Line = [[f64; 2]; 2];

/// Kinds of look-alikes, and of other things that are no snaps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// A hook without its barb.
    Arm,
    /// A plain block.
    Block,
    /// A block of two steps.
    Tab,
    /// A ring with a bead and without slots.
    Ring,
    /// A screw's head with a slot, a cross or a hexagon.
    Screw,
    /// A hexagon with a round hole.
    Nut,
    /// A ball.
    Ball,
    /// A roof or a wedge.
    Prism,
    /// An angle of two legs.
    Bracket,
    /// Raised letters.
    Letters,
    /// A straight bar.
    Rib,
    /// A straight edge.
    Edge,
    /// A round pin.
    Pin,
    /// A cap of a ball.
    Dome,
    /// A button with a rim and holes.
    Button,
    /// A rivet's head on its flange.
    Rivet,
    /// A ring with a round section.
    Torus,
    /// A clip with two legs.
    Clip,
    /// A pin with fins, seen from its side.
    FirTree,
    /// A thing of no known kind.
    Clutter,
    /// Nothing: bare gel.
    Nothing,
}

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
    /// A hook's arm without a barb: a block whose end falls towards x.
    Arm {
        /// Length along x.
        length: f64,
        /// Width along y.
        width: f64,
        /// Length of the falling end; 0 without.
        ramp: f64,
        /// Its angle in radians.
        angle: f64,
        /// Radius of the corners.
        corner: f64,
        /// Radius of the edges.
        fillet: f64,
    },
    /// A block with a second step on it.
    Tab {
        /// Half the lower step's size.
        half: [f64; 2],
        /// The upper step: least x and y, greatest x and y.
        upper: [f64; 4],
        /// How much lower the lower step is.
        step: f64,
        /// Radius of the edges.
        fillet: f64,
    },
    /// A ring without slots.
    Ring(Stud),
    /// A hexagon with a round hole.
    Nut {
        /// Half the width over the flats.
        half_width: f64,
        /// Radius of the hole.
        hole: f64,
        /// How much lower the corners are than the middle.
        chamfer: f64,
    },
    /// A roof: a ridge along x whose sides fall.
    Prism {
        /// Half the size along x and y.
        half: [f64; 2],
        /// Fall of the sides over their run, towards y and against it.
        slopes: [f64; 2],
    },
    /// Two legs at a right angle, one along x, one along y.
    Bracket {
        /// Half the size along x and y.
        half: [f64; 2],
        /// Width of the legs.
        leg: f64,
        /// Radius of the edges.
        fillet: f64,
    },
    /// A plain round pin.
    Pin {
        /// Radius.
        radius: f64,
        /// Radius of its edge.
        fillet: f64,
    },
    /// A dome, a button, a rivet or a torus.
    Turned(Turned),
    /// A clip or a pin.
    Fastener(Fastener),
    /// A thing of no known kind.
    Clutter(Clutter),
    /// A shape from a file.
    Relief(Arc<Relief>),
    /// A snap of a kind that is not asked for.
    Snap(Box<Snap>),
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
                let drive = Drive::sample(rng);
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

    /// Draws a part of this kind for a wide picture. `None` for [`Part::Nothing`].
    pub fn sample_wide(rng: &mut Pcg64, part: Part, forced: &Forced) -> Option<Self> {
        let fillet = rng.random_range(0.05..0.3);
        Some(match part {
            Part::Arm => {
                let length = rng.random_range(5.0..12.0);
                Self::Arm {
                    length,
                    width: rng.random_range(2.5..6.0),
                    ramp: if rng.random_bool(0.6) {
                        rng.random_range(0.5..0.35 * length)
                    } else {
                        0.0
                    },
                    angle: rng.random_range(20f64..50.0).to_radians(),
                    corner: rng.random_range(0.1..0.8),
                    fillet,
                }
            }
            Part::Block => {
                let long = rng.random_bool(0.75);
                let (length, width) = if long {
                    (rng.random_range(6.0..10.0), rng.random_range(3.0..5.0))
                } else {
                    (rng.random_range(2.0..12.0), rng.random_range(1.5..8.0))
                };
                let corner = rng.random_range(0.05..0.6);
                Self::Arm { length, width, ramp: 0.0, angle: 0.5, corner, fillet }
            }
            Part::Tab => {
                let half = [rng.random_range(2.5..5.5), rng.random_range(1.5..3.0)];
                let [a, b] = half;
                let mut share = |low: f64, high: f64| rng.random_range(low..high);
                let upper = match (share(0.0, 1.0) * 4.0) as u32 {
                    // Half of the length.
                    0 | 1 => [a * share(-0.4, 0.3), -b, a, b],
                    // Half of the width.
                    2 => [-a, b * share(-0.4, 0.4), a, b],
                    // Steps all round.
                    _ => {
                        let (x, y) = (share(0.3, 0.75), share(0.3, 0.75));
                        [-a * x, -b * y, a * x, b * y]
                    }
                };
                Self::Tab { half, upper, step: rng.random_range(0.25..0.9), fillet }
            }
            Part::Ring => Self::Ring(Stud::unslotted(rng, forced)),
            Part::Screw => {
                let radius = rng.random_range(1.5..4.5);
                let drawn = Drive::sample(rng);
                let drive = forced.drive.unwrap_or(drawn);
                let share = match drive {
                    Drive::Cross | Drive::Slot => 0.1..0.22,
                    Drive::Hex => 0.35..0.6,
                };
                let recess = radius * rng.random_range(share);
                Self::Screw { radius, drive, recess, dome: rng.random_range(0.0..0.5) }
            }
            Part::Nut => {
                let half_width = rng.random_range(2.0..4.5);
                Self::Nut {
                    half_width,
                    hole: half_width * rng.random_range(0.35..0.65),
                    chamfer: rng.random_range(0.0..0.4),
                }
            }
            Part::Ball => {
                let radius = rng.random_range(1.2f64.ln()..12f64.ln()).exp();
                Self::Pin { radius, fillet: radius }
            }
            Part::Prism => {
                let half = [rng.random_range(2.0..6.0), rng.random_range(1.0..4.0)];
                let slope = rng.random_range(0.3..1.2);
                let other = if rng.random_bool(0.6) { slope } else { rng.random_range(0.0..1.2) };
                Self::Prism { half, slopes: [slope, other] }
            }
            Part::Bracket => {
                let half = [rng.random_range(2.5..5.0), rng.random_range(2.0..4.0)];
                Self::Bracket { half, leg: rng.random_range(0.8..0.9 * half[1]), fillet }
            }
            Part::Letters => Self::lettering(rng),
            Part::Rib => Self::Rib {
                length: rng.random_range(4.0..25.0),
                width: rng.random_range(0.6..3.0),
                fillet,
            },
            Part::Edge => Self::Edge { fillet },
            Part::Pin => Self::Pin { radius: rng.random_range(0.8..4.0), fillet },
            Part::Dome => Self::Turned(Turned::dome(rng)),
            Part::Button => Self::Turned(Turned::button(rng)),
            Part::Rivet => Self::Turned(Turned::rivet(rng)),
            Part::Torus => Self::Turned(Turned::torus(rng)),
            Part::Clip => Self::Fastener(Fastener::clip(rng)),
            Part::FirTree => Self::Fastener(Fastener::fir_tree(rng)),
            Part::Clutter => Self::Clutter(Clutter::sample(rng)),
            Part::Nothing => return None,
        })
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
                    Drive::Hex => recess - hexagon(x, y),
                };
                rounded_edge((radius - r).min(-hole), 0.15) - dome * (r / radius).powi(2)
            }
            Self::Arm { length, width, ramp, angle, corner, fillet } => {
                let outline = rectangle(x, y, [length / 2.0, width / 2.0], *corner);
                let fall = (length / 2.0 - ramp - x) * angle.tan();
                let top = if *ramp > 0.0 { smooth_min(0.0, fall, 0.12) } else { 0.0 };
                top + rounded_edge(outline, *fillet)
            }
            Self::Tab { half, upper: [x0, y0, x1, y1], step, fillet } => {
                let on = [(x1 - x0) / 2.0, (y1 - y0) / 2.0];
                let upper = rectangle(x - (x0 + x1) / 2.0, y - (y0 + y1) / 2.0, on, 0.1);
                let lower = rectangle(x, y, *half, 0.1);
                rounded_edge(upper.min(lower), *fillet).max(rounded_edge(lower, *fillet) - step)
            }
            Self::Ring(stud) => stud.height(x, y),
            Self::Turned(part) => part.height(x, y),
            Self::Fastener(part) => part.height(x, y),
            Self::Clutter(thing) => thing.height(x, y),
            Self::Relief(relief) => relief.height(x, y),
            Self::Snap(snap) => snap.height(x, y),
            Self::Nut { half_width, hole, chamfer } => {
                let r = x.hypot(y);
                let inside = (half_width - hexagon(x, y)).min(r - hole);
                let corner = ((r - half_width) / half_width).max(0.0);
                rounded_edge(inside, 0.12) - chamfer * 6.0 * corner
            }
            Self::Prism { half, slopes } => {
                let fall = if y > 0.0 { slopes[0] * y } else { -slopes[1] * y };
                // The ridge is rounded.
                smooth_min(0.0, 0.05 - fall, 0.2) - 0.05
                    + rounded_edge(rectangle(x, y, *half, 0.1), 0.1)
            }
            Self::Bracket { half, leg, fillet } => {
                let along = rectangle(x, y + half[1] - leg / 2.0, [half[0], leg / 2.0], 0.1);
                let across = rectangle(x + half[0] - leg / 2.0, y, [leg / 2.0, half[1]], 0.1);
                rounded_edge(along.max(across), *fillet)
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
            Self::Arm { length, width, .. } => Some([length / 2.0, width / 2.0]),
            Self::Tab { half, .. } | Self::Prism { half, .. } | Self::Bracket { half, .. } => {
                Some(*half)
            }
            Self::Ring(stud) => Some([stud.diameter / 2.0, stud.diameter / stud.oval / 2.0]),
            Self::Turned(part) => Some([part.reach(); 2]),
            Self::Fastener(part) => Some(part.half_size()),
            Self::Clutter(thing) => Some(thing.half_size()),
            Self::Relief(relief) => Some(relief.half_size()),
            Self::Snap(snap) => Some(snap.half_size()),
            Self::Nut { half_width, .. } => Some([half_width / 0.75f64.sqrt(), *half_width]),
            Self::Lettering { half, half_width, .. } => {
                Some([half[0] + half_width, half[1] + half_width])
            }
        }
    }
}

/// Half the width over the flats of the hexagon about the origin that passes through a point.
fn hexagon(x: f64, y: f64) -> f64 {
    let (sin, cos) = (0.75f64.sqrt(), 0.5);
    y.abs().max((x * sin + y * cos).abs()).max((x * sin - y * cos).abs())
}
