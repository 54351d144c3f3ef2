//! Reading untrusted pictures: PNG, JPEG, BMP and TIFF.
//!
//! Whatever the bytes are, [`decode`] ends with the whole picture or with an [`Error`]. It does not
//! panic, since it catches what a decoder does, and it keeps to limits:
//!
//! | | at most |
//! |---|---|
//! | pixels | [`MAX_PIXELS`] |
//! | bytes as stored | [`MAX_ENCODED`]; of a file of another kind, its first [`MAGIC`] are read |
//! | bytes as decoded | 4 a pixel, 8 bits a channel; in the meantime up to 9 |
//! | scans of a JPEG | [`MAX_SCANS`], each over all of its pixels |
//! | strips or tiles of a TIFF | an index of 1 MiB, without overlap; 512 MiB unpacked |
//!
//! A build with `panic = "abort"` cannot catch a decoder's panic.

mod bmp;
mod jpeg;
mod png;
mod stream;
mod tiff;

use std::cell::Cell;
use std::fmt;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError};

use crate::engine::shape::MAX_PIXELS;
use crate::files;
pub use jpeg::MAX_SCANS;
pub use stream::Pictures;

/// Most bytes of a picture as it is stored: [`MAX_PIXELS`] of four channels of 16 bits, and 64 MiB.
pub const MAX_ENCODED: u64 = MAX_PIXELS as u64 * 8 + (64 << 20);
/// Endings of pictures' names, in small letters.
pub const ENDINGS: [&str; 6] = ["png", "jpg", "jpeg", "bmp", "tif", "tiff"];

/// Whether a file's name ends as a picture's.
pub fn has_ending(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    ending.is_some_and(|e| ENDINGS.contains(&e.as_str()))
}

/// How many bytes show what a file is: as many as it takes to name a WebP or an AVIF.
pub const MAGIC: u64 = 12;

/// A kind of picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// BMP.
    Bmp,
    /// TIFF, BigTIFF too.
    Tiff,
}

impl Format {
    /// The format that a file's first bytes show.
    fn of(bytes: &[u8]) -> Result<Self, Error> {
        match bytes {
            [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n', ..] => Ok(Self::Png),
            [0xff, 0xd8, 0xff, ..] => Ok(Self::Jpeg),
            [b'B', b'M', ..] => Ok(Self::Bmp),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Ok(Self::Tiff),
            [] => Err(Error::Unknown("an empty one".into())),
            _ => Err(Error::Unknown(match image::guess_format(bytes) {
                Ok(other) => format!("{other:?}"),
                Err(_) => "something else".into(),
            })),
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Bmp => "BMP",
            Self::Tiff => "TIFF",
        })
    }
}

/// Why there is no picture; without its name, which the caller knows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system's words, or what the path leads to that is no file.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// None of the formats.
    #[error("expected a PNG, JPEG, BMP or TIFF picture, got {0}")]
    Unknown(String),
    /// Past a limit.
    #[error("expected at most {limit}, got {got}")]
    TooLarge {
        /// The limit with its unit.
        limit: String,
        /// What came.
        got: String,
    },
    /// A sound file of a kind that is not read.
    #[error("expected {expected}, got {got}")]
    Unsupported {
        /// What is read.
        expected: &'static str,
        /// What came.
        got: String,
    },
    /// A part of the picture is missing or wrong.
    #[error("expected a whole {format}, got {got}")]
    Damaged {
        /// The format.
        format: Format,
        /// What came.
        got: String,
    },
    /// The decoder refused it, in its words.
    #[error("expected a readable {format}, got an error: {message}")]
    Unreadable {
        /// The format.
        format: Format,
        /// The decoder's words.
        message: String,
    },
    /// The decoder panicked: a fault of its own.
    #[error("the {format} decoder failed at this picture: {message}")]
    DecoderFailed {
        /// The format.
        format: Format,
        /// The panic's message.
        message: String,
    },
}

/// Reads a picture in 8 bits a channel from a file and turns it upright as its orientation says.
///
/// # Errors
/// [`Error`]. Pipes, devices, sockets and folders are refused, not opened; but for pipes that this
/// process has open, such as `/dev/stdin`, which are read as a stream.
pub fn read(path: impl AsRef<Path>) -> Result<DynamicImage, Error> {
    let (file, length) = files::open_or_pipe(path.as_ref())?;
    read_sized(file, length)
}

