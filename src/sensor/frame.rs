//! Pictures in memory, as a camera or another program gives them.
//!
//! A [`Frame`] is bytes with a width, a height, the distance between rows and a [`PixelFormat`]. Which
//! part of it shows the gel and at which scale, the [`crate::Sensor`] says, or the frame itself
//! ([`Scale`]); nothing else is converted.

use std::borrow::Cow;
use std::fmt;

use crate::engine::pixel_order::PixelOrder;
use crate::engine::reference::Crop;
use crate::engine::shape::MAX_PIXELS;
use crate::engine::tensor::Tensor;
use crate::error::{Error, Result};
use crate::sensor::pixel_format::PixelFormat;
use crate::sensor::rect::Rect;
use crate::sensor::scale::{Gel, Scale};

/// A picture in memory.
///
/// ```
/// use smr_gpu::{Frame, PixelFormat, Rect};
///
/// // A camera's buffer whose rows are padded to 256 bytes.
/// let buffer = vec![0; 256 * 48];
/// let frame = Frame::new(&buffer, 64, 48, PixelFormat::Bgr8)
///     .stride(256)
///     .crop(Rect { x: 8, y: 0, width: 48, height: 48 });
/// assert_eq!((frame.width, frame.stride), (64, 256));
/// ```
#[derive(Clone, PartialEq)]
#[non_exhaustive]
pub struct Frame<'a> {
    /// The pixels' bytes, row by row from the top; the last row may end with its last pixel.
    pub data: Cow<'a, [u8]>,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the start of a row to that of the next.
    pub stride: usize,
    /// What the bytes mean.
    pub format: PixelFormat,
    /// The part that the network sees, as far as it is gel; `None` for all of the gel. Scale, boxes and
    /// positions are the whole frame's.
    pub crop: Option<Rect>,
    /// The part that shows the gel; `None` for what [`Config::gel`](crate::Config::gel) or the sensor says. Positions in
    /// millimetres are from its middle, boxes in pixels of the whole frame.
    pub gel: Option<Gel>,
    /// How many millimetres a pixel shows; `None` for what [`Config::mm_per_pixel`](crate::Config::mm_per_pixel) or the sensor says.
    pub scale: Option<Scale>,
}

impl<'a> Frame<'a> {
    /// A frame whose rows follow one another without a gap.
    pub fn new(
        data: impl Into<Cow<'a, [u8]>>,
        width: u32,
        height: u32,
        format: PixelFormat,
    ) -> Self {
        let stride = (width as usize).saturating_mul(format.bytes_per_pixel());
        let data = data.into();
        Self { data, width, height, stride, format, crop: None, gel: None, scale: None }
    }

    /// The same with rows that begin `bytes` apart.
    pub fn stride(mut self, bytes: usize) -> Self {
        self.stride = bytes;
        self
    }

    /// The same of which the network sees `part` alone.
    pub fn crop(mut self, part: Rect) -> Self {
        self.crop = Some(part);
        self
    }

    /// The same of which this part shows the gel.
    pub fn gel(mut self, part: Gel) -> Self {
        self.gel = Some(part);
        self
    }

    /// The same with a scale of its own.
    pub fn scale(mut self, scale: Scale) -> Self {
        self.scale = Some(scale);
        self
    }

