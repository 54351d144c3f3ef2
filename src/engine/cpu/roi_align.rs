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
            for (i, out) in out.chunks_exact_mut(bin).enumerate() {
                let (ys, xs) = (&ys[i / size * ratio..][..ratio], &xs[i % size * ratio..][..ratio]);
                let pairs =
                    ys.iter().flatten().flat_map(|y| xs.iter().flatten().map(move |x| (y, x)));
                let at = |y: usize, x: usize| (y * self.width + x) * self.channels;
                let weight = |y: f64, x: f64| (y * x) as f32;
                let samples = pairs.map(|((y0, y1, fy), (x0, x1, fx))| {
                    [
                        (at(*y0, *x0), weight(1.0 - fy, 1.0 - fx)),
                        (at(*y0, *x1), weight(1.0 - fy, *fx)),
                        (at(*y1, *x0), weight(*fy, 1.0 - fx)),
                        (at(*y1, *x1), weight(*fy, *fx)),
                    ]
                });
                vectorised(
                    #[inline(always)]
                    || {
                        out.fill(0.0);
                        for sample in samples {
                            let [(a, wa), (b, wb), (c, wc), (d, wd)] = sample;
                            let pixel = |at: usize| &features[at..at + bin];
                            let (a, b, c, d) = (pixel(a), pixel(b), pixel(c), pixel(d));
                            for (k, out) in out.iter_mut().enumerate() {
                                *out += wa * a[k] + wb * b[k] + (wc * c[k] + wd * d[k]);
                            }
                        }
                        for out in out.iter_mut() {
                            *out *= share;
                        }
                    },
                );
            }
        });
        Ok(())
    }
}
