//! Crop, resize and normalisation of a picture: rows, then columns, four channels at a time.

use super::gemm::vectorised;
use super::kernel::{Data, Kernel};
use crate::engine::cores::each_with;
use crate::engine::ops::CropResize;
use crate::engine::reference::Crop;
use crate::engine::tensor::Tensor;

/// Numbers of a pixel.
const RGB: usize = 3;
/// Numbers that are added at a time: a pixel's and the next one's first, which is not looked at.
const LANES: usize = 4;

/// Crop and resize to `[H, W, 3]`.
#[derive(Debug)]
pub(super) struct Resize {
    pub op: CropResize,
}

impl Kernel for Resize {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let (bytes, words) = (inputs[0].bytes()?, inputs[1].u32()?);
        let words = Tensor::new([words.len()], words.to_vec())?;
        let crop = Crop::from_tensor(&words, bytes.len().div_ceil(4))?;
        let filters = |axis: usize, count: usize| -> Vec<(usize, Vec<f32>)> {
            let narrow = |w: Vec<f64>| w.into_iter().map(|w| w as f32).collect();
            crop.filters(axis, count).into_iter().map(|(first, w)| (first, narrow(w))).collect()
        };
        let [mut columns, rows] = [filters(0, self.op.width), filters(1, self.op.height)];
        // A window of the resized part needs these columns alone.
        let from = columns.iter().map(|(first, _)| *first).min().unwrap_or(0);
        let to = columns.iter().map(|(first, w)| first + w.len()).max().unwrap_or(from);
        columns.iter_mut().for_each(|(first, _)| *first -= from);
        // Levels are summed as differences from the mean's whole level, which are exact: what is
        // left of the mean is small, so little cancels.
        let shift = self.op.shift();
        let levels = shift.map(|(level, _)| f32::from(level)).repeat(to - from);
        let scale = self.op.std.map(|s| (1.0 / (255.0 * f64::from(s))) as f32);
        let rest: [f32; RGB] =
            std::array::from_fn(|c| (shift[c].1 / f64::from(self.op.std[c])) as f32);
        each_with(
            outputs[0].chunks_mut(self.op.width * RGB).zip(&rows),
            || (vec![0.0f32; (to - from) * RGB + 1], vec![[0; RGB]; to - from]),
            |(line, converted), (out, (first, weights))| {
                vectorised(
                    #[inline(always)]
                    || {
                        line.fill(0.0);
                        for (j, weight) in weights.iter().enumerate() {
                            let row = crop.rgb(bytes, from..to, first + j, converted);
                            // Flat, so that it fills vectors.
                            for ((sum, byte), level) in line.iter_mut().zip(row).zip(&levels) {
                                *sum += weight * (f32::from(*byte) - level);
                            }
                        }
                        for (out, (first, weights)) in out.chunks_exact_mut(RGB).zip(&columns) {
                            let mut sum = [0.0f32; LANES];
                            let pixels = line[first * RGB..].windows(LANES).step_by(RGB);
                            for (weight, pixel) in weights.iter().zip(pixels) {
                                for (sum, x) in sum.iter_mut().zip(pixel) {
                                    *sum += weight * x;
                                }
                            }
                            for c in 0..RGB {
                                out[c] = sum[c] * scale[c] - rest[c];
                            }
                        }
                    },
                );
            },
        );
        Ok(())
    }
}