    /// The same with bytes of its own.
    pub fn into_owned(self) -> Frame<'static> {
        Frame { data: Cow::Owned(self.data.into_owned()), ..self }
    }

    /// Checks that the frame is what it says.
    ///
    /// # Errors
    /// [`Error::Picture`] for an empty frame; [`Error::Param`] for a crop, a stride or a buffer that
    /// does not hold what it must.
    pub(crate) fn check(&self) -> Result<()> {
        let Self { width, height, .. } = *self;
        if width == 0 || height == 0 {
            let message = format!("expected at least 1 × 1 pixel, got {width} × {height}");
            return Err(Error::Picture { file: "picture".into(), message });
        }
        if let Some(part) = self.crop.filter(|part| !part.is_in(width, height)) {
            let expected = format!("a part of {width} × {height} pixels");
            return Err(Error::param("frame", "crop", expected, part));
        }
        let block = self.format.block();
        if !width.is_multiple_of(block[0]) || !height.is_multiple_of(block[1]) {
            let expected =
                format!("a multiple of {} × {} for {:?}", block[0], block[1], self.format);
            return Err(Error::param("frame", "size", expected, format!("{width} × {height}")));
        }
        let row = u64::from(width) * self.format.bytes_per_pixel() as u64;
        if row > 0 && (self.stride as u64) < row {
            let expected = format!("at least {row} bytes");
            return Err(Error::param("frame", "stride", expected, self.stride));
        }
        let rows = self.format.rows(height);
        let bytes = (self.stride as u64).saturating_mul(rows - 1).saturating_add(row);
        let bytes = if row == 0 { 1 } else { bytes };
        if (self.data.len() as u64) < bytes {
            let expected = format!("at least {bytes} bytes");
            return Err(Error::param("frame", "data", expected, self.data.len()));
        }
        Ok(())
    }

    /// The bytes of this checked frame in which `part` lies, and the crop that shows all of it in its own
    /// size; `None` where pixels do not follow one another as in a picture, or are more than [`MAX_PIXELS`].
    pub(crate) fn own_bytes(&self, part: Rect) -> Option<(&[u8], Crop)> {
        let order = self.format.order()?;
        let each = order.bytes();
        let [x, top, columns, rows] = [part.x, part.y, part.width, part.height].map(|n| n as usize);
        if !self.stride.is_multiple_of(each) {
            return None;
        }
        // Whole rows, which the last one need not be.
        let bytes = self.data.get(top * self.stride..)?.get(..self.stride.checked_mul(rows)?)?;
        if bytes.len() > 4 * MAX_PIXELS || columns * rows > MAX_PIXELS {
            return None;
        }
        let (width, resized) = (self.stride / each, [columns, rows]);
        let (height, y, window) = (rows, 0, [0; 2]);
        let crop = Crop { width, height, x, y, columns, rows, resized, window, order };
        Some((bytes, crop))
    }

    /// The bytes of a part of a checked frame, four a word, and the crop that shows all of it in its own
    /// size. What does not stand for itself becomes RGB here: what a shader does for it alone, it does for all on
    /// a software adapter.
    ///
    /// # Errors
    /// [`Error::Capacity`] for more than [`MAX_PIXELS`]; [`Error::Picture`] for a JPEG file that is damaged or
    /// has another size.
    pub(crate) fn bytes(&self, part: Rect) -> Result<(Tensor<u32>, Crop)> {
        let needed = u64::from(part.width) * u64::from(part.height);
        if needed > MAX_PIXELS as u64 {
            let what = format!("pixels of {} × {}", part.width, part.height);
            return Err(Error::Capacity { what, needed, available: MAX_PIXELS as u64 });
        }
        #[cfg(feature = "picture")]
        if self.format == PixelFormat::Mjpeg {
            return self.decoded()?.bytes(part);
        }
        let [left, top, width, height] =
            [part.x, part.y, part.width, part.height].map(|n| n as usize);
        let own = self.format.order();
        let order = own.unwrap_or(PixelOrder::Rgb8);
        let row = width * order.bytes();
        let mut words = vec![0u32; (row * height).div_ceil(4)];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
        for (y, to) in (top..top + height).zip(bytes.chunks_exact_mut(row)) {
            if own.is_none() {
                let size = [self.width, self.height].map(|n| n as usize);
                for (x, to) in (left..).zip(to.as_chunks_mut::<3>().0) {
                    *to = self.format.converted(&self.data, self.stride, size, [x, y]);
                }
            } else {
                let first = y * self.stride + left * order.bytes();
                to.copy_from_slice(&self.data[first..][..row]);
            }
        }
        let (columns, rows) = (width, height);
        let (resized, window) = ([columns, rows], [0; 2]);
        let crop = Crop { width, height, x: 0, y: 0, columns, rows, resized, window, order };
        Ok((Tensor::new([words.len()], words)?, crop))
    }
}

