//! How a camera's pixels lie in memory, and their colours.

use std::str::FromStr;

use crate::engine::pixel_order::PixelOrder;
use crate::error::Error;

/// How a frame's pixels lie in memory. What does not stand for itself as red, green and blue is converted
/// on the CPU.
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
    /// Grey of 16 bits, the low byte first; 65 535 is white, so a camera's 10 or 12 bits belong into the
    /// upper ones. Rounded to 8 bits.
    Gray16,
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
    /// YUV 4:2:2, also called YUY2: of each two pixels of a row luma, blue difference, luma, red difference.
    /// BT.601 with luma from 16 to 235, as UVC cameras give; both pixels have the differences that they share.
    /// An even width.
    Yuyv,
    /// YUV 4:2:0: the luma of all rows, then for each two rows one of blue and red differences, a pair for each
    /// 2 × 2 pixels, as far apart as rows of luma are. Colours as in [`PixelFormat::Yuyv`]. An even width and
    /// height.
    Nv12,
    /// A JPEG file for each frame, as UVC cameras give motion JPEG, also without Huffman tables. It must
    /// have the frame's width and height; the stride does not matter. Needs the feature `picture`.
    #[cfg(feature = "picture")]
    Mjpeg,
}

/// The formats whose frames have a fixed number of bytes, by name.
const NAMES: [(&str, PixelFormat); 12] = [
    ("rgb8", PixelFormat::Rgb8),
    ("bgr8", PixelFormat::Bgr8),
    ("rgba8", PixelFormat::Rgba8),
    ("bgra8", PixelFormat::Bgra8),
    ("gray8", PixelFormat::Gray8),
    ("gray16", PixelFormat::Gray16),
    ("bayer-rggb8", PixelFormat::BayerRggb8),
    ("bayer-bggr8", PixelFormat::BayerBggr8),
    ("bayer-grbg8", PixelFormat::BayerGrbg8),
    ("bayer-gbrg8", PixelFormat::BayerGbrg8),
    ("yuyv", PixelFormat::Yuyv),
    ("nv12", PixelFormat::Nv12),
];

impl FromStr for PixelFormat {
    type Err = Error;

    /// A format by its name in small letters, `bayer-rggb8` for one; not motion JPEG, whose frames differ in
    /// length.
    fn from_str(name: &str) -> Result<Self, Error> {
        let found = NAMES.iter().find(|(known, _)| *known == name);
        found.map(|(_, format)| *format).ok_or_else(|| {
            let known = NAMES.map(|(known, _)| format!("`{known}`")).join(", ");
            Error::param("frame", "format", format!("one of {known}"), format!("`{name}`"))
        })
    }
}

impl PixelFormat {
    /// Rows of bytes of a frame with so many rows of pixels: colour differences may lie below.
    pub(crate) fn rows(self, height: u32) -> u64 {
        match self {
            Self::Nv12 => u64::from(height) + u64::from(height / 2),
            _ => u64::from(height),
        }
    }

    /// Bytes of a frame whose rows follow one another without a gap; 0 for motion JPEG, whose frames differ.
    pub fn frame_bytes(self, width: u32, height: u32) -> u64 {
        u64::from(width)
            .saturating_mul(self.bytes_per_pixel() as u64)
            .saturating_mul(self.rows(height))
    }

    /// Bytes of a pixel in a row; of NV12 in a row of luma, and 0 where there are no rows.
    pub fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Rgb8 | Self::Bgr8 | Self::Rgba8 | Self::Bgra8 | Self::Gray8 => {
                self.order().map_or(0, PixelOrder::bytes)
            }
            Self::Gray16 | Self::Yuyv => 2,
            Self::Nv12
            | Self::BayerRggb8
            | Self::BayerBggr8
            | Self::BayerGrbg8
            | Self::BayerGbrg8 => 1,
            #[cfg(feature = "picture")]
            Self::Mjpeg => 0,
        }
    }

    /// How a shader reads pixels that stand for themselves.
    pub(crate) fn order(self) -> Option<PixelOrder> {
        match self {
            Self::Rgb8 => Some(PixelOrder::Rgb8),
            Self::Bgr8 => Some(PixelOrder::Bgr8),
            Self::Rgba8 => Some(PixelOrder::Rgba8),
            Self::Bgra8 => Some(PixelOrder::Bgra8),
            Self::Gray8 => Some(PixelOrder::Gray8),
            _ => None,
        }
    }

    /// Columns and rows that belong together: a frame has a multiple of each.
    pub fn block(self) -> [u32; 2] {
        match self {
            Self::Yuyv => [2, 1],
            Self::Nv12 => [2, 2],
            _ => [1, 1],
        }
    }

    /// Red, green and blue of a pixel that does not stand for itself, in a checked frame of this width and
    /// height whose rows begin `stride` bytes apart.
    pub(crate) fn converted(
        self,
        bytes: &[u8],
        stride: usize,
        size: [usize; 2],
        [x, y]: [usize; 2],
    ) -> [u8; 3] {
        let row = |y: usize| &bytes[y * stride..];
        let bayer = |red| interpolated(red, bytes, stride, size, [x, y]);
        match self {
            Self::Gray16 => {
                let value = u16::from_le_bytes([row(y)[2 * x], row(y)[2 * x + 1]]);
                [((u32::from(value) + 128) / 257) as u8; 3]
            }
            Self::Yuyv => {
                let pair = &row(y)[x / 2 * 4..];
                bt601(pair[x % 2 * 2], pair[1], pair[3])
            }
            Self::Nv12 => {
                let differences = &row(size[1] + y / 2)[x / 2 * 2..];
                bt601(row(y)[x], differences[0], differences[1])
            }
            Self::BayerRggb8 => bayer([0, 0]),
            Self::BayerBggr8 => bayer([1, 1]),
            Self::BayerGrbg8 => bayer([1, 0]),
            Self::BayerGbrg8 => bayer([0, 1]),
            // Shaders read these by their order.
            Self::Rgb8 | Self::Bgr8 | Self::Rgba8 | Self::Bgra8 | Self::Gray8 => [0; 3],
            #[cfg(feature = "picture")]
            Self::Mjpeg => [0; 3],
        }
    }
}

