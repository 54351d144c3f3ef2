//! Cropping, resizing and normalising a picture.

use rayon::prelude::*;

use crate::tensor::Tensor;

/// A square part of a picture. All in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Width of the whole picture.
    pub width: usize,
    /// Height of the whole picture.
    pub height: usize,
    /// Column of the crop's left edge.
    pub x: usize,
    /// Row of the crop's upper edge.
    pub y: usize,
    /// Length of the crop's edges.
    pub side: usize,
}

impl Crop {
    /// The largest square in the middle of a picture; up and left by half a pixel where the middle
    /// is between two.
    pub fn central(width: usize, height: usize) -> Self {
        let side = width.min(height);
        Self { width, height, x: (width - side) / 2, y: (height - side) / 2, side }
    }
}

/// `(pixel / 255 − mean) / std` of the crop, resized to `[3, size, size]`.
///
/// `picture` holds red in the low byte, then green, blue and alpha, which is ignored. The filter is
/// bilinear with antialiasing: a triangle around the output's centre that reaches max(scale, 1)
/// source pixels, normalised over the pixels inside the crop. So do Pillow's `BILINEAR` and
/// PyTorch's `interpolate(mode="bilinear", antialias=True, align_corners=False)`.
pub fn crop_resize(
    picture: &Tensor<u32>,
    crop: Crop,
    size: usize,
    mean: [f32; 3],
    std: [f32; 3],
) -> Tensor {
    let filters: Vec<_> = (0..size).map(|i| triangle_filter(i, size, crop.side)).collect();
    let mut rows = vec![[0.0; 3]; size * size];
    rows.par_chunks_mut(size.max(1)).zip(&filters).for_each(|(out, (first, weights))| {
        let mut line = vec![[0.0; 3]; crop.side];
        for (j, weight) in weights.iter().enumerate() {
            let start = (crop.y + first + j) * crop.width + crop.x;
            for (sum, pixel) in line.iter_mut().zip(&picture.data()[start..][..crop.side]) {
                let bytes = pixel.to_le_bytes();
                for c in 0..3 {
                    sum[c] += weight * f64::from(bytes[c]) / 255.0;
                }
            }
        }
        for (out, (first, weights)) in out.iter_mut().zip(&filters) {
            for (weight, pixel) in weights.iter().zip(&line[*first..]) {
                for c in 0..3 {
                    out[c] += weight * pixel[c];
                }
            }
        }
    });
    let area = size * size;
    Tensor::from_fn([3, size, size], |i| {
        let c = i / area;
        ((rows[i % area][c] - f64::from(mean[c])) / f64::from(std[c])) as f32
    })
}

/// The first pixel that output `i` of `size` sees in `side` pixels, and the weight of each from it.
pub fn triangle_filter(i: usize, size: usize, side: usize) -> (usize, Vec<f64>) {
    let scale = side as f64 / size as f64;
    let support = scale.max(1.0);
    let centre = (i as f64 + 0.5) * scale;
    let first = (centre - support - 0.5).floor().max(0.0) as usize;
    let end = ((centre + support + 0.5).ceil() as usize).min(side);
    let weight = |j| (1.0 - (j as f64 + 0.5 - centre).abs() / support).max(0.0);
    let total: f64 = (first..end).map(weight).sum();
    (first, (first..end).map(|j| weight(j) / total).collect())
}