#[cfg(feature = "picture")]
impl Frame<'_> {
    /// The frame in RGB whose data is a JPEG file.
    ///
    /// # Errors
    /// [`Error::Picture`] for a damaged file, and one of another width or height.
    fn decoded(&self) -> Result<Frame<'static>> {
        let fail = |message: String| Error::Picture { file: "picture".into(), message };
        let picture = crate::picture::decode(&self.data).map_err(|e| fail(e.to_string()))?;
        let (width, height) = (picture.width(), picture.height());
        if (width, height) != (self.width, self.height) {
            let Self { width: wide, height: high, .. } = self;
            return Err(fail(format!("expected {wide} × {high} pixels, got {width} × {height}")));
        }
        Ok(Frame::new(picture.into_rgb8().into_raw(), width, height, PixelFormat::Rgb8))
    }
}

impl fmt::Debug for Frame<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { data, width, height, stride, format, crop, gel, scale } = self;
        write!(f, "Frame({width} × {height} {format:?}, {} bytes, stride {stride}", data.len())?;
        if let Some(part) = crop {
            write!(f, ", crop {part}")?;
        }
        match gel {
            None => {}
            Some(Gel::All) => f.write_str(", all gel")?,
            Some(Gel::Part(part)) => write!(f, ", gel {part}")?,
        }
        if let Some(scale) = scale {
            write!(f, ", {} mm a pixel", scale.mm_per_pixel)?;
        }
        f.write_str(")")
    }
}

impl<'a> From<&'a Frame<'_>> for Frame<'a> {
    /// The same pixels, not copied.
    fn from(frame: &'a Frame<'_>) -> Self {
        Self { data: Cow::Borrowed(&frame.data), ..*frame }
    }
}

#[cfg(feature = "image")]
impl Frame<'_> {
    /// All of the frame in red, green and blue, as the network gets them.
    ///
    /// # Errors
    /// [`Error::Picture`], [`Error::Param`] and [`Error::Capacity`] as
    /// [`GpuDetector::detect`](crate::GpuDetector::detect).
    pub fn to_rgb(&self) -> Result<image::RgbImage> {
        self.check()?;
        let Self { width, height, .. } = *self;
        let (words, crop) = self.bytes(Rect { x: 0, y: 0, width, height })?;
        let bytes: &[u8] = bytemuck::cast_slice(words.data());
        let (columns, rows) = (width as usize, height as usize);
        let (mut pixels, mut converted) = (Vec::new(), vec![[0; 3]; columns]);
        for row in bytes.chunks_exact(columns * crop.order.bytes()).take(rows) {
            pixels.extend_from_slice(crop.order.rgb(row, &mut converted));
        }
        image::RgbImage::from_raw(width, height, pixels).ok_or_else(|| {
            Error::tensor("frame", "pixels", format!("{width} × {height}"), "another number")
        })
    }
}

