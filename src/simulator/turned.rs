//! Turned parts that are no snaps: domes, buttons, rivets and tori.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::outline::{WALL_SLOPE, rounded_edge, smooth_min};

/// A part that is round about its middle, but for the holes of a button. Lengths in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub enum Turned {
    /// A cap of a ball.
    Dome {
        /// Radius of its rim.
        radius: f64,
        /// Radius of the ball, at least that.
        ball: f64,
    },
    /// A disc that is lower within its rim, with holes.
    Button {
        /// Radius.
        radius: f64,
        /// Width of its rim.
        rim: f64,
        /// How much lower it is within.
        dish: f64,
        /// Holes, round its middle.
        holes: u32,
        /// Radius of a hole.
        hole: f64,
        /// Radius of the edges.
        fillet: f64,
    },
    /// A domed head on a flange.
    Rivet {
        /// Radius of the head.
        head: f64,
        /// Height of the head over the flange.
        height: f64,
        /// Radius of the flange.
        flange: f64,
        /// Radius of the edges.
        fillet: f64,
    },
    /// A ring with a round section, whose hole is filled to some height.
    Torus {
        /// Radius of the ring's middle.
        radius: f64,
        /// Half its width.
        section: f64,
        /// How much lower the hole's floor is than the ring's top.
        floor: f64,
    },
}

impl Turned {
    /// Draws a cap of a ball, from flat to half a ball.
    pub fn dome(rng: &mut Pcg64) -> Self {
        let radius = rng.random_range(1.2f64.ln()..7f64.ln()).exp();
        Self::Dome { radius, ball: radius * rng.random_range(1.0..4.0) }
    }

    /// Draws a button.
    pub fn button(rng: &mut Pcg64) -> Self {
        let radius = rng.random_range(2.0..7.0);
        let holes = [0, 1, 2, 4][rng.random_range(0..4)];
        Self::Button {
            radius,
            rim: radius * rng.random_range(0.1..0.35),
            dish: rng.random_range(0.1..0.7),
            holes,
            hole: radius * rng.random_range(0.06..if holes == 1 { 0.4 } else { 0.16 }),
            fillet: rng.random_range(0.05..0.4),
        }
    }

    /// Draws a rivet.
    pub fn rivet(rng: &mut Pcg64) -> Self {
        let head: f64 = rng.random_range(1.0..4.0);
        Self::Rivet {
            head,
            height: (head * rng.random_range(0.2..0.8)).min(1.5),
            flange: head * rng.random_range(1.1..2.2),
            fillet: rng.random_range(0.05..0.3),
        }
    }

    /// Draws a torus: of one in two the hole is filled so far that its floor may touch.
    pub fn torus(rng: &mut Pcg64) -> Self {
        let radius: f64 = rng.random_range(1.5..6.0);
        let section = (radius * rng.random_range(0.1..0.5)).min(1.5);
        let deep = 2.0 * section + 3.0;
        let floor = if rng.random_bool(0.5) { rng.random_range(0.05..1.2) } else { deep };
        Self::Torus { radius, section, floor }
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let r = x.hypot(y);
        match self {
            Self::Dome { radius, ball } => cap(r, *radius, *ball),
            Self::Button { radius, rim, dish, holes, hole, fillet } => {
                let within = radius - rim - r;
                let top = rounded_edge(-within, *fillet).max(-dish);
                let to_hole = match holes {
                    0 => f64::INFINITY,
                    1 => r - hole,
                    _ => {
                        let sector = std::f64::consts::TAU / f64::from(*holes);
                        let angle = y.atan2(x);
                        let angle = angle - sector * (angle / sector).round();
                        let at = 0.35 * radius;
                        (r * angle.cos() - at).hypot(r * angle.sin()) - hole
                    }
                };
                top + rounded_edge((radius - r).min(to_hole), *fillet)
            }
            Self::Rivet { head, height, flange, fillet } => {
                // The ball whose cap has this height over this radius.
                let ball = (head * head + height * height) / (2.0 * height);
                let dome = cap(r, *head, ball);
                dome.max(rounded_edge(flange - r, *fillet) - height)
            }
            Self::Torus { radius, section, floor } => {
                let off = r - radius;
                let ring = cap(off.abs(), *section, *section);
                if off < 0.0 { ring.max(-floor) } else { ring }
            }
        }
    }

    /// Its radius.
    pub fn reach(&self) -> f64 {
        match self {
            Self::Dome { radius, .. } | Self::Button { radius, .. } => *radius,
            Self::Rivet { flange, .. } => *flange,
            Self::Torus { radius, section, .. } => radius + section,
        }
    }
}

/// Height of a ball's cap at `r` from its middle: 0 there, a wall beyond its rim.
fn cap(r: f64, rim: f64, ball: f64) -> f64 {
    let at = r.min(rim);
    let fall = ball - (ball * ball - at * at).max(0.0).sqrt();
    // A half sphere falls for ever at its rim: the wall begins where it is as steep.
    smooth_min(-fall, WALL_SLOPE * (rim - r), 0.05).min(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cap of radius 3 on a ball of radius 5 is 1 mm high.
    #[test]
    fn heights_by_hand() {
        let dome = Turned::Dome { radius: 3.0, ball: 5.0 };
        assert_eq!(dome.height(0.0, 0.0), 0.0);
        assert!((dome.height(2.9, 0.0) + 5.0 - (25.0f64 - 2.9 * 2.9).sqrt()).abs() < 1e-9);
        assert!(dome.height(0.0, 3.5) <= -2.5);
        let rivet = Turned::Rivet { head: 3.0, height: 1.0, flange: 4.0, fillet: 0.1 };
        assert_eq!(rivet.height(3.5, 0.0), -1.0);
        assert!(rivet.height(4.5, 0.0) < -3.0);
        let torus = Turned::Torus { radius: 4.0, section: 1.0, floor: 0.3 };
        assert!(torus.height(0.0, 4.0).abs() < 1e-9);
        assert_eq!([torus.height(0.0, 0.0), torus.height(1.0, 1.0)], [-0.3; 2]);
        let button =
            Turned::Button { radius: 4.0, rim: 1.0, dish: 0.5, holes: 2, hole: 0.4, fillet: 0.1 };
        assert_eq!([button.height(3.5, 0.0), button.height(0.0, 2.0)], [0.0, -0.5]);
        // The holes lie at 0.35 of the radius, on both sides.
        assert!(button.height(1.4, 0.0) < -2.0 && button.height(-1.4, 0.0) < -2.0);
    }
}
