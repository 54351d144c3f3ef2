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
        are_alike(&[self, other].map(|relief| Shape::new(relief, depth_mm)))
    }

    /// Depth in millimetres from which presses tell it from another part: `None` where those of `most_mm` do not.
    pub fn told_apart_mm(&self, other: &Self, most_mm: f64) -> Option<f64> {
        let mut shapes = [self, other].map(|relief| Shape::new(relief, most_mm));
        if are_alike(&shapes) {
            return None;
        }
        let (mut alike, mut apart) = (0.0, most_mm);
        while apart - alike > ALIKE_MM {
            let middle = (alike + apart) / 2.0;
            shapes.iter_mut().for_each(|shape| shape.press(middle));
            *(if are_alike(&shapes) { &mut alike } else { &mut apart }) = middle;
        }
        Some(apart)
    }
}

/// Whether two shapes, turned and moved, look the same.
fn are_alike([one, other]: &[Shape; 2]) -> bool {
    // From turn to turn the outermost point moves by a pixel.
    let turns = (TAU * one.reach.max(other.reach) / BESIDE_MM).ceil().max(16.0);
    (0..turns as usize).any(|turn| {
        let angle = turn as f64 / turns * TAU;
        one.covers(other, angle) && other.covers(one, -angle)
    })
}

/// What a press to some depth sees of a relief.
struct Shape<'a> {
    relief: &'a Relief,
    depth: f32,
    /// The least and the greatest height near each cell of the walls' grid, whatever the depth.
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
        let [columns, _] = walls.cells;
        let radius = radius(walls.spacing_mm);
        let near = |pick: fn(f32, f32) -> f32| {
            let lines = window(&walls.heights, columns, 1, radius, pick);
            window(&lines, columns, columns, radius, pick)
        };
        let (low, high) = (near(f32::min), near(f32::max));
        let (center, points) = (DVec2::ZERO, Vec::new());
        let mut shape = Self { relief, depth: 0.0, low, high, center, reach: 0.0, points };
        shape.press(depth_mm);
        shape
    }

    /// Presses it to another depth.
    fn press(&mut self, depth_mm: f64) {
        let walls = &self.relief.walls;
        // Some hundredths at least, or nothing is seen.
        self.depth = depth_mm.max(2.0 * ALIKE_MM) as f32;
        let (heights, [columns, _]) = (&walls.heights, walls.cells);
        let seen = || (0..heights.len()).filter(|&at| heights[at] > -self.depth);
        let (mut sum, mut center) = (0.0, DVec2::ZERO);
        for at in seen() {
            let weight = f64::from(heights[at] + self.depth);
            sum += weight;
            center += weight * DVec2::from_array(walls.position(at));
        }
        center /= sum;
        // No two neighbours say much more than one: each says what is near it.
        let radius = radius(walls.spacing_mm);
        let grid = seen().filter(|at| (at % columns + at / columns) % radius == 0);
        let points: Vec<_> =
            grid.map(|at| (DVec2::from_array(walls.position(at)) - center, heights[at])).collect();
        self.center = center;
        self.reach = points.iter().map(|(point, _)| point.length()).fold(0.0, f64::max);
        // A prime that is no divisor of so few points: every one comes once.
        self.points = (0..points.len()).map(|i| points[i * 1_000_003 % points.len()]).collect();
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
            let [low, high] = near
                .map_or([-self.depth; 2], |at| [self.low[at], self.high[at]])
                .map(|height| height.max(-self.depth));
            (low - ALIKE_MM as f32..=high + ALIKE_MM as f32).contains(height)
        })
    }
}

/// How many cells beside a place look like it: two at least, for outlines lie between them, and turned ones between
/// others.
fn radius(spacing_mm: f64) -> usize {
    ((BESIDE_MM / spacing_mm).ceil() as usize).max(2)
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
