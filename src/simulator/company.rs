//! Parts of a wide picture that stand side by side, a given gap apart: what [`Forced::gap`] asks for.
//!
//! [`Forced::gap`]: super::forced::Forced::gap

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;
use rand::RngExt;
use rand::seq::IndexedRandom;

use super::distractors::{Distractor, Part};
use super::footprint::Footprint;
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

/// The footprint moved away from another in this direction until they are so far apart.
fn beside(one: Footprint, other: &Footprint, angle: f64, gap: f64) -> Footprint {
    let at = |distance: f64| Footprint {
        center: other.center + distance * DVec2::from_angle(angle),
        ..one
    };
    let far = one.half[0].hypot(one.half[1]) + other.half[0].hypot(other.half[1]) + gap;
    let (mut near, mut far) = (0.0, far);
    for _ in 0..30 {
        let middle = (near + far) / 2.0;
        if at(middle).distance(other) < gap { near = middle } else { far = middle }
    }
    at(far)
}

/// One of the company.
enum Shape {
    Snap(Snap),
    Other(Distractor),
}

impl Shape {
    /// About the gel's middle; `None` for a plate, which would cover those beside it.
    fn footprint(&self) -> Option<Footprint> {
        use Distractor::{Pin, Ring, Screw, Turned};
        let (half, round) = match self {
            Self::Snap(snap) => (snap.half_size(), matches!(snap, Snap::Stud(_))),
            Self::Other(other) => {
                let round = matches!(other, Pin { .. } | Ring(_) | Screw { .. } | Turned(_));
                (other.half_size()?, round)
            }
        };
        Some(Footprint { round, ..Footprint::of([0.0; 2], half, 0.0) })
    }
}

impl Layout<'_> {
    /// Two to five parts, each `gap` from one of those before it and no nearer to any. The first is a
    /// snap unless `mix` has none; `part` narrows what is no snap.
    pub(super) fn fill_with_company(&mut self, gap: Span, mix: Mix, part: Option<Part>) {
        let count = self.rng.random_range(2..=5);
        let mut company: Vec<Footprint> = Vec::new();
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

    fn place_beside(
        &mut self,
        shape: Shape,
        depth_mm: f64,
        gap: Span,
        company: &mut Vec<Footprint>,
    ) {
        let Some(drawn) = shape.footprint() else { return };
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
                    beside(Footprint { yaw, ..drawn }, &other, angle, gap.sample(self.rng))
                }
                // In the middle half, so that others have room.
                None => {
                    let yaw = sample_yaw(self.rng);
                    let mut within = |low: f64, high: f64| {
                        low + (high - low) * self.rng.random_range(0.25..0.75)
                    };
                    let center = DVec2::new(within(x0, x1), within(y0, y1));
                    Footprint { center, yaw, ..drawn }
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
                Some(Footprint::of(piece.center_mm, piece.part.half_size()?, piece.yaw))
            });
            let Some(mut taken) = pieces.collect::<Option<Vec<_>>>() else { continue };
            taken.push(outline);
            let is_free =
                |one: &Footprint| company.iter().all(|c| c.distance(one) > gap.low - 1e-6);
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

    #[test]
    fn parts_are_put_as_far_apart_as_asked() {
        let hook = Footprint::of([0.0; 2], [4.0, 2.0], 0.4);
        let stud = Footprint { round: true, ..Footprint::of([0.0; 2], [3.0, 2.5], 1.0) };
        for i in 0..40 {
            let placed = beside(stud, &hook, f64::from(i) * TAU / 40.0, 0.7);
            assert!((placed.distance(&hook) - 0.7).abs() < 1e-6);
        }
    }
}
