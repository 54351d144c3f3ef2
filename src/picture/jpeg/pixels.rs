//! From blocks of coefficients to pixels.

use image::{DynamicImage, ImageBuffer};

use super::{Block, Colour};

/// The samples of a component.
pub(super) struct Plane {
    /// Samples of the picture, without what fills up the last blocks.
    pub width: usize,
    pub height: usize,
    /// Blocks in a row, of which the last ones may be beside the picture.
    pub columns: usize,
    /// How many pixels a sample covers.
    pub across: usize,
    pub down: usize,
    /// Row by row, `columns` × 8 in each.
    pub samples: Vec<u8>,
}

/// Where the coefficients that come in zigzag order stand in rows.
#[rustfmt::skip]
const ZIGZAG: [usize; 64] = [
     0,  1,  8, 16,  9,  2,  3, 10, 17, 24, 32, 25, 18, 11,  4,  5,
    12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13,  6,  7, 14, 21, 28,
    35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51,
    58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63,
];

/// `COSINES[n][k]` is cos((2n + 1) k π / 16) / 2, over √2 for k = 0: the upper half of the inverse
/// transform's matrix. The lower half has the odd ones negative.
const COSINES: [[f32; 8]; 4] = {
    // cos(i π / 16) / 2
    const C: [f32; 8] = [
        0.353_553_4,
        0.490_392_64,
        0.461_939_75,
        0.415_734_8,
        0.353_553_4,
        0.277_785_12,
        0.191_341_71,
        0.097_545_16,
    ];
    [
        [C[0], C[1], C[2], C[3], C[4], C[5], C[6], C[7]],
        [C[0], C[3], C[6], -C[7], -C[4], -C[1], -C[2], -C[5]],
        [C[0], C[5], -C[6], -C[1], -C[4], C[7], C[2], C[3]],
        [C[0], C[7], -C[2], -C[5], C[4], C[3], -C[6], -C[1]],
    ]
};

type Square = [[f32; 8]; 8];

/// The inverse transform along the columns; then rows and columns change places.
fn columns_turned(from: &Square) -> Square {
    let mut to = Square::default();
    for (n, cosines) in COSINES.iter().enumerate() {
        let mut even = [0.0; 8];
        let mut odd = [0.0; 8];
        for k in [0, 2, 4, 6] {
            for i in 0..8 {
                even[i] += cosines[k] * from[k][i];
                odd[i] += cosines[k + 1] * from[k + 1][i];
            }
        }
        for i in 0..8 {
            to[i][n] = even[i] + odd[i];
            to[i][7 - n] = even[i] - odd[i];
        }
    }
    to
}

impl Plane {
    /// Stores the samples of the block at column and row `at`, from its coefficients and their
    /// steps.
    pub fn store(&mut self, block: &Block, steps: &[u16; 64], [x, y]: [usize; 2]) {
        let mut square = Square::default();
        let sent = block.iter().zip(steps).zip(ZIGZAG).filter(|((c, _), _)| **c != 0);
        for ((coefficient, step), place) in sent {
            square[place / 8][place % 8] = f32::from(*coefficient) * f32::from(*step);
        }
        let square = match block[1..].iter().all(|c| *c == 0) {
            true => [[square[0][0] / 8.0; 8]; 8],
            false => columns_turned(&columns_turned(&square)),
        };
        let stride = self.columns * 8;
        let rows = self.samples[y * 8 * stride..].chunks_exact_mut(stride);
        for (row, values) in rows.zip(&square) {
            for (sample, value) in row[x * 8..x * 8 + 8].iter_mut().zip(values) {
                // Rounded; the conversion cuts off at 0 and 255.
                *sample = (value + 128.5) as u8;
            }
        }
    }

    fn row(&self, y: usize) -> &[u8] {
        &self.samples[y * self.columns * 8..][..self.width]
    }

