//! A frame of a source, and what tells it from all others.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use image::{DynamicImage, RgbImage};
use smr_gpu::engine::shape::MAX_PIXELS;
use smr_gpu::{Error, Frame, PixelFormat};

use super::super::detector::known;
use super::Source;

/// Which frame of which source: a file's name, or `source#index`.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct FrameId {
    pub source: Arc<Source>,
    /// What files that are made of the source are called.
    pub name: Arc<str>,
    /// From 0: the frame's place in its stream, a picture file's among those of the run. Frames that are
    /// skipped count.
    pub index: u64,
    /// Its place among all frames of the run.
    pub number: u64,
    /// Seconds from the stream's beginning, where it says so.
    pub time_s: Option<f64>,
}

impl fmt::Display for FrameId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self.source {
            Source::File(_) => self.source.fmt(f),
            _ => f.pad(&format!("{}#{}", self.source, self.index)),
        }
    }
}

impl FrameId {
    /// What files that are made of the frame are called.
    pub fn stem(&self) -> String {
        match *self.source {
            Source::File(_) => self.name.to_string(),
            _ => format!("{}-{:06}", self.name, self.index),
        }
    }
}

/// A frame that was read.
pub(in super::super) struct Shot {
    pub id: FrameId,
    pub pixels: Pixels,
    /// What reading and decoding it took.
    pub read: Duration,
}

/// A frame's pixels, as they came.
pub(in super::super) enum Pixels {
    Picture(DynamicImage),
    Raw(Vec<u8>, RawFormat),
}

impl Pixels {
    /// What a detector takes.
    pub fn frame(&self) -> Frame<'_> {
        match self {
            Self::Picture(picture) => Frame::from(picture),
            Self::Raw(bytes, raw) => Frame::new(bytes, raw.width, raw.height, raw.format),
        }
    }

    /// In red, green and blue, to draw on.
    ///
    /// # Errors
    /// As [`Frame::to_rgb`].
    pub fn to_rgb(&self) -> Result<RgbImage, Error> {
        match self {
            Self::Picture(picture) => Ok(picture.to_rgb8()),
            Self::Raw(..) => self.frame().to_rgb(),
        }
    }
}

/// Size and format of frames that come as bare pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct RawFormat {
    pub width: u32,
    pub height: u32,
    pub format: PixelFormat,
}

impl RawFormat {
    /// Bytes of a frame.
    pub fn bytes(self) -> u64 {
        self.format.frame_bytes(self.width, self.height)
    }
}

impl FromStr for RawFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(':').and_then(|(size, format)| {
            let (width, height) = size.split_once('x')?;
            Some((width.parse::<u32>().ok()?, height.parse::<u32>().ok()?, format))
        });
        let (width, height, format) =
            parts.ok_or("expected WxH:FORMAT, as in 640x480:rgb8".to_owned())?;
        let format = known::<PixelFormat>(format)?;
        let pixels = u64::from(width) * u64::from(height);
        if !(1..=MAX_PIXELS as u64).contains(&pixels) {
            return Err(format!("expected 1 to {MAX_PIXELS} pixels, got {width} × {height}"));
        }
        let block = format.block();
        match width.is_multiple_of(block[0]) && height.is_multiple_of(block[1]) {
            true => Ok(Self { width, height, format }),
            false => {
                let [wide, high] = block;
                Err(format!(
                    "expected a multiple of {wide} × {high} pixels, got {width} × {height}"
                ))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_formats_are_parsed() {
        let parse = |text: &str| text.parse::<RawFormat>();
        let want = RawFormat { width: 640, height: 480, format: PixelFormat::Nv12 };
        assert_eq!((parse("640x480:nv12"), want.bytes()), (Ok(want), 460_800));
        for (text, phrase) in [
            ("640:nv12", "expected WxH:FORMAT"),
            ("-1x2:rgb8", "expected WxH:FORMAT"),
            ("0x2:rgb8", "expected 1 to 33554432 pixels, got 0 × 2"),
            ("65536x65536:rgb8", "got 65536 × 65536"),
            ("3x2:yuyv", "a multiple of 2 × 1 pixels, got 3 × 2"),
            ("4x3:nv12", "a multiple of 2 × 2 pixels, got 4 × 3"),
            ("4x4:rgb", "expected one of `rgb8`"),
        ] {
            let told = parse(text).expect_err(text);
            assert!(told.contains(phrase), "{told}");
        }
    }
}
