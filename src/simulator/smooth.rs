//! Smoothing on the contact's grid, and the relief that stands in for mechanics in some pictures.

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
    if sigma < 0.05 {
        return;
    }
    let n = cells;
    let radius = (3.0 * sigma).ceil() as usize;
    let mut taps: Vec<f32> =
        (0..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32).collect();
    let sum = taps[0] + 2.0 * taps[1..].iter().sum::<f32>();
    taps.iter_mut().for_each(|t| *t /= sum);
    let mut out = vec![0.0f32; n * n];
    let mut padded = vec![0.0f32; n + 2 * radius];
    for (row, out) in field.chunks_exact(n).zip(out.chunks_exact_mut(n)) {
        padded[..radius].fill(row[0]);
        padded[radius..radius + n].copy_from_slice(row);
        padded[radius + n..].fill(row[n - 1]);
        for (o, &v) in out.iter_mut().zip(&padded[radius..]) {
            *o = taps[0] * v;
        }
        for (i, &tap) in taps.iter().enumerate().skip(1) {
            for ((o, &a), &b) in
                out.iter_mut().zip(&padded[radius - i..]).zip(&padded[radius + i..])
            {
                *o += tap * (a + b);
            }
        }
    }
    for y in 0..n {
        let row = &mut field[y * n..(y + 1) * n];
        for (o, &v) in row.iter_mut().zip(&out[y * n..]) {
            *o = taps[0] * v;
        }
        for (i, &tap) in taps.iter().enumerate().skip(1) {
            let above = &out[y.saturating_sub(i) * n..];
            let below = &out[(y + i).min(n - 1) * n..];
            for ((o, &a), &b) in row.iter_mut().zip(above).zip(below) {
                *o += tap * (a + b);
            }
        }
    }
}
