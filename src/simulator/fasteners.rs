//! Clips and pins of other kinds, which are no snaps of A or B.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::outline::{rectangle, rounded_edge, stroke};

/// A fastener that is pressed from its side. Lengths in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub enum Fastener {
    /// Two legs along x, joined by a bend at their end against x, with bumps inside or outside at their tips.
    Clip {
        /// Length of the legs.
        length: f64,
        /// Half the distance of their middles.
        half_gap: f64,
        /// Half their width.
        half_width: f64,
        /// How far the tips' bumps stand out, inwards if negative; 0 without.
        bump: f64,
        /// Radius of the edges.
        fillet: f64,
    },
    /// A shaft along x with fins across, which grow shorter towards its tip, and a head.
    FirTree {
        /// Length of the shaft.
        length: f64,
        /// Half the shaft's width.
        half_width: f64,
        /// Half the longest fin's length.
        half_fin: f64,
        /// Half a fin's thickness.
        half_thickness: f64,
        /// Number of fins.
        fins: u32,
        /// The last fin's length over the first's.
        taper: f64,
        /// How far the fins lean back, along x for a step along y.
        lean: f64,
        /// Half the head's length across; 0 without.
        half_head: f64,
        /// Radius of the edges.
        fillet: f64,
    },
}

impl Fastener {
    /// Draws a clip.
    pub fn clip(rng: &mut Pcg64) -> Self {
        let half_width = rng.random_range(0.3..1.0);
        let bump = rng.random_range(0.3..1.0) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        Self::Clip {
            length: rng.random_range(4.0..11.0),
            half_gap: half_width + rng.random_range(0.5..2.2),
            half_width,
            bump: if rng.random_bool(0.7) { bump * half_width } else { 0.0 },
            fillet: rng.random_range(0.05..half_width),
        }
    }

    /// Draws a fir-tree pin.
    pub fn fir_tree(rng: &mut Pcg64) -> Self {
        let half_width = rng.random_range(0.4..1.2);
        let half_fin = half_width + rng.random_range(0.5..2.2);
        Self::FirTree {
            length: rng.random_range(6.0..13.0),
            half_width,
            half_fin,
            half_thickness: rng.random_range(0.15..0.45),
            fins: rng.random_range(3..=7),
            taper: rng.random_range(0.5..1.0),
            lean: rng.random_range(0.0..0.8),
            half_head: if rng.random_bool(0.7) {
                half_fin * rng.random_range(0.9..1.6)
            } else {
                0.0
            },
            fillet: rng.random_range(0.05..half_width),
        }
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Clip { length, half_gap, half_width, bump, fillet } => {
                let (end, side) = (length / 2.0, y.abs());
                let leg = stroke(x, side, [-end, *half_gap], [end, *half_gap], *half_width);
                // The bend's middle lies where the legs begin.
                let from = (x + end).hypot(y);
                let bend =
                    if x < -end { half_width - (from - half_gap).abs() } else { f64::NEG_INFINITY };
                let tip = [end - half_width, half_gap + bump];
                let bumped = half_width - (x - tip[0]).hypot(side - tip[1]);
                let inside = leg.max(bend);
                let inside = if *bump == 0.0 { inside } else { inside.max(bumped) };
                rounded_edge(inside, *fillet)
            }
            Self::FirTree {
                length,
                half_width,
                half_fin,
                half_thickness,
                fins,
                taper,
                lean,
                half_head,
                fillet,
            } => {
                let end = length / 2.0;
                let shaft = stroke(x, y, [-end, 0.0], [end - half_width, 0.0], *half_width);
                let step = 0.85 * length / f64::from(*fins);
                let fin = |i: u32| {
                    let at = -end + 0.15 * length + step * (f64::from(i) + 0.5);
                    let share = f64::from(i) / f64::from((*fins - 1).max(1));
                    let reach =
                        half_width + (half_fin - half_width) * (1.0 + share * (taper - 1.0));
                    stroke(x, y.abs(), [at, 0.0], [at - lean * reach, reach], *half_thickness)
                };
                let fins = (0..*fins).map(fin).fold(shaft, f64::max);
                let head = rectangle(x + end, y, [0.6, *half_head], 0.1);
                let inside = if *half_head > 0.0 { fins.max(head) } else { fins };
                rounded_edge(inside, fillet.min(*half_thickness))
            }
        }
    }

    /// Half its size along x and y.
    pub fn half_size(&self) -> [f64; 2] {
        match self {
            Self::Clip { length, half_gap, half_width, bump, .. } => {
                let across = half_gap + half_width + bump.max(0.0);
                [length / 2.0 + half_gap + half_width, across]
            }
            Self::FirTree { length, half_width, half_fin, half_thickness, half_head, .. } => {
                // The shaft's end is round, the head 0.6 mm thick on either side of it.
                [length / 2.0 + half_width.max(0.6), half_head.max(half_fin + half_thickness)]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn a_clip_is_open_on_one_side() {
        let clip =
            Fastener::Clip { length: 6.0, half_gap: 2.0, half_width: 0.5, bump: 0.0, fillet: 0.1 };
        let touches = |x: f64, y: f64| clip.height(x, y) == 0.0;
        assert!(touches(0.0, 2.0) && touches(0.0, -2.0) && touches(-5.0, 0.0));
        assert!(!touches(0.0, 0.0) && !touches(3.0, 0.0) && !touches(-3.0, 0.0));
    }

    #[test]
    fn nothing_is_higher_than_0_or_outside_its_size() {
        let rng = &mut Pcg64::seed_from_u64(3);
        for i in 0..200 {
            let part = if i % 2 == 0 { Fastener::clip(rng) } else { Fastener::fir_tree(rng) };
            let [a, b] = part.half_size();
            for j in 0..900 {
                let (x, y) = (f64::from(j % 30) / 2.0 - 7.25, f64::from(j / 30) / 2.0 - 7.25);
                let height = part.height(x, y);
                assert!(height <= 0.0, "{part:?}");
                assert!(height < 0.0 || (x.abs() <= a && y.abs() <= b), "{part:?} at {x}, {y}");
            }
        }
    }
}
