//! How pixels lie in memory, and their colours.

/// How pixels lie in memory, 8 bits a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum PixelFormat {
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red, as OpenCV has it.
    Bgr8,
    /// Red, green, blue, and alpha, which is ignored.
    Rgba8,
    /// Blue, green, red, and alpha, which is ignored.
    Bgra8,
    /// Grey, taken as all three colours.
    Gray8,
    /// One colour a pixel, as the sensor behind a Bayer filter has it. The first two letters are the
    /// first two pixels of the frame's first row, the others those of its second row. A pixel's other
    /// colours are interpolated bilinearly: the mean of the nearest samples of that colour, which lie
    /// beside or diagonally to it; at the frame's edge, of those that there are.
    BayerRggb8,
    /// As [`PixelFormat::BayerRggb8`], in another order.
    BayerBggr8,
    /// As [`PixelFormat::BayerRggb8`], in another order.
    BayerGrbg8,
    /// As [`PixelFormat::BayerRggb8`], in another order.
    BayerGbrg8,
}

impl PixelFormat {
    /// Those whose pixels stand for themselves, in the order of their numbers in `CropResize`'s crop.
    pub(crate) const OWN_COLOURS: [Self; 5] =
        [Self::Rgb8, Self::Bgr8, Self::Rgba8, Self::Bgra8, Self::Gray8];

    /// Bytes of a pixel.
    pub fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Rgb8 | Self::Bgr8 => 3,
            Self::Rgba8 | Self::Bgra8 => 4,
            _ => 1,
        }
    }

    /// Column and row, 0 or 1, of the first red pixel of a Bayer pattern; blue is diagonally to it.
    fn red(self) -> Option<[usize; 2]> {
        match self {
            Self::BayerRggb8 => Some([0, 0]),
            Self::BayerBggr8 => Some([1, 1]),
            Self::BayerGrbg8 => Some([1, 0]),
            Self::BayerGbrg8 => Some([0, 1]),
            _ => None,
        }
    }

    /// Whether a pixel's colours are also its neighbours'.
    pub(crate) fn is_mosaic(self) -> bool {
        self.red().is_some()
    }

    /// Red, green and blue of a row of pixels that stand for themselves: its bytes, or as many pixels of
    /// `converted`.
    #[inline]
    pub(crate) fn rgb<'a>(self, row: &'a [u8], converted: &'a mut [[u8; 3]]) -> &'a [u8] {
        match self {
            Self::Rgb8 => return row,
            Self::Bgr8 => {
                for (out, &[b, g, r]) in converted.iter_mut().zip(row.as_chunks().0) {
                    *out = [r, g, b];
                }
            }
            Self::Rgba8 => {
                for (out, &[r, g, b, _]) in converted.iter_mut().zip(row.as_chunks().0) {
                    *out = [r, g, b];
                }
            }
            Self::Bgra8 => {
                for (out, &[b, g, r, _]) in converted.iter_mut().zip(row.as_chunks().0) {
                    *out = [r, g, b];
                }
            }
            Self::Gray8
            | Self::BayerRggb8
            | Self::BayerBggr8
            | Self::BayerGrbg8
            | Self::BayerGbrg8 => {
                for (out, &v) in converted.iter_mut().zip(row) {
                    *out = [v; 3];
                }
            }
        }
        converted.as_flattened()
    }

    /// The colours of a pixel behind a Bayer filter, in a frame of this width and height whose rows begin
    /// `stride` bytes apart.
    pub(crate) fn interpolated(
        self,
        bytes: &[u8],
        stride: usize,
        size: [usize; 2],
        at: [usize; 2],
    ) -> [u8; 3] {
        let red = self.red().unwrap_or_default();
        // 0 red, 1 green, 2 blue: one for each axis in which it is not red's.
        let colour = |[x, y]: [usize; 2]| (x + red[0]) % 2 + (y + red[1]) % 2;
        let sample = |[x, y]: [usize; 2]| u32::from(bytes[y * stride + x]);
        let (mut sums, mut counts) = ([0u32; 3], [0u32; 3]);
        for y in at[1].saturating_sub(1)..(at[1] + 2).min(size[1]) {
            for x in at[0].saturating_sub(1)..(at[0] + 2).min(size[0]) {
                sums[colour([x, y])] += sample([x, y]);
                counts[colour([x, y])] += 1;
            }
        }
        (sums[colour(at)], counts[colour(at)]) = (sample(at), 1);
        // A frame of a single row or column lacks a colour.
        let mean = |c: usize| (sums[c] + counts[c] / 2).checked_div(counts[c]).unwrap_or(0);
        [0, 1, 2].map(|c| mean(c) as u8)
    }
}