/// The colours of a pixel behind a Bayer filter whose first red pixel is at the column and row `red`, 0 or 1;
/// blue is diagonally to it.
fn interpolated(
    red: [usize; 2],
    bytes: &[u8],
    stride: usize,
    size: [usize; 2],
    at: [usize; 2],
) -> [u8; 3] {
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

/// Red, green and blue of BT.601's luma, 16 to 235, and colour differences, 16 to 240, rounded.
fn bt601(luma: u8, blue: u8, red: u8) -> [u8; 3] {
    let [luma, blue, red] =
        [(luma, 16.0), (blue, 128.0), (red, 128.0)].map(|(v, zero)| f32::from(v) - zero);
    // Luma is 0.299 R + 0.587 G + 0.114 B; the differences are scaled by 1/2 of 1 − 0.114 and 1 − 0.299.
    let (luma, blue, red) = (luma / 219.0, blue / 112.0 * 0.886, red / 112.0 * 0.701);
    let green = luma - (0.114 * blue + 0.299 * red) / 0.587;
    [luma + red, green, luma + blue].map(|share| (share * 255.0 + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Black, white, 100 % red, green and blue as ITU-R BT.601 codes them in 8 bits.
    #[test]
    fn colours_of_bt_601() {
        let within = |got: [u8; 3], want: [u8; 3]| {
            assert!(got.iter().zip(want).all(|(g, w)| g.abs_diff(w) <= 1), "{got:?}, {want:?}");
        };
        assert_eq!(bt601(16, 128, 128), [0; 3]);
        assert_eq!(bt601(235, 128, 128), [255; 3]);
        within(bt601(81, 90, 240), [255, 0, 0]);
        within(bt601(145, 54, 34), [0, 255, 0]);
        within(bt601(41, 240, 110), [0, 0, 255]);
        // Outside the range it saturates.
        assert_eq!((bt601(0, 128, 128), bt601(255, 128, 128)), ([0; 3], [255; 3]));
    }

    #[test]
    fn formats_have_names_and_lengths() {
        let bytes = |name: &str| {
            name.parse::<PixelFormat>().map(|f| f.frame_bytes(6, 4)).map_err(|e| e.to_string())
        };
        for (name, want) in
            [("rgb8", 72), ("bgra8", 96), ("bayer-gbrg8", 24), ("yuyv", 48), ("nv12", 36)]
        {
            assert_eq!(bytes(name), Ok(want), "{name}");
        }
        let told = bytes("mjpeg").expect_err("no fixed length");
        assert!(
            told.contains("expected one of `rgb8`, `bgr8`,") && told.ends_with("got `mjpeg`"),
            "{told}"
        );
        assert_eq!(PixelFormat::Nv12.frame_bytes(u32::MAX, u32::MAX), u64::MAX);
    }

    #[test]
    fn sixteen_bits_are_rounded_to_eight() {
        let grey =
            |value: u16| PixelFormat::Gray16.converted(&value.to_le_bytes(), 2, [1, 1], [0, 0])[0];
        assert_eq!([0, 128, 129, 257, 32768, 65535].map(grey), [0, 0, 1, 1, 128, 255]);
    }

    /// Four pixels of which each pair, and each square, shares its colour.
    #[test]
    fn neighbours_share_their_colour() {
        // Red and blue pairs, the second row 8 bytes after the first, of which the last two are padding.
        let yuyv = [81, 90, 81, 240, 0, 0, 0, 0, 41, 240, 235, 110];
        let at = |x, y| PixelFormat::Yuyv.converted(&yuyv, 8, [2, 2], [x, y]);
        assert_eq!((at(0, 0), at(1, 0)), (bt601(81, 90, 240), bt601(81, 90, 240)));
        assert_eq!((at(0, 1), at(1, 1)), (bt601(41, 240, 110), bt601(235, 240, 110)));
        // Luma of two rows of four with one byte of padding, then two pairs of differences.
        let nv12 = [10, 20, 30, 40, 0, 50, 60, 70, 80, 0, 90, 240, 54, 34];
        let at = |x, y| PixelFormat::Nv12.converted(&nv12, 5, [4, 2], [x, y]);
        assert_eq!((at(1, 0), at(0, 1)), (bt601(20, 90, 240), bt601(50, 90, 240)));
        assert_eq!((at(2, 0), at(3, 1)), (bt601(30, 54, 34), bt601(80, 54, 34)));
    }
}
