//! RoIAlign (He et al., Mask R-CNN, §3), in torchvision's version with `aligned = true`.

use crate::engine::cores::each;
use crate::engine::tensor::Tensor;

/// How [`roi_align`] samples.
#[derive(Clone, Copy, Debug)]
pub struct RoiGrid {
    /// Features a pixel of the boxes' picture.
    pub scale: f64,
    /// Bins on each side of a box.
    pub size: usize,
    /// Samples on each side of a bin.
    pub ratio: usize,
}

impl RoiGrid {
    /// Coordinate of a sample on the axis where the box goes from `low` to `high`.
    pub fn sample(&self, low: f32, high: f32, bin: usize, sample: usize) -> f64 {
        let start = f64::from(low) * self.scale - 0.5;
        let bin_size = (f64::from(high) * self.scale - 0.5 - start) / self.size as f64;
        start + bin as f64 * bin_size + (sample as f64 + 0.5) * bin_size / self.ratio as f64
    }
}

/// Indices of the neighbours of `at` on an axis of `length` features and the weight of the upper
/// one; `None` outside `[-1, length]`, where there is nothing to sample.
pub fn neighbours(at: f64, length: usize) -> Option<(usize, usize, f64)> {
    if !(-1.0..=length as f64).contains(&at) {
        return None;
    }
    let clamped = at.clamp(0.0, (length - 1) as f64);
    let low = clamped as usize;
    Some((low, (low + 1).min(length - 1), clamped - low as f64))
}

/// Averages of `features [C, H, W]` in the bins of each box: `[R, C, size, size]`.
pub fn roi_align(features: &Tensor, boxes: &[[f32; 4]], grid: RoiGrid) -> Tensor {
    let [channels, height, width] = [0, 1, 2].map(|i| features.dims()[i]);
    let mut output = Tensor::zeros([boxes.len(), channels, grid.size, grid.size]);
    let roi_len = channels * grid.size * grid.size;
    each(output.data_mut().chunks_mut(roi_len).zip(boxes), |(out, b)| {
        for (i, out) in out.iter_mut().enumerate() {
            let plane = &features.data()[i / (grid.size * grid.size) * height * width..];
            let (bin_y, bin_x) = (i / grid.size % grid.size, i % grid.size);
            let feature = |y: usize, x: usize| f64::from(plane[y * width + x]);
            let mut sum = 0.0;
            for iy in 0..grid.ratio {
                for ix in 0..grid.ratio {
                    let y = neighbours(grid.sample(b[1], b[3], bin_y, iy), height);
                    let x = neighbours(grid.sample(b[0], b[2], bin_x, ix), width);
                    let (Some((y0, y1, fy)), Some((x0, x1, fx))) = (y, x) else { continue };
                    let row = |y| (1.0 - fx) * feature(y, x0) + fx * feature(y, x1);
                    sum += (1.0 - fy) * row(y0) + fy * row(y1);
                }
            }
            *out = (sum / (grid.ratio * grid.ratio) as f64) as f32;
        }
    });
    output
}
