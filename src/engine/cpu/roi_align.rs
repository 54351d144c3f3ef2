//! RoIAlign on a channels-last map: a sample is four pixels' channels.

use super::gemm::vectorised;
use super::kernel::{Data, Kernel};
use crate::engine::cores::each;
use crate::engine::reference::{RoiGrid, neighbours};
use crate::engine::shape::TensorSpec;

/// RoIAlign as [`crate::engine::ops::RoiAlign`] defines it.
#[derive(Debug)]
pub(super) struct Regions {
    grid: RoiGrid,
    channels: usize,
    height: usize,
    width: usize,
    rois: usize,
    count: bool,
}

/// Channels that are added up side by side.
const BLOCK: usize = 32;

/// The two pixels that a sample lies between on an axis, and its distance from the first; `None` outside the map.
type Between = Option<(usize, usize, f64)>;

impl Regions {
    pub fn new(grid: RoiGrid, features: &TensorSpec, rois: usize, count: bool) -> Self {
        let [channels, height, width] = [0, 1, 2].map(|i| features.shape.0[i]);
        Self { grid, channels, height, width, rois, count }
    }
}

impl Kernel for Regions {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let (features, boxes) = (inputs[0].f32()?, inputs[1].f32()?);
        let rois = match self.count {
            true => self.rois.min(inputs[2].u32()?[0] as usize),
            false => self.rois,
        };
        let RoiGrid { size, ratio, .. } = self.grid;
        let (bin, share) = (self.channels, 1.0 / (ratio * ratio) as f32);
        let roi = size * size * bin;
        each(outputs[0][..rois * roi].chunks_mut(roi).zip(boxes.chunks(4)), |(out, b)| {
            // All samples of a row of bins have one of these heights, those of a column one of these places.
            let along = |low: f32, high: f32, extent: usize| -> Vec<Between> {
                let sample = |i: usize| self.grid.sample(low, high, i / ratio, i % ratio);
                (0..size * ratio).map(|i| neighbours(sample(i), extent)).collect()
            };
            let (ys, xs) = (along(b[1], b[3], self.height), along(b[0], b[2], self.width));
            let mut pixels = Vec::with_capacity(4 * ratio * ratio);
            vectorised(
                #[inline(always)]
                || {
                    for (i, out) in out.chunks_exact_mut(bin).enumerate() {
                        let ys = &ys[i / size * ratio..][..ratio];
                        let xs = &xs[i % size * ratio..][..ratio];
                        self.pixels(ys, xs, &mut pixels);
                        let (blocks, rest) = out.as_chunks_mut::<BLOCK>();
                        let after = blocks.len() * BLOCK;
                        for (i, out) in blocks.iter_mut().enumerate() {
                            // In registers.
                            let mut sums = [0.0; BLOCK];
                            weigh(&features[i * BLOCK..], &pixels, share, &mut sums);
                            *out = sums;
                        }
                        weigh(&features[after..], &pixels, share, rest);
                    }
                },
            );
        });
        Ok(())
    }
}

impl Regions {
    /// Where the pixels of a bin's samples are, and what each weighs.
    fn pixels(&self, ys: &[Between], xs: &[Between], pixels: &mut Vec<(usize, f32)>) {
        pixels.clear();
        let at = |y: usize, x: usize| (y * self.width + x) * self.channels;
        for (y0, y1, fy) in ys.iter().flatten() {
            for (x0, x1, fx) in xs.iter().flatten() {
                for (y, wy) in [(y0, 1.0 - fy), (y1, *fy)] {
                    for (x, wx) in [(x0, 1.0 - fx), (x1, *fx)] {
                        pixels.push((at(*y, *x), (wy * wx) as f32));
                    }
                }
            }
        }
    }
}

/// `out = share · Σ weight · features[pixel]`.
#[inline(always)]
fn weigh(features: &[f32], pixels: &[(usize, f32)], share: f32, out: &mut [f32]) {
    out.fill(0.0);
    let count = out.len();
    for (at, weight) in pixels {
        for (out, x) in out.iter_mut().zip(&features[*at..][..count]) {
            *out += weight * x;
        }
    }
    for out in out {
        *out *= share;
    }
}
