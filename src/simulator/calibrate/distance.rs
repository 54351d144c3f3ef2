//! How far two pictures are apart.

use image::RgbImage;
use serde::{Deserialize, Serialize};

/// How far pictures are from real ones: means over the presses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distance {
    /// Mean absolute difference in 8-bit levels.
    pub l1: f64,
    /// Peak signal to noise ratio in decibels.
    pub psnr_db: f64,
    /// Structural similarity (Wang et al. 2004; 7×7 windows, mean over channels).
    pub ssim: f64,
}

/// Factor by which [`Report::comparison`](super::Report::comparison) magnifies differences about mid grey.
pub const DIFFERENCE_GAIN: i32 = 4;

/// Of two pictures of the same size.
pub(super) fn distance(a: &RgbImage, b: &RgbImage) -> Distance {
    let count = a.as_raw().len() as f64;
    let differences =
        || a.as_raw().iter().zip(b.as_raw()).map(|(&a, &b)| f64::from(a) - f64::from(b));
    let mse = differences().map(|d| d * d).sum::<f64>() / count;
    Distance {
        l1: differences().map(f64::abs).sum::<f64>() / count,
        psnr_db: 10.0 * (255.0 * 255.0 / mse.max(1e-12)).log10(),
        ssim: ssim(a, b),
    }
}

/// Structural similarity with uniform 7×7 windows and sample covariances, as scikit-image's
/// default, averaged over channels.
fn ssim(a: &RgbImage, b: &RgbImage) -> f64 {
    const WINDOW: usize = 7;
    let (width, height) = (a.width() as usize, a.height() as usize);
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let count = (WINDOW * WINDOW) as f64;
    let unbiased = count / (count - 1.0);
    let mut sum = 0.0;
    let mut windows = 0usize;
    for channel in 0..3 {
        // Running sums of a, b, a², b² and ab over the window's rows, a column each.
        let value = |picture: &RgbImage, x: usize, y: usize| {
            f64::from(picture.as_raw()[(y * width + x) * 3 + channel])
        };
        let products = |x: usize, y: usize| {
            let (p, q) = (value(a, x, y), value(b, x, y));
            [p, q, p * p, q * q, p * q]
        };
        for y in 0..(height + 1).saturating_sub(WINDOW) {
            let columns: Vec<[f64; 5]> = (0..width)
                .map(|x| {
                    let mut column = [0.0; 5];
                    for dy in 0..WINDOW {
                        for (sum, v) in column.iter_mut().zip(products(x, y + dy)) {
                            *sum += v;
                        }
                    }
                    column
                })
                .collect();
            for window in columns.windows(WINDOW) {
                let mut s = [0.0; 5];
                for column in window {
                    for (s, v) in s.iter_mut().zip(column) {
                        *s += v / count;
                    }
                }
                let [ma, mb, aa, bb, ab] = s;
                let (va, vb) = (unbiased * (aa - ma * ma), unbiased * (bb - mb * mb));
                let cov = unbiased * (ab - ma * mb);
                sum += (2.0 * ma * mb + c1) * (2.0 * cov + c2)
                    / ((ma * ma + mb * mb + c1) * (va + vb + c2));
                windows += 1;
            }
        }
    }
    sum / windows.max(1) as f64
}

/// Real, simulated, and the difference magnified about mid grey, with a gap between.
pub(super) fn side_by_side(real: &RgbImage, simulated: &RgbImage) -> RgbImage {
    const GAP: u32 = 6;
    let (w, h) = real.dimensions();
    let mut picture = RgbImage::from_pixel(3 * w + 2 * GAP, h, image::Rgb([255; 3]));
    for (x, y, &r) in real.enumerate_pixels() {
        let s = *simulated.get_pixel(x, y);
        let mut d = image::Rgb([0; 3]);
        for c in 0..3 {
            let difference = i32::from(s.0[c]) - i32::from(r.0[c]);
            d.0[c] = (128 + DIFFERENCE_GAIN * difference).clamp(0, 255) as u8;
        }
        picture.put_pixel(x, y, r);
        picture.put_pixel(w + GAP + x, y, s);
        picture.put_pixel(2 * (w + GAP) + x, y, d);
    }
    picture
}
