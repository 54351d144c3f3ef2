//! Whether reliefs would show as the same on the gel.

use std::f64::consts::TAU;

use glam::DVec2;

use super::Relief;

/// Heights that differ by less look the same, in millimetres: less than the sensor's noise shows on a flat slope.
const ALIKE_MM: f64 = 0.02;
/// So do outlines, in millimetres across the gel: the paper's pixel.
const BESIDE_MM: f64 = 0.04;
/// Parts of a full turn that a part is tried for, larger numbers first.
const TURNS: [u32; 10] = [12, 10, 9, 8, 7, 6, 5, 4, 3, 2];

/// What turns change nothing about how a part looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Symmetry {
    /// None: it has a direction.
    None,
    /// Half a turn.
    Half,
    /// A quarter of a turn.
    Quarter,
    /// This part of a turn: 3, or 5 to 12.
    Other(u32),
    /// Any.
    Round,
}

impl Relief {
    /// After which turns the part looks the same to presses of at most `depth_mm`, by its own heights.
    pub fn symmetry(&self, depth_mm: f64) -> Symmetry {
        let shape = Shape::new(self, depth_mm);
        let same = |angle| shape.covers(&shape, angle) && shape.covers(&shape, -angle);
        // Turns of the golden section of a full one: no part of regular sides is the same after all of them.
        if (1..=16).all(|turn| same(f64::from(turn) * 0.618_033_988_75 * TAU)) {
            return Symmetry::Round;
        }
        match TURNS.into_iter().find(|&turns| same(TAU / f64::from(turns))) {
            None => Symmetry::None,
            Some(2) => Symmetry::Half,
            Some(4) => Symmetry::Quarter,
            Some(turns) => Symmetry::Other(turns),
        }
    }

    /// Whether another part, turned and moved, looks the same to presses of at most `depth_mm`.
    pub fn looks_like(&self, other: &Self, depth_mm: f64) -> bool {
        let [one, other] = [self, other].map(|relief| Shape::new(relief, depth_mm));
        // From turn to turn the outermost point moves by a pixel.
        let turns = (TAU * one.reach.max(other.reach) / BESIDE_MM).ceil().max(16.0);
        (0..turns as usize).any(|turn| {
            let angle = turn as f64 / turns * TAU;
            one.covers(&other, angle) && other.covers(&one, -angle)
        })
    }
}

/// What a press to some depth sees of a relief.
struct Shape<'a> {
    relief: &'a Relief,
    depth: f32,
    /// The least and the greatest height near each cell of the walls' grid.
    low: Vec<f32>,
    high: Vec<f32>,
    /// Mean of the places seen, weighted by height over the depth.
    center: DVec2,
    /// Radius about it of what is seen.
    reach: f64,
    /// Places seen, from the centre, with their heights; in an order that jumps about.
    points: Vec<(DVec2, f32)>,
}

impl<'a> Shape<'a> {
    fn new(relief: &'a Relief, depth_mm: f64) -> Self {
        let walls = &relief.walls;
        // Some hundredths at least, or nothing is seen.
        let depth = depth_mm.max(2.0 * ALIKE_MM) as f32;
        let heights: Vec<f32> = walls.heights.iter().map(|h| h.max(-depth)).collect();
        // At least two cells: outlines lie between them, and turned ones between others.
        let radius = ((BESIDE_MM / walls.spacing_mm).ceil() as usize).max(2);
        let [columns, _] = walls.cells;
        let near = |pick: fn(f32, f32) -> f32| {
            let lines = window(&heights, columns, 1, radius, pick);
            window(&lines, columns, columns, radius, pick)
        };
        let (low, high) = (near(f32::min), near(f32::max));
        let seen = || (0..heights.len()).filter(|&at| heights[at] > -depth);
        let (mut sum, mut center) = (0.0, DVec2::ZERO);
        for at in seen() {
            let weight = f64::from(heights[at] + depth);
            sum += weight;
            center += weight * DVec2::from_array(walls.position(at));
        }
        center /= sum;
        // No two neighbours say much more than one: each says what is near it.
        let grid = seen().filter(|at| (at % columns + at / columns) % radius == 0);
        let points: Vec<_> =
            grid.map(|at| (DVec2::from_array(walls.position(at)) - center, heights[at])).collect();
        let reach = points.iter().map(|(point, _)| point.length()).fold(0.0, f64::max);
        // A prime that is no divisor of so few points: every one comes once.
        let jumped = (0..points.len()).map(|i| points[i * 1_000_003 % points.len()]).collect();
        Self { relief, depth, low, high, center, reach, points: jumped }
    }

    /// Whether every place of `other` turned by an angle has a height as this one has near it.
    fn covers(&self, other: &Self, angle: f64) -> bool {
        let walls = &self.relief.walls;
        let turn = DVec2::from_angle(angle);
        other.points.iter().all(|(point, height)| {
            let place = self.center + turn.rotate(*point);
            let cell = |axis: usize| {
                let at = place[axis] / walls.spacing_mm + walls.cells[axis] as f64 / 2.0;
                (at >= 0.0 && at < walls.cells[axis] as f64).then_some(at as usize)
            };
            let near = cell(0).zip(cell(1)).map(|(column, row)| row * walls.cells[0] + column);
            let [low, high] = near.map_or([-self.depth; 2], |at| [self.low[at], self.high[at]]);
            (low - ALIKE_MM as f32..=high + ALIKE_MM as f32).contains(height)
        })
    }
}

/// Of each cell the least, or the greatest, of those at most `radius` steps before and behind it.
fn window(
    field: &[f32],
    columns: usize,
    step: usize,
    radius: usize,
    pick: fn(f32, f32) -> f32,
) -> Vec<f32> {
    let place = |at: usize| if step == 1 { at % columns } else { at / columns };
    let count = if step == 1 { columns } else { field.len() / columns };
    let near = |at: usize| {
        let (before, behind) = (radius.min(place(at)), radius.min(count - 1 - place(at)));
        let cells = (0..=before + behind).map(|i| field[at - before * step + i * step]);
        cells.reduce(pick).unwrap_or(field[at])
    };
    (0..field.len()).map(near).collect()
}