/// The same from a stream, to its end.
///
/// # Errors
/// [`Error`].
pub fn read_from(reader: impl Read) -> Result<DynamicImage, Error> {
    read_sized(reader, 0)
}

/// Reads a stream that is about `length` bytes long.
fn read_sized(mut reader: impl Read, length: u64) -> Result<DynamicImage, Error> {
    let mut bytes = Vec::new();
    reader.by_ref().take(MAGIC).read_to_end(&mut bytes)?;
    Format::of(&bytes)?;
    check_encoded(length)?;
    // The limit fits into any `usize` of 32 bits.
    bytes.try_reserve_exact(length as usize).map_err(std::io::Error::from)?;
    reader.take(MAX_ENCODED + 1 - MAGIC).read_to_end(&mut bytes)?;
    decode(&bytes)
}

/// Decodes a picture into 8 bits a channel and turns it upright as its orientation says.
///
/// # Errors
/// [`Error`].
pub fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let format = Format::of(bytes)?;
    check_encoded(bytes.len() as u64)?;
    guarded(format, || match format {
        Format::Png => png::decode(bytes),
        Format::Jpeg => jpeg::decode(bytes),
        Format::Bmp => bmp::decode(bytes),
        Format::Tiff => tiff::decode(bytes),
    })
}

/// Decodes a grey PNG of 16 bits a pixel, a map of heights, and turns it upright as its orientation says.
///
/// # Errors
/// [`Error`]; [`Error::Unsupported`] for any other picture.
#[cfg(feature = "simulator")]
pub fn decode_grey_16(bytes: &[u8]) -> Result<GreyPicture16, Error> {
    let other = |got: String| Error::Unsupported { expected: GREY_16, got };
    match Format::of(bytes)? {
        Format::Png => {}
        format => return Err(other(format.to_string())),
    }
    check_encoded(bytes.len() as u64)?;
    match guarded(Format::Png, || png::decode_grey_16(bytes))? {
        DynamicImage::ImageLuma16(map) => Ok(map),
        picture => Err(other(format!("{:?}", picture.color()))),
    }
}

#[cfg(feature = "simulator")]
const GREY_16: &str = "a grey PNG of 16 bits";

/// A grey picture of 16 bits a pixel.
#[cfg(feature = "simulator")]
pub type GreyPicture16 = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;

thread_local! {
    static DECODING: Cell<bool> = const { Cell::new(false) };
}

/// Whether this thread is within [`decode`], which catches panics and reports them as errors: a
/// program's panic hook may keep quiet then.
pub fn is_decoding() -> bool {
    DECODING.get()
}

/// Runs a decoder; its panic is an error of this picture alone.
fn guarded(
    format: Format,
    decode: impl FnOnce() -> Result<DynamicImage, Error>,
) -> Result<DynamicImage, Error> {
    let outer = DECODING.replace(true);
    // What the decoder worked on dies with it; it reads nothing but the bytes.
    let result = catch_unwind(AssertUnwindSafe(decode));
    DECODING.set(outer);
    result.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let message = text.or_else(|| panic.downcast_ref().copied()).unwrap_or("it panicked");
        Err(Error::DecoderFailed { format, message: message.into() })
    })
}