#[cfg(feature = "image")]
impl<'a> From<&'a image::DynamicImage> for Frame<'a> {
    fn from(picture: &'a image::DynamicImage) -> Self {
        use image::DynamicImage as Image;
        let (width, height) = (picture.width(), picture.height());
        match picture {
            Image::ImageRgb8(p) => Self::new(p.as_raw(), width, height, PixelFormat::Rgb8),
            Image::ImageRgba8(p) => Self::new(p.as_raw(), width, height, PixelFormat::Rgba8),
            Image::ImageLuma8(p) => Self::new(p.as_raw(), width, height, PixelFormat::Gray8),
            other => Self::new(other.to_rgb8().into_raw(), width, height, PixelFormat::Rgb8),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest square of the frame or of its crop, its bytes and where they show it.
    fn square(frame: &Frame) -> Result<(Rect, Tensor<u32>, Crop)> {
        frame.check()?;
        let all = Rect { x: 0, y: 0, width: frame.width, height: frame.height };
        let part = frame.crop.unwrap_or(all).central(1.0);
        let (bytes, crop) = frame.bytes(part)?;
        Ok((part, bytes, crop))
    }

    /// The (r, g, b) of what the network sees.
    fn seen(frame: &Frame) -> Vec<[u8; 3]> {
        let (part, words, crop) = square(frame).expect("a sound frame");
        let size = [part.width, part.height].map(|n| n as usize);
        assert_eq!(([crop.width, crop.height], [crop.columns, crop.rows]), (size, size));
        crop.to_tensor(words.data().len()).expect("all of it is there");
        let bytes: Vec<u8> = words.data().iter().flat_map(|word| word.to_le_bytes()).collect();
        let mut converted = vec![[0; 3]; crop.columns];
        (0..crop.rows)
            .flat_map(|y| {
                crop.rgb(&bytes, 0..crop.columns, y, &mut converted).as_chunks().0.to_vec()
            })
            .collect()
    }

    /// What the frame's own bytes show is what a copy of them does.
    #[test]
    fn bytes_are_borrowed_where_they_lie_as_in_a_picture() {
        let data: Vec<u8> = (0..240).collect();
        let whole = |frame: &Frame| Rect { x: 0, y: 0, width: frame.width, height: frame.height };
        let inner = Rect { x: 1, y: 2, width: 3, height: 2 };
        for format in [
            PixelFormat::Rgb8,
            PixelFormat::Bgr8,
            PixelFormat::Rgba8,
            PixelFormat::Bgra8,
            PixelFormat::Gray8,
        ] {
            let each = format.bytes_per_pixel();
            for padding in [0, each, 3 * each] {
                let frame = Frame::new(&data, 5, 5, format).stride(5 * each + padding);
                for part in [whole(&frame), inner] {
                    let (own, crop) = frame.own_bytes(part).expect("bytes of its own");
                    let (copied, all) = frame.bytes(part).expect("a sound frame");
                    let copied: &[u8] = bytemuck::cast_slice(copied.data());
                    crop.to_tensor(own.len().div_ceil(4)).expect("all of it is there");
                    for y in 0..crop.rows {
                        let rows = [(&crop, own), (&all, copied)].map(|(crop, bytes)| {
                            let mut line = vec![[0; 3]; crop.columns];
                            crop.rgb(bytes, 0..crop.columns, y, &mut line).to_vec()
                        });
                        assert_eq!(rows[0], rows[1], "{format:?}, {padding}, row {y}");
                    }
                }
            }
        }
        let rgb = |stride| Frame::new(&data, 5, 5, PixelFormat::Rgb8).stride(stride);
        let ends_early = Frame::new(&data[..4 * 18 + 15], 5, 5, PixelFormat::Rgb8).stride(18);
        let mosaic = Frame::new(&data, 5, 5, PixelFormat::BayerRggb8);
        for frame in [rgb(16), ends_early, mosaic] {
            assert!(frame.own_bytes(whole(&frame)).is_none(), "{frame:?}");
        }
        assert!(rgb(18).own_bytes(inner).is_some());
        let large = vec![0; 5793 * 5793];
        let large = Frame::new(&large, 5793, 5793, PixelFormat::Gray8);
        assert!(large.own_bytes(whole(&large)).is_none());
    }

    fn refusal(frame: &Frame) -> String {
        square(frame).expect_err("an error").to_string()
    }

    #[test]
    fn the_same_pixels_in_each_format() {
        let want = [[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]];
        let bytes = |order: &[usize]| -> Vec<u8> {
            let sample = |p: &[u8; 3], i: usize| p.get(i).copied().unwrap_or(77);
            want.iter().flat_map(|p| order.iter().map(move |i| sample(p, *i))).collect()
        };
        for (format, order) in [
            (PixelFormat::Rgb8, &[0, 1, 2][..]),
            (PixelFormat::Bgr8, &[2, 1, 0]),
            (PixelFormat::Rgba8, &[0, 1, 2, 3]),
            (PixelFormat::Bgra8, &[2, 1, 0, 3]),
        ] {
            assert_eq!(seen(&Frame::new(bytes(order), 2, 2, format)), want, "{format:?}");
        }
        let grey = Frame::new(&[1, 2, 3, 255][..], 2, 2, PixelFormat::Gray8);
        assert_eq!(seen(&grey), [1, 2, 3, 255].map(|v| [v; 3]));
    }

    #[test]
    fn rows_may_be_apart_and_the_last_may_end_early() {
        let data: Vec<u8> = (0..13).collect();
        let frame = Frame::new(&data, 3, 3, PixelFormat::Gray8).stride(5);
        let rows = [0, 1, 2, 5, 6, 7, 10, 11, 12];
        assert_eq!(seen(&frame), rows.map(|v| [v; 3]));
        let frame = Frame::new(&data[..12], 3, 3, PixelFormat::Gray8).stride(5);
        let message = "frame: parameter `data`: expected at least 13 bytes, got 12";
        assert_eq!(refusal(&frame), message);
    }

    #[test]
    fn the_middle_square_of_the_part_is_seen() {
        let data: Vec<u8> = (0..40).collect();
        let frame = Frame::new(&data, 8, 5, PixelFormat::Gray8);
        assert_eq!(square(&frame).expect("a frame").0, Rect { x: 1, y: 0, width: 5, height: 5 });
        // Two rows of four from (3, 2): the middle two columns.
        let frame = frame.crop(Rect { x: 3, y: 2, width: 4, height: 2 });
        assert_eq!(square(&frame).expect("a frame").0, Rect { x: 4, y: 2, width: 2, height: 2 });
        assert_eq!(seen(&frame), [20, 21, 28, 29].map(|v| [v; 3]));
    }

    /// Pixels of 4 × 2 numbered from 0, of which columns 2 and 3 are seen.
    #[test]
    fn a_part_of_pixels_of_several_bytes() {
        let part = Rect { x: 2, y: 0, width: 2, height: 2 };
        let rgb: Vec<u8> = (0..8).flat_map(|i| [i, 10 + i, 20 + i]).collect();
        let want = [2, 3, 6, 7].map(|i| [i, 10 + i, 20 + i]);
        assert_eq!(seen(&Frame::new(rgb, 4, 2, PixelFormat::Rgb8).crop(part)), want);
        let bgra: Vec<u8> = (0..8).flat_map(|i| [20 + i, 10 + i, i, 99]).collect();
        assert_eq!(seen(&Frame::new(bgra, 4, 2, PixelFormat::Bgra8).crop(part)), want);
    }

    #[test]
    fn what_is_not_there_is_refused() {
        let data = vec![0; 3 * 4 * 3];
        let frame = |width, height| Frame::new(&data, width, height, PixelFormat::Rgb8);
        assert!(square(&frame(4, 3)).is_ok());
        assert_eq!(refusal(&frame(0, 3)), "picture: expected at least 1 × 1 pixel, got 0 × 3");
        assert_eq!(
            refusal(&frame(4, 4)),
            "frame: parameter `data`: expected at least 48 bytes, got 36"
        );
        assert_eq!(
            refusal(&frame(4, 3).stride(11)),
            "frame: parameter `stride`: expected at least 12 bytes, got 11"
        );
        for (x, y, width, height) in
            [(0, 0, 5, 1), (4, 0, 1, 1), (1, 1, 3, 3), (0, 0, 0, 1), (u32::MAX, 0, 2, 1)]
        {
            let message = refusal(&frame(4, 3).crop(Rect { x, y, width, height }));
            let start = "frame: parameter `crop`: expected a part of 4 × 3 pixels, got ";
            assert!(message.starts_with(start), "{message}");
        }
        for (width, height, stride) in [(u32::MAX, u32::MAX, usize::MAX), (1, u32::MAX, 1 << 40)] {
            let message = refusal(&frame(width, height).stride(stride));
            assert!(message.contains("`data`"), "{message}");
        }
        let data = vec![0; 5793 * 5793];
        let message = refusal(&Frame::new(&data, 5793, 5793, PixelFormat::Gray8));
        assert!(message.contains("needs 33558849, but only 33554432"), "{message}");
    }

    /// By hand, on the frame
    /// ```text
    /// R 10  G 20  R 30
    /// G 40  B 50  G 60
    /// R 70  G 80  R 91
    /// ```
    #[test]
    fn bayer_patterns_are_interpolated() {
        let data = [10, 20, 30, 40, 50, 60, 70, 80, 91];
        let rggb = Frame::new(&data[..], 3, 3, PixelFormat::BayerRggb8);
        let want = [
            [10, 30, 50], // green (20 + 40) / 2
            [20, 20, 50], // red (10 + 30) / 2
            [30, 40, 50], // green (20 + 60) / 2
            [40, 40, 50], // red (10 + 70) / 2
            [50, 50, 50], // red (10 + 30 + 70 + 91) / 4, green (20 + 40 + 60 + 80) / 4
            [61, 60, 50], // red (30 + 91) / 2
            [70, 60, 50],
            [81, 80, 50],
            [91, 70, 50],
        ];
        assert_eq!(seen(&rggb), want);
        // Blue where red was.
        let bggr = Frame::new(&data[..], 3, 3, PixelFormat::BayerBggr8);
        assert_eq!(seen(&bggr), want.map(|[r, g, b]| [b, g, r]));
        // From its second column or row on, the mosaic is another; neighbours outside the part count.
        let middle = Rect { x: 1, y: 1, width: 1, height: 1 };
        for (format, pixel) in [
            (PixelFormat::BayerGrbg8, [50, 50, 50]), // red (20 + 80) / 2, blue (40 + 60) / 2
            (PixelFormat::BayerGbrg8, [50, 50, 50]),
        ] {
            assert_eq!(seen(&Frame::new(&data[..], 3, 3, format).crop(middle)), [pixel]);
        }
        let grbg = Frame::new(&data[..4], 2, 2, PixelFormat::BayerGrbg8);
        // G 10  R 20 / B 30  G 40
        assert_eq!(seen(&grbg)[..2], [[20, 10, 30], [20, 25, 30]]);
        let gbrg = Frame::new(&data[..4], 2, 2, PixelFormat::BayerGbrg8);
        assert_eq!(seen(&gbrg)[..2], [[30, 10, 20], [30, 25, 20]]);
    }

    #[test]
    fn a_line_for_people() {
        let data = vec![0; 1 << 20];
        let frame = Frame::new(&data, 1024, 1024, PixelFormat::Gray8);
        assert_eq!(format!("{frame:?}"), "Frame(1024 × 1024 Gray8, 1048576 bytes, stride 1024)");
    }

    #[cfg(feature = "image")]
    #[test]
    fn pictures_of_every_kind_are_seen_as_their_colours() {
        use image::{DynamicImage, Rgb, RgbImage};
        let rgb = RgbImage::from_fn(4, 3, |x, y| Rgb([x as u8 * 60, y as u8 * 90, 7]));
        let rgb = DynamicImage::from(rgb);
        let kinds = [
            rgb.clone(),
            rgb.to_luma8().into(),
            rgb.to_luma_alpha8().into(),
            rgb.to_rgba8().into(),
            rgb.to_luma16().into(),
            rgb.to_luma_alpha16().into(),
            rgb.to_rgb16().into(),
            rgb.to_rgba16().into(),
            rgb.to_rgb32f().into(),
            rgb.to_rgba32f().into(),
        ];
        for picture in kinds {
            let want: Vec<_> =
                picture.crop_imm(0, 0, 3, 3).to_rgb8().pixels().map(|p| p.0).collect();
            assert_eq!(seen(&Frame::from(&picture)), want, "{:?}", picture.color());
            let all = Frame::from(&picture).to_rgb().expect("a picture");
            assert_eq!(all, picture.to_rgb8(), "{:?}", picture.color());
        }
    }
}
