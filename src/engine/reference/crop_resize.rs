//! Cropping, resizing and normalising a picture.

use std::ops::Range;

use crate::engine::cores::each;
use crate::engine::pixel_order::PixelOrder;
use crate::engine::tensor::Tensor;

/// A part of a picture, what it is resized to, and which window of that is wanted. All in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Width of the whole picture.
    pub width: usize,
    /// Height of the whole picture.
    pub height: usize,
    /// Column of the part's left edge.
    pub x: usize,
    /// Row of the part's upper edge.
    pub y: usize,
    /// Columns of the part.
    pub columns: usize,
    /// Rows of the part.
    pub rows: usize,
    /// Width and height that the part is resized to, each by its own scale.
    pub resized: [usize; 2],
    /// Column and row of the resized part at which the output begins. Past its right and lower edge
    /// the output repeats them.
    pub window: [usize; 2],
    /// Which of a pixel's bytes are which colour.
    pub order: PixelOrder,
}

impl Crop {
    /// The largest square in the middle of a picture in RGBA, resized to `size` × `size`; up and left by half a
    /// pixel where the middle is between two.
    pub fn central(width: usize, height: usize, size: usize) -> Self {
        let side = width.min(height);
        let (x, y) = ((width - side) / 2, (height - side) / 2);
        Self {
            width,
            height,
            x,
            y,
            columns: side,
            rows: side,
            resized: [size; 2],
            window: [0; 2],
            order: PixelOrder::Rgba8,
        }
    }

    /// Red, green and blue of the pixels `columns` of the part's row `row`: those of `bytes`, the picture's, or
    /// as many pixels of `converted`.
    #[inline]
    pub(crate) fn rgb<'a>(
        &self,
        bytes: &'a [u8],
        columns: Range<usize>,
        row: usize,
        converted: &'a mut [[u8; 3]],
    ) -> &'a [u8] {
        let each = self.order.bytes();
        let first = (self.y + row) * self.width + self.x + columns.start;
        self.order.rgb(&bytes[first * each..][..columns.len() * each], converted)
    }

    /// What output column and row `0..count` along `axis` (0 is x) see of the part.
    pub(crate) fn filters(&self, axis: usize, count: usize) -> Vec<(usize, Vec<f64>)> {
        let (size, side) = (self.resized[axis], [self.columns, self.rows][axis]);
        let at = |i: usize| (i + self.window[axis]).min(size.saturating_sub(1));
        (0..count).map(|i| triangle_filter(at(i), size, side)).collect()
    }
}

/// `(pixel / 255 − mean) / std` of the crop, resized: a window `[3, height, width]`.
///
/// `picture` holds the bytes of its pixels row by row, four a word, the first in the low byte. The filter is
/// bilinear with antialiasing: a triangle around the output's centre that reaches max(scale, 1)
/// source pixels, normalised over the pixels inside the crop. So do Pillow's `BILINEAR` and
/// PyTorch's `interpolate(mode="bilinear", antialias=True, align_corners=False)`.
pub fn crop_resize(
    picture: &Tensor<u32>,
    crop: Crop,
    [height, width]: [usize; 2],
    mean: [f32; 3],
    std: [f32; 3],
) -> Tensor {
    let [columns, lines] = [crop.filters(0, width), crop.filters(1, height)];
    let bytes: &[u8] = bytemuck::cast_slice(picture.data());
    let mut rows = vec![[0.0; 3]; height * width];
    each(rows.chunks_mut(width.max(1)).zip(&lines), |(out, (first, weights))| {
        let mut line = vec![[0.0; 3]; crop.columns];
        let mut converted = vec![[0; 3]; crop.columns];
        for (j, weight) in weights.iter().enumerate() {
            let row = crop.rgb(bytes, 0..crop.columns, first + j, &mut converted);
            for (sum, pixel) in line.iter_mut().zip(row.as_chunks::<3>().0) {
                for c in 0..3 {
                    sum[c] += weight * f64::from(pixel[c]) / 255.0;
                }
            }
        }
        for (out, (first, weights)) in out.iter_mut().zip(&columns) {
            for (weight, pixel) in weights.iter().zip(&line[*first..]) {
                for c in 0..3 {
                    out[c] += weight * pixel[c];
                }
            }
        }
    });
    let area = height * width;
    Tensor::from_fn([3, height, width], |i| {
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
