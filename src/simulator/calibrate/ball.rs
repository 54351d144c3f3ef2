//! The gel's surface under a ball.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::super::contact::{NO_BODY, Stop, solve};
use super::super::gel::{Elasticity, Grid, Layer};
use super::super::surface::Surface;

/// Cells of the contact's grid, and the side of one over the ball's radius: 34 cells.
const CELLS: usize = 640;
const SPACING: f64 = 0.0295;
const STOP: Stop = Stop { tolerance_mm: 1e-5, max_iterations: 400 };
/// Steps of a contact's radius, in pixels: a solution for each is much work.
const STEP_PX: f64 = 0.5;

/// Surfaces under one ball by the radius of its contact.
pub(super) struct Surfaces(BTreeMap<u32, Surface>);

impl Surfaces {
    /// For these radii in pixels; all are below the ball's.
    pub fn new(ball_mm: f64, mm_per_pixel: f64, radii_px: impl Iterator<Item = f64>) -> Self {
        let steps: BTreeSet<u32> = radii_px.map(step).collect();
        let steps: Vec<u32> = steps.into_iter().collect();
        let solved = steps.into_par_iter().map(|step| {
            let contact_mm = f64::from(step) * STEP_PX * mm_per_pixel;
            (step, surface(ball_mm, contact_mm))
        });
        Self(solved.collect())
    }

    /// The surface for a radius that it was made for.
    pub fn of(&self, radius_px: f64) -> &Surface {
        &self.0[&step(radius_px)]
    }
}

fn step(radius_px: f64) -> u32 {
    (radius_px / STEP_PX).round().max(1.0) as u32
}

/// Finds the depth at which the contact has this radius, by bisection.
fn surface(ball_mm: f64, contact_mm: f64) -> Surface {
    let grid = Grid { cells: CELLS, spacing_mm: ball_mm * SPACING };
    let mut elasticity = Elasticity::new(&Layer::default(), grid);
    let n = grid.cells;
    let mut press = |depth: f64| {
        let mut body = vec![NO_BODY; grid.len()];
        for y in 0..n {
            for x in 0..n {
                let r2 = grid.position(x).powi(2) + grid.position(y).powi(2);
                if r2 < ball_mm * ball_mm {
                    body[y * n + x] = (depth - ball_mm + (ball_mm * ball_mm - r2).sqrt()) as f32;
                }
            }
        }
        let contact = solve(&mut elasticity, &body, STOP);
        let cells = contact.pressure.iter().filter(|p| **p > 0.0).count() as f64;
        let radius = (cells / std::f64::consts::PI).sqrt() * grid.spacing_mm;
        (radius, contact)
    };
    let (mut low, mut high) = (0.0, 2.0 * ball_mm);
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        if press(middle).0 < contact_mm {
            low = middle;
        } else {
            high = middle;
        }
    }
    let (_, contact) = press(0.5 * (low + high));
    Surface::new(grid, contact.displacement)
}
