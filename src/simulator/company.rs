//! Parts of a wide picture that stand side by side, a given gap apart: what [`Forced::gap`] asks for.
//!
//! [`Forced::gap`]: super::forced::Forced::gap

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec2;
use rand::RngExt;
use rand::seq::IndexedRandom;

use super::distractors::{Distractor, Part};
use super::forced::Span;
use super::layout::Layout;
use super::scene::{Mix, Placed, sample_tilt, sample_yaw};
use super::snaps::Snap;

/// Share of what stands beside a snap that is none.
const OTHERS: f64 = 0.2;
/// Share of neighbours that stand along each other or across.
const ALIGNED: f64 = 0.6;
/// Attempts to place a part.
const TRIES: u32 = 60;
/// Directions along which two outlines are parted.
const DIRECTIONS: u32 = 90;

/// A convex outline: a turned rectangle, or an ellipse.
#[derive(Debug, Clone, Copy)]
struct Outline {
    center: DVec2,
    half: [f64; 2],
    yaw: f64,
    round: bool,
}

impl Outline {
    /// About the gel's middle.
    fn of(half: [f64; 2], round: bool) -> Self {
        Self { center: DVec2::ZERO, half, yaw: 0.0, round }
    }

    fn of_other(part: &Distractor) -> Option<Self> {
        use Distractor::{Pin, Ring, Screw, Turned};
        let round = matches!(part, Pin { .. } | Ring(_) | Screw { .. } | Turned(_));
        Some(Self::of(part.half_size()?, round))
    }

    /// How far it reaches from its centre in this direction.
    fn extent(&self, angle: f64) -> f64 {
        let (sin, cos) = (angle - self.yaw).sin_cos();
        let (a, b) = (self.half[0] * cos.abs(), self.half[1] * sin.abs());
        if self.round { a.hypot(b) } else { a + b }
    }

    /// Distance to another, negative where they overlap: of convex outlines the most by which a
    /// direction parts them.
    fn gap(&self, other: &Self) -> f64 {
        let offset = other.center - self.center;
        let own = [self.yaw, self.yaw + FRAC_PI_2, other.yaw, other.yaw + FRAC_PI_2];
        let all = (0..DIRECTIONS).map(|i| PI * f64::from(i) / f64::from(DIRECTIONS));
        own.into_iter()
            .chain(all)
            .chain([offset.y.atan2(offset.x)])
            .map(|angle| {
                let along = offset.dot(DVec2::from_angle(angle)).abs();
                along - self.extent(angle) - other.extent(angle)
            })
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// Moved away from another in this direction until they are so far apart.
    fn beside(self, other: &Self, angle: f64, gap: f64) -> Self {
        let at = |distance: f64| Self {
            center: other.center + distance * DVec2::from_angle(angle),
            ..self
        };
        let far = self.half[0].hypot(self.half[1]) + other.half[0].hypot(other.half[1]) + gap;
        let (mut near, mut far) = (0.0, far);
        for _ in 0..30 {
            let middle = (near + far) / 2.0;
            if at(middle).gap(other) < gap { near = middle } else { far = middle }
        }
        at(far)
    }
}

/// One of the company.
enum Shape {
    Snap(Snap),
    Other(Distractor),
}

impl Shape {
    /// `None` for a plate, which would cover those beside it.
    fn outline(&self) -> Option<Outline> {
        match self {
            Self::Snap(snap) => Some(Outline::of(snap.half_size(), matches!(snap, Snap::Stud(_)))),
            Self::Other(other) => Outline::of_other(other),
        }
    }
}

impl Layout<'_> {
    /// Two to five parts, each `gap` from one of those before it and no nearer to any. The first is a
    /// snap unless `mix` has none; `part` narrows what is no snap.
    pub(super) fn fill_with_company(&mut self, gap: Span, mix: Mix, part: Option<Part>) {
        let count = self.rng.random_range(2..=5);
        let mut company: Vec<Outline> = Vec::new();
        for _ in 0..count {
            let other = mix == Mix::None || (!company.is_empty() && self.rng.random_bool(OTHERS));
            let (shape, depth_mm) = if other {
                let block = self.rng.random_bool(0.5).then_some(Part::Block);
                let kind = self.draw_part(part.or(block));
                let shape = Distractor::sample_wide(self.rng, kind, self.forced);
                let Some(shape) = shape else { continue };
                (Shape::Other(shape), self.rng.random_range(0.3..1.5))
            } else {
                let kind = mix.kind(self.rng, &self.own.classes);
                let (snap, depth_mm) = self.draw_snap(&kind);
                (Shape::Snap(snap), depth_mm)
            };
            self.place_beside(shape, depth_mm, gap, &mut company);
        }
    }

