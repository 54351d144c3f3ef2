//! Which bytes of a pixel are which colour, as far as shaders read them.

/// The order of a pixel's samples, of 8 bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelOrder {
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Red, green, blue, and alpha, which is ignored.
    Rgba8,
    /// Blue, green, red, and alpha, which is ignored.
    Bgra8,
    /// Grey, taken as all three colours.
    Gray8,
}

impl PixelOrder {
    /// All, in the order of their numbers in the crop of [`CropResize`](crate::engine::ops::CropResize).
    pub const ALL: [Self; 5] = [Self::Rgb8, Self::Bgr8, Self::Rgba8, Self::Bgra8, Self::Gray8];

    /// Bytes of a pixel.
    pub fn bytes(self) -> usize {
        match self {
            Self::Rgb8 | Self::Bgr8 => 3,
            Self::Rgba8 | Self::Bgra8 => 4,
            Self::Gray8 => 1,
        }
    }

    /// Red, green and blue of a row of pixels: its bytes, or as many pixels of `converted`.
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
            Self::Gray8 => {
                for (out, &v) in converted.iter_mut().zip(row) {
                    *out = [v; 3];
                }
            }
        }
        converted.as_flattened()
    }
}