/// The picture of one of `image`'s decoders.
fn finish(format: Format, mut decoder: impl ImageDecoder) -> Result<DynamicImage, Error> {
    check_size(decoder.dimensions())?;
    let orientation = decoder.orientation().map_err(|e| unreadable(format, e))?;
    let picture = DynamicImage::from_decoder(decoder);
    let mut picture = picture.map_err(|e| unreadable(format, e))?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// How to turn a picture upright, by its EXIF data (a TIFF's header and its first directory).
///
/// Data that cannot be read is an error: a picture that lies on its side is another picture.
fn orientation(format: Format, exif: Option<&[u8]>) -> Result<Orientation, Error> {
    let Some(exif) = exif else { return Ok(Orientation::NoTransforms) };
    let damaged = |got: &str| Error::Damaged { format, got: got.into() };
    let cut = || damaged("EXIF data that cannot be read");
    let is_big = match exif.get(..4).ok_or_else(cut)? {
        b"MM\0*" => true,
        b"II*\0" => false,
        _ => return Err(cut()),
    };
    let number = |at: usize, length: usize| {
        let bytes = exif.get(at..at.checked_add(length)?)?.iter();
        let join = |value, byte: &u8| value << 8 | usize::from(*byte);
        Some(if is_big { bytes.fold(0, join) } else { bytes.rev().fold(0, join) })
    };
    let first = number(4, 4).ok_or_else(cut)?;
    let count = number(first, 2).ok_or_else(cut)?;
    for entry in (0..count).map(|i| first + 2 + 12 * i) {
        if number(entry, 2).ok_or_else(cut)? != 0x0112 {
            continue;
        }
        // One number of 16 bits.
        let value = number(entry + 8, 4).and_then(|_| number(entry + 8, 2)).ok_or_else(cut)?;
        if (number(entry + 2, 2), number(entry + 4, 4)) != (Some(3), Some(1)) {
            return Err(damaged("an orientation that is no number"));
        }
        return upright(format, value);
    }
    Ok(Orientation::NoTransforms)
}

/// The orientation of this number; some cameras write 0 for none.
fn upright(format: Format, value: usize) -> Result<Orientation, Error> {
    let known = u8::try_from(value).ok().and_then(|v| Orientation::from_exif(v.max(1)));
    known.ok_or_else(|| Error::Damaged { format, got: format!("orientation {value} of 8") })
}

/// A value of 16 bits in 8, rounded.
fn from_16(value: u16) -> u8 {
    ((u32::from(value) + 128) / 257) as u8
}

fn unreadable(format: Format, error: ImageError) -> Error {
    Error::Unreadable { format, message: error.to_string() }
}

fn check_encoded(length: u64) -> Result<(), Error> {
    match length {
        0..=MAX_ENCODED => Ok(()),
        // As much was read as shows that there is more.
        length if length == MAX_ENCODED + 1 => Err(too_long()),
        length => {
            let limit = format!("{MAX_ENCODED} bytes");
            Err(Error::TooLarge { limit, got: length.to_string() })
        }
    }
}

fn too_long() -> Error {
    Error::TooLarge { limit: format!("{MAX_ENCODED} bytes"), got: "more".into() }
}

fn check_size((width, height): (u32, u32)) -> Result<(), Error> {
    let pixels = u64::from(width) * u64::from(height);
    match pixels <= MAX_PIXELS as u64 {
        true => Ok(()),
        false => Err(Error::TooLarge {
            limit: format!("{MAX_PIXELS} pixels"),
            got: format!("{width} × {height}"),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoders_panic_is_an_error() {
        let error = guarded(Format::Bmp, || panic!("index {} out of bounds", 7));
        let error = error.expect_err("it panics");
        assert_eq!(
            error.to_string(),
            "the BMP decoder failed at this picture: index 7 out of bounds"
        );
        assert!(!is_decoding());
        guarded(Format::Bmp, || {
            assert!(is_decoding());
            Err(Error::Unknown(String::new()))
        })
        .expect_err("no picture");
    }

    /// A stream that fails the test if it is read past its magic.
    struct Endless {
        magic: &'static [u8],
        given: u64,
        most: u64,
    }

    impl Read for Endless {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            for byte in buffer.iter_mut() {
                *byte = self.magic.get(self.given as usize).copied().unwrap_or(0);
                self.given += 1;
            }
            assert!(self.given <= self.most, "{} bytes were read", self.given);
            Ok(buffer.len())
        }
    }

    #[test]
    fn of_other_files_the_first_bytes_alone_are_read() {
        let mut zero = Endless { magic: b"", given: 0, most: MAGIC };
        let error = read_from(&mut zero).expect_err("no picture");
        assert_eq!(
            error.to_string(),
            "expected a PNG, JPEG, BMP or TIFF picture, got something else"
        );
    }

    #[test]
    fn endless_streams_end_at_the_limit() {
        let mut bmp = Endless { magic: b"BM", given: 0, most: MAX_ENCODED + 1 };
        let error = read_from(&mut bmp).expect_err("no end");
        assert_eq!(error.to_string(), format!("expected at most {MAX_ENCODED} bytes, got more"));
    }
}