    /// The samples of the picture's row `y`, one a pixel, into a row that may reach beyond.
    ///
    /// Halves are interpolated and coarser ones repeated, as libjpeg does: along each axis three
    /// parts of the sample and one of its neighbour.
    fn expand(&self, y: usize, to: &mut Vec<u8>) {
        let own = y / self.down;
        let row = self.row(own);
        to.clear();
        let is_wide = self.width > 2;
        match (self.across, self.down) {
            (1, 2) | (2, 2) if self.across == 1 || is_wide => {
                let is_upper = y.is_multiple_of(2);
                let other = if is_upper { own.saturating_sub(1) } else { own + 1 };
                let other = self.row(other.min(self.height - 1));
                let sum = |x: usize| 3 * u16::from(row[x]) + u16::from(other[x]);
                if self.across == 1 {
                    let half = if is_upper { 1 } else { 2 };
                    to.extend((0..self.width).map(|x| ((sum(x) + half) >> 2) as u8));
                } else {
                    self.expand_across(to, sum, 4, [8, 7]);
                }
            }
            (2, 1) if is_wide => self.expand_across(to, |x| u16::from(row[x]), 2, [1, 2]),
            (1, _) => to.extend(row),
            (across, _) => to.extend(row.iter().flat_map(|s| std::iter::repeat_n(*s, across))),
        }
    }

    /// Two pixels for each sample, which is over by `shift - 2` bits; `halves` are added before
    /// rounding down.
    fn expand_across(
        &self,
        to: &mut Vec<u8>,
        sample: impl Fn(usize) -> u16,
        shift: u32,
        halves: [u16; 2],
    ) {
        to.resize(2 * self.width, 0);
        let (mut before, mut own) = (sample(0), sample(0));
        for (x, pair) in to.as_chunks_mut::<2>().0.iter_mut().enumerate() {
            let next = sample((x + 1).min(self.width - 1));
            let sum = |other: u16, half: u16| ((3 * own + other + half) >> shift) as u8;
            *pair = [sum(before, halves[0]), sum(next, halves[1])];
            (before, own) = (own, next);
        }
    }
}

/// The picture of these components.
pub(super) fn picture(
    (width, height): (u16, u16),
    planes: Vec<Plane>,
    colour: Colour,
) -> Option<DynamicImage> {
    let channels = if colour == Colour::Grey { 1 } else { 3 };
    let (columns, rows) = (usize::from(width), usize::from(height));
    let mut samples = vec![0; columns * rows * channels];
    let mut lines = vec![Vec::new(); planes.len()];
    for (y, to) in samples.chunks_exact_mut(columns * channels).enumerate() {
        for (plane, line) in planes.iter().zip(&mut lines) {
            plane.expand(y, line);
        }
        match &lines[..] {
            [grey] => to.copy_from_slice(grey.get(..columns)?),
            [a, b, c, rest @ ..] => {
                let (pixels, []) = to.as_chunks_mut::<3>() else { return None };
                let values = pixels.iter_mut().zip(a).zip(b).zip(c);
                match colour {
                    Colour::YCbCr | Colour::Ycck => {
                        values.for_each(|(((pixel, a), b), c)| *pixel = rgb(*a, *b, *c));
                    }
                    _ => values.for_each(|(((pixel, a), b), c)| *pixel = [*a, *b, *c]),
                }
                for (pixel, black) in pixels.iter_mut().zip(rest.first().into_iter().flatten()) {
                    let light = |ink: u8| match colour {
                        Colour::Ycck => 255 - u32::from(ink),
                        _ => u32::from(ink),
                    };
                    *pixel = pixel.map(|ink| ((light(ink) * u32::from(*black) + 127) / 255) as u8);
                }
            }
            _ => return None,
        }
    }
    let (width, height) = (width.into(), height.into());
    match channels {
        1 => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLuma8),
        _ => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb8),
    }
}

/// ITU-R BT.601 of full range, in 1/65 536.
fn rgb(y: u8, cb: u8, cr: u8) -> [u8; 3] {
    let (y, cb, cr) = (i32::from(y) << 16, i32::from(cb) - 128, i32::from(cr) - 128);
    let red = y + 91_881 * cr;
    let green = y - 22_554 * cb - 46_802 * cr;
    let blue = y + 116_130 * cb;
    [red, green, blue].map(|v| ((v + 32_768) >> 16).clamp(0, 255) as u8)
}
