//! Where a ball is in a picture of its press, and how large.

use image::RgbImage;

/// Pixels between those that are looked at.
const STRIDE: usize = 2;
/// Width over which a fall of the difference is measured, in pixels: half of it on either side.
const HALF_EDGE: usize = 4;
/// Least radius in pixels.
const LEAST_PX: usize = 10;
/// Least fall of the difference, in levels summed over the channels: one level in each.
const LEAST_FALL: f64 = 3.0;

/// A ball in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Its middle, in whole numbers at the middles of pixels.
    pub center_px: [f64; 2],
    /// Radius of the circle at which the gel leaves it.
    pub outline_px: f64,
}

/// How much each pixel differs from the background, of every second row and column.
struct Change {
    width: usize,
    levels: Vec<f32>,
}

/// Finds the ball: the circle across which what the press changed falls most, on average along it.
/// The lights' sides do not matter for that, since the fall is at one radius all round.
///
/// `None` where no circle stands out.
pub fn find(picture: &RgbImage, background: &RgbImage) -> Option<Found> {
    let change = Change::of(picture, background);
    let mut center = change.middle()?;
    let (mut best, mut radius) = change.fall(center)?;
    // Downhill from the middle of what changed, by ever smaller steps.
    let mut step = 16.0;
    while step >= 0.5 {
        let mut moved = false;
        for [dx, dy] in [[step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]] {
            let tried = [center[0] + dx, center[1] + dy];
            if let Some((fall, at)) = change.fall(tried)
                && fall > best
            {
                (best, radius, center, moved) = (fall, at, tried, true);
            }
        }
        if !moved {
            step /= 2.0;
        }
    }
    (best >= LEAST_FALL).then_some(Found { center_px: center, outline_px: radius })
}

impl Change {
    fn of(picture: &RgbImage, background: &RgbImage) -> Self {
        let width = (picture.width() as usize).div_ceil(STRIDE);
        let rows = (0..picture.height()).step_by(STRIDE);
        let levels = rows.flat_map(|y| {
            (0..picture.width()).step_by(STRIDE).map(move |x| {
                let pairs = picture.get_pixel(x, y).0.into_iter().zip(background.get_pixel(x, y).0);
                pairs.map(|(a, b)| f32::from(a.abs_diff(b))).sum::<f32>()
            })
        });
        Self { width, levels: levels.collect() }
    }

    /// Middle of what changed most, in pixels of the picture.
    fn middle(&self) -> Option<[f64; 2]> {
        let mut sorted = self.levels.clone();
        sorted.sort_by(f32::total_cmp);
        let (usual, most) = (*sorted.get(sorted.len() / 2)?, sorted[sorted.len() * 999 / 1000]);
        let least = usual + 0.3 * (most - usual);
        let mut sum = [0.0; 3];
        for (i, level) in self.levels.iter().enumerate() {
            let weight = f64::from((level - least).max(0.0));
            let place = [i % self.width, i / self.width].map(|at| (at * STRIDE) as f64);
            sum = [sum[0] + weight, sum[1] + weight * place[0], sum[2] + weight * place[1]];
        }
        (sum[0] > 0.0).then(|| [sum[1] / sum[0], sum[2] / sum[0]])
    }

    /// The greatest fall of the mean change from one ring about a place to the next, and its radius.
    fn fall(&self, [x, y]: [f64; 2]) -> Option<(f64, f64)> {
        let rows = self.levels.len() / self.width;
        let reach = (self.width.min(rows) * STRIDE) / 2;
        let mut rings = vec![(0.0, 0u32); reach];
        for (row, levels) in self.levels.chunks_exact(self.width).enumerate() {
            let dy = (row * STRIDE) as f64 - y;
            for (column, level) in levels.iter().enumerate() {
                let dx = (column * STRIDE) as f64 - x;
                let radius = dx.hypot(dy) as usize;
                if let Some((sum, count)) = rings.get_mut(radius) {
                    (*sum, *count) = (*sum + f64::from(*level), *count + 1);
                }
            }
        }
        let means: Vec<f64> = rings.iter().map(|(sum, n)| sum / f64::from((*n).max(1))).collect();
        let mean =
            |from: usize| means[from..from + HALF_EDGE].iter().sum::<f64>() / HALF_EDGE as f64;
        let last = reach.checked_sub(2 * HALF_EDGE)?;
        let falls = (LEAST_PX..=last).map(|r| (mean(r) - mean(r + HALF_EDGE), r + HALF_EDGE));
        let (fall, radius) = falls.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((fall, radius as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// A dent that is lit from one side: half of it brighter, half darker, and a faint slope around.
    fn dented(center: [f64; 2], radius: f64) -> RgbImage {
        RgbImage::from_fn(320, 240, |x, y| {
            let (dx, dy) = (f64::from(x) - center[0], f64::from(y) - center[1]);
            let r = dx.hypot(dy);
            let slope = if r < radius { r / radius } else { 0.3 * (radius / r).powi(2) };
            let level = 120.0 + 60.0 * slope * dx / r.max(1e-9);
            Rgb([level.round() as u8, 120, 120])
        })
    }

    #[test]
    fn a_ball_is_found_wherever_the_light_comes_from() {
        let flat = RgbImage::from_pixel(320, 240, Rgb([120; 3]));
        for (center, radius) in
            [([160.0, 120.0], 40.0), ([90.0, 150.0], 30.0), ([230.0, 70.0], 52.0)]
        {
            let found = find(&dented(center, radius), &flat).expect("a ball");
            let [x, y] = found.center_px;
            // Rings are a pixel wide, every second pixel is looked at.
            assert!((x - center[0]).abs() <= 2.0 && (y - center[1]).abs() <= 2.0, "{found:?}");
            assert!((found.outline_px - radius).abs() <= 2.0, "{radius}: {found:?}");
        }
    }

    #[test]
    fn where_nothing_is_nothing_is_found() {
        let flat = RgbImage::from_pixel(64, 48, Rgb([120; 3]));
        assert_eq!(find(&flat, &flat), None);
        let brighter = RgbImage::from_pixel(64, 48, Rgb([140; 3]));
        assert_eq!(find(&brighter, &flat), None);
        let pixel = RgbImage::from_pixel(1, 1, Rgb([120; 3]));
        assert_eq!(find(&RgbImage::from_pixel(1, 1, Rgb([9; 3])), &pixel), None);
    }
}
