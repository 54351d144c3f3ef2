//! Smoothing of pictures and on the contact's grid, and the relief that stands in for mechanics in some pictures.

use super::contact::Contact;
use super::gel::Grid;

/// A surface that follows the body where it reaches below the gel and falls off smoothly beside it,
/// as if it were in contact there.
///
/// No mechanics: the part's relief is blurred again and again by less, and set back to the body in
/// contact, over about `falloff_mm`. Nothing bulges and the gel bridges no gap by its own stiffness.
/// Many simulators of tactile sensors draw such surfaces, so a detector must know them.
///
/// # Panics
/// If `penetration` is not as long as the grid.
pub fn pressed(grid: Grid, penetration: &[f32], falloff_mm: f64) -> Contact {
    assert_eq!(penetration.len(), grid.len());
    let relief: Vec<f32> = penetration.iter().map(|d| d.max(0.0)).collect();
    let mut displacement = relief.clone();
    for share in [1.0, 0.5, 0.25] {
        blur(grid.cells, &mut displacement, share * falloff_mm / grid.spacing_mm);
        for (d, &r) in displacement.iter_mut().zip(&relief) {
            if r > 0.0 {
                *d = r;
            }
        }
    }
    let pressure = relief.iter().map(|&d| if d > 0.0 { 1.0 } else { 0.0 }).collect();
    Contact { pressure, displacement, iterations: 0, residual_mm: 0.0 }
}

/// Blurs a field on the grid in place by a Gaussian of this standard deviation in cells.
pub fn blur(cells: usize, field: &mut [f32], sigma: f64) {
    gaussian(cells, field, &mut Vec::new(), sigma, 3.0);
}

/// Blurs a plane `[height][width]` in place by a Gaussian of this standard deviation in its cells, cut off
/// at `reach` of them; edges are repeated. Less than 0.05 changes nothing.
pub fn gaussian(width: usize, plane: &mut [f32], scratch: &mut Vec<f32>, sigma: f64, reach: f64) {
    if sigma < 0.05 {
        return;
    }
    let height = plane.len() / width;
    let radius = (reach * sigma).ceil() as usize;
    let mut taps: Vec<f32> =
        (0..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32).collect();
    let sum = taps[0] + 2.0 * taps[1..].iter().sum::<f32>();
    taps.iter_mut().for_each(|t| *t /= sum);

    scratch.resize(plane.len(), 0.0);
    let mut padded = vec![0.0f32; width + 2 * radius];
    for (row, out) in plane.chunks_exact(width).zip(scratch.chunks_exact_mut(width)) {
        padded[..radius].fill(row[0]);
        padded[radius..radius + width].copy_from_slice(row);
        padded[radius + width..].fill(row[width - 1]);
        for (o, &v) in out.iter_mut().zip(&padded[radius..]) {
            *o = taps[0] * v;
        }
        for (i, &tap) in taps.iter().enumerate().skip(1) {
            let left = &padded[radius - i..];
            let right = &padded[radius + i..];
            for ((o, &a), &b) in out.iter_mut().zip(left).zip(right) {
                *o += tap * (a + b);
            }
        }
    }
    for (y, out) in plane.chunks_exact_mut(width).enumerate() {
        for (o, &v) in out.iter_mut().zip(&scratch[y * width..]) {
            *o = taps[0] * v;
        }
        for (i, &tap) in taps.iter().enumerate().skip(1) {
            let above = &scratch[y.saturating_sub(i) * width..];
            let below = &scratch[(y + i).min(height - 1) * width..];
            for ((o, &a), &b) in out.iter_mut().zip(above).zip(below) {
                *o += tap * (a + b);
            }
        }
    }
}