    fn place_beside(&mut self, shape: Shape, depth_mm: f64, gap: Span, company: &mut Vec<Outline>) {
        let Some(drawn) = shape.outline() else { return };
        let tilt = sample_tilt(self.rng, 1.5);
        let [x0, y0, x1, y1] = self.visible;
        for _ in 0..TRIES {
            let outline = match company.choose(self.rng).copied() {
                Some(other) => {
                    let aligned = self.rng.random_bool(ALIGNED);
                    let quarters = f64::from(self.rng.random_range(0..4u8));
                    let any = sample_yaw(self.rng);
                    let yaw = if aligned { other.yaw + FRAC_PI_2 * quarters } else { any };
                    let angle = self.rng.random_range(0.0..TAU);
                    Outline { yaw, ..drawn }.beside(&other, angle, gap.sample(self.rng))
                }
                // In the middle half, so that others have room.
                None => {
                    let yaw = sample_yaw(self.rng);
                    let mut within = |low: f64, high: f64| {
                        low + (high - low) * self.rng.random_range(0.25..0.75)
                    };
                    let center = DVec2::new(within(x0, x1), within(y0, y1));
                    Outline { center, yaw, ..drawn }
                }
            };
            let [across, down] = [0.0, FRAC_PI_2].map(|angle| outline.extent(angle));
            let DVec2 { x, y } = outline.center;
            let is_whole = x - across > x0 && x + across < x1 && y - down > y0 && y + down < y1;
            // What is larger than the picture may be first.
            if !is_whole && !company.is_empty() {
                continue;
            }
            let (center_mm, yaw) = (outline.center.into(), outline.yaw);
            let snap = match &shape {
                Shape::Snap(snap) => {
                    Some(Placed { part: snap.clone(), center_mm, yaw, tilt, depth_mm })
                }
                Shape::Other(_) => None,
            };
            let wall = snap.as_ref().map_or_else(Vec::new, |snap| self.wall_of(snap));
            let pieces = wall.iter().map(|piece| {
                let outline = Outline::of_other(&piece.part)?;
                Some(Outline { center: piece.center_mm.into(), yaw: piece.yaw, ..outline })
            });
            let Some(mut taken) = pieces.collect::<Option<Vec<_>>>() else { continue };
            taken.push(outline);
            let is_free = |one: &Outline| company.iter().all(|c| c.gap(one) > gap.low - 1e-6);
            if !taken.iter().all(is_free) {
                continue;
            }
            company.extend(taken);
            self.scene.distractors.extend(wall);
            self.scene.snaps.extend(snap);
            if let Shape::Other(part) = shape {
                self.scene.distractors.push(Placed { part, center_mm, yaw, tilt, depth_mm });
            }
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(half: [f64; 2], yaw: f64, round: bool) -> Outline {
        Outline { yaw, ..Outline::of(half, round) }
    }

    /// Squares of side 2, side by side and corner to corner; a disc of radius 1 before a corner.
    #[test]
    fn gaps_by_hand() {
        let square = outline([1.0; 2], 0.0, false);
        let there = |center: [f64; 2], one: Outline| Outline { center: center.into(), ..one };
        assert!((square.gap(&there([5.0, 0.0], square)) - 3.0).abs() < 1e-9);
        assert!((square.gap(&there([5.0, 5.0], square)) - 18f64.sqrt()).abs() < 1e-9);
        let disc = outline([1.0; 2], 0.3, true);
        assert!((square.gap(&there([4.0, 4.0], disc)) - (18f64.sqrt() - 1.0)).abs() < 1e-9);
        assert!((square.gap(&there([1.5, 0.0], square)) + 0.5).abs() < 1e-9);
    }

    #[test]
    fn parts_are_put_as_far_apart_as_asked() {
        let (hook, stud) = (outline([4.0, 2.0], 0.4, false), outline([3.0, 2.5], 1.0, true));
        for i in 0..40 {
            let placed = stud.beside(&hook, f64::from(i) * TAU / 40.0, 0.7);
            assert!((placed.gap(&hook) - 0.7).abs() < 1e-6);
        }
    }
}
