//! Frictionless contact of the gel with a rigid body: `p ≥ 0`, `gap ≥ 0`, `p · gap = 0`.
//!
//! Solved by the projected conjugate gradients of I. A. Polonsky and L. M. Keer, "A numerical
//! method for solving rough contact problems based on the multi-level multi-summation and
//! conjugate gradient techniques", Wear 231 (1999), at prescribed indentation (their §3 without
//! the balance of load).

use super::gel::Elasticity;

/// Penetration of a cell that the rigid body does not reach.
pub const NO_BODY: f32 = f32::NEG_INFINITY;

/// How far a body may lie above the undeformed gel and still be met by the gel's bulge, in mm.
const BULGE_MM: f32 = 0.6;

/// When [`solve`] stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Root mean square of the gap over the cells under pressure, and the deepest overlap
    /// anywhere else divided by ten, at most this, in millimetres.
    pub tolerance_mm: f64,
    /// Iterations at most.
    pub max_iterations: usize,
}

/// The state of the gel under a rigid body, `[cells][cells]` row by row.
#[derive(Debug, Clone)]
pub struct Contact {
    /// Pressure in megapascals; positive exactly where the gel touches the body.
    pub pressure: Vec<f32>,
    /// Displacement of the surface into the gel in millimetres; negative where it bulges.
    pub displacement: Vec<f32>,
    /// Iterations spent.
    pub iterations: usize,
    /// Root mean square of the gap over the cells under pressure, in millimetres.
    pub residual_mm: f64,
}

impl Contact {
    /// Total force in newtons on a grid of this spacing.
    pub fn force_n(&self, spacing_mm: f64) -> f64 {
        let sum: f64 = self.pressure.iter().map(|&p| f64::from(p)).sum();
        sum * spacing_mm * spacing_mm
    }
}

/// Presses a rigid body into the gel.
///
/// `penetration` is how far the body reaches below the undeformed surface, in millimetres
/// (negative: above it, [`NO_BODY`]: nowhere near).
///
/// # Panics
/// If `penetration` is not as long as the grid.
pub fn solve(elasticity: &mut Elasticity, penetration: &[f32], stop: Stop) -> Contact {
    let n = elasticity.grid().cells;
    assert_eq!(penetration.len(), n * n);
    let rows: Vec<bool> =
        penetration.chunks_exact(n).map(|row| row.iter().any(|&d| d > -BULGE_MM)).collect();
    let all = vec![true; n];
    // A stiff guess: the pressure that a spring under each cell would need.
    let mut pressure: Vec<f32> =
        penetration.iter().map(|&d| if d > 0.0 { 0.1 * d } else { 0.0 }).collect();
    let mut displacement = vec![0.0; n * n];

    let mut direction = vec![0.0f32; n * n];
    let mut response = vec![0.0f32; n * n];
    let mut previous = 0.0;
    let mut conjugate = false;
    let mut iterations = 0;
    let active = |y: usize| y * n..(y + 1) * n;
    let mut fresh = false;
    let residual_mm = loop {
        if !fresh {
            elasticity.displacement(&pressure, &rows, &rows, &mut displacement);
        }
        // The gap over the contact, and the worst overlap outside it.
        let mut sum = 0.0f64;
        let mut count = 0usize;
        let mut overlap = 0.0f32;
        for y in (0..n).filter(|&y| rows[y]) {
            for i in active(y) {
                let gap = displacement[i] - penetration[i];
                if pressure[i] > 0.0 {
                    sum += f64::from(gap) * f64::from(gap);
                    count += 1;
                } else {
                    overlap = overlap.max(-gap);
                }
            }
        }
        let residual_mm = if count == 0 { 0.0 } else { (sum / count as f64).sqrt() };
        let done =
            residual_mm <= stop.tolerance_mm && f64::from(overlap) <= 10.0 * stop.tolerance_mm;
        if done || iterations == stop.max_iterations {
            break residual_mm;
        }
        iterations += 1;

        let factor = if conjugate && previous > 0.0 { (sum / previous) as f32 } else { 0.0 };
        previous = sum;
        for y in (0..n).filter(|&y| rows[y]) {
            for i in active(y) {
                direction[i] = if pressure[i] > 0.0 {
                    displacement[i] - penetration[i] + factor * direction[i]
                } else {
                    0.0
                };
            }
        }
        elasticity.displacement(&direction, &rows, &rows, &mut response);
        let mut along = 0.0f64;
        let mut curvature = 0.0f64;
        for y in (0..n).filter(|&y| rows[y]) {
            for i in active(y) {
                if pressure[i] > 0.0 {
                    let t = f64::from(direction[i]);
                    along += f64::from(displacement[i] - penetration[i]) * t;
                    curvature += f64::from(response[i]) * t;
                }
            }
        }
        let step = if curvature > 0.0 { along / curvature } else { 0.0 } as f32;
        let mut clipped = false;
        conjugate = true;
        for y in (0..n).filter(|&y| rows[y]) {
            for i in active(y) {
                if pressure[i] > 0.0 {
                    let p = pressure[i] - step * direction[i];
                    clipped |= p < 0.0;
                    pressure[i] = p.max(0.0);
                }
            }
        }
        // Cells that overlap without pressure join the contact.
        let join = if step > 0.0 { step } else { 0.1 };
        for y in (0..n).filter(|&y| rows[y]) {
            for i in active(y) {
                let gap = displacement[i] - penetration[i];
                if pressure[i] == 0.0 && direction[i] == 0.0 && gap < 0.0 {
                    pressure[i] = -join * gap;
                    conjugate = false;
                }
            }
        }
        // Without projection the displacement follows from the response already at hand.
        fresh = !clipped && conjugate;
        if fresh {
            for y in (0..n).filter(|&y| rows[y]) {
                for i in active(y) {
                    displacement[i] -= step * response[i];
                }
            }
        }
    };
    elasticity.displacement(&pressure, &rows, &all, &mut displacement);
    Contact { pressure, displacement, iterations, residual_mm }
}
