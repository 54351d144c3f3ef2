//! Shadows that the relief casts on itself.
//!
//! Light falls in parallel rays and is blocked or not: no light goes round an edge or through the
//! gel, and what the relief reflects lights nothing else. A lamp has a size: a shadow's edge widens
//! with the distance from what casts it, from the last ray that meets the whole lamp to the first
//! that meets none of it.

use glam::{DVec2, DVec3, Vec2Swizzles};

use super::gel::Grid;

/// Where light comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Direction on the gel that points to the light, from x towards y, in radians.
    pub azimuth: f64,
    /// Angle above the gel, in radians.
    pub elevation: f64,
}

impl Ray {
    /// The place from which light comes that stands so far from the gel's middle, z towards the camera.
    pub fn place(&self, distance_mm: f64) -> DVec3 {
        let (sin, cos) = self.elevation.sin_cos();
        (DVec2::from_angle(self.azimuth) * (distance_mm * cos)).extend(distance_mm * sin)
    }
}

/// Lowest and steepest elevation of a ray, in radians.
const LOWEST: f64 = 0.02;
const STEEPEST: f64 = 1.5;

/// How much of the light each cell lacks, 0 to 1, on a surface of these heights towards the
/// camera, in millimetres.
///
/// `soft_mm` is the least width of a shadow's edge on flat gel, `size` half the angle over which the
/// lamp reaches up and down, in radians. One pass from the light's side keeps the height below which
/// the lamp's lower end is hidden, which falls by the slope of its rays from cell to cell, and how far
/// below that its upper end is hidden too, which grows with the distance from what hides it.
///
/// # Panics
/// If `heights` is not as long as the grid.
pub fn cast(grid: Grid, heights: &[f32], ray: Ray, soft_mm: f64, size: f64) -> Vec<f32> {
    let n = grid.cells;
    assert_eq!(heights.len(), n * n);
    // Of the rays that reach furthest behind an edge, from the lamp's lower end.
    let slope = (ray.elevation - size).max(LOWEST).tan();
    let upper = (ray.elevation + size).clamp(LOWEST, STEEPEST).tan();
    let soft = (soft_mm * slope).max(1e-4) as f32;
    // Rays go along the axis that they are closer to: `lines` are met one after the other, and
    // from one to the next a ray moves by `shift` cells along the line.
    let to = DVec2::from_angle(ray.azimuth);
    let along_x = to.x.abs() > to.y.abs();
    let [major, minor] = if along_x { to } else { to.yx() }.to_array();
    let run = grid.spacing_mm / major.abs();
    let drop = (slope * run) as f32;
    let widen = ((upper - slope).max(0.0) * run) as f32;
    let shift = (minor / major.abs()) as f32;
    let index = |line: usize, at: usize| if along_x { at * n + line } else { line * n + at };

    let mut shadow = vec![0.0f32; n * n];
    // The bound's height, and what the shadow's edge has widened by in height.
    let mut bound = vec![[f32::NEG_INFINITY, 0.0]; n];
    let mut next = bound.clone();
    for step in 0..n {
        // The light stands on the side where the axis ends if `major` is positive.
        let line = if major > 0.0 { n - 1 - step } else { step };
        for at in 0..n {
            let height = heights[index(line, at)];
            let from = at as f32 + shift;
            let cell = from.floor();
            let t = from - cell;
            let get = |i: f32| {
                let inside = i >= 0.0 && (i as usize) < n;
                if inside { bound[i as usize] } else { [f32::NEG_INFINITY, 0.0] }
            };
            let ([a, wide_a], [b, wide_b]) = (get(cell), get(cell + 1.0));
            let [above, wide] = if a.is_finite() && b.is_finite() {
                [a + t * (b - a), wide_a + t * (wide_b - wide_a)]
            } else if a > b {
                [a, wide_a]
            } else {
                [b, wide_b]
            };
            let (above, wide) = (above - drop, wide + widen);
            let t = ((above - height) / (soft + wide)).clamp(0.0, 1.0);
            shadow[index(line, at)] = t * t * (3.0 - 2.0 * t);
            next[at] = if above > height { [above, wide] } else { [height, 0.0] };
        }
        std::mem::swap(&mut bound, &mut next);
    }
    shadow
}
