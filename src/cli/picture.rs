//! Reading pictures that nobody vouches for.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek};

use image::{DynamicImage, ImageDecoder, ImageError, ImageReader, Limits};

use super::source::Source;

/// Most pixels of a picture: as RGBA8 they fill the 128 MiB that every device can bind.
const MAX_PIXELS: u64 = 1 << 25;
/// Most bytes of a decoded picture: [`MAX_PIXELS`] of four 32-bit floats.
const MAX_DECODED: u64 = MAX_PIXELS * 16;
/// Most bytes of a picture on stdin.
const MAX_ENCODED: u64 = 1 << 30;

/// Reads a PNG, JPEG, BMP or TIFF picture and turns it upright as its EXIF orientation says.
///
/// # Errors
/// A line with what was expected and what came, without the picture's name.
pub(super) fn read(source: &Source) -> Result<DynamicImage, String> {
    match source {
        Source::File(path) => {
            let file = File::open(path).map_err(|e| e.to_string())?;
            decode(BufReader::new(file))
        }
        Source::Stdin => {
            let mut bytes = Vec::new();
            let read = std::io::stdin().lock().take(MAX_ENCODED).read_to_end(&mut bytes);
            read.map_err(|e| e.to_string())?;
            decode(Cursor::new(bytes))
        }
    }
}

fn decode(reader: impl BufRead + Seek) -> Result<DynamicImage, String> {
    let mut reader = ImageReader::new(reader).with_guessed_format().map_err(|e| e.to_string())?;
    let format = reader.format().filter(|f| f.reading_enabled());
    let format = format.ok_or("expected a PNG, JPEG, BMP or TIFF picture, got something else")?;
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_DECODED);
    reader.limits(limits);
    let whole = |e: ImageError| format!("expected a whole {format:?} picture, got an error: {e}");
    let mut decoder = reader.into_decoder().map_err(whole)?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(format!("expected at most {MAX_PIXELS} pixels, got {width} × {height}"));
    }
    let orientation = decoder.orientation().map_err(whole)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(whole)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn stored(name: &str) -> DynamicImage {
        let file = format!("{}/tests/pictures/{name}", env!("CARGO_MANIFEST_DIR"));
        read(&Source::File(file.into())).expect("a picture")
    }

    /// Whether the pixel's channels are within JPEG's loss of the expected ones.
    fn is_near(picture: &DynamicImage, x: u32, y: u32, expected: [u8; 3]) -> bool {
        let Rgb(got) = *picture.to_rgb8().get_pixel(x, y);
        got.iter().zip(expected).all(|(g, e)| g.abs_diff(e) < 24)
    }

    #[test]
    fn cmyk_becomes_rgb() {
        // Half magenta and yellow ink, half cyan ink: red beside cyan.
        let picture = stored("cmyk.jpg");
        assert_eq!((picture.width(), picture.height()), (32, 16));
        assert!(is_near(&picture, 4, 8, [255, 0, 0]) && is_near(&picture, 28, 8, [0, 255, 255]));
    }

    #[test]
    fn exif_orientation_is_applied() {
        // Stored red beside blue, to be shown turned clockwise: red above blue.
        let picture = stored("turned.jpg");
        assert_eq!((picture.width(), picture.height()), (16, 32));
        assert!(is_near(&picture, 8, 4, [255, 0, 0]) && is_near(&picture, 8, 28, [0, 0, 255]));
    }

    #[test]
    fn huge_pictures_are_refused_by_their_header() {
        // A BMP header alone: 60 000 × 60 000 in 24 bits.
        let mut bytes = b"BM\0\0\0\0\0\0\0\0\x36\0\0\0\x28\0\0\0".to_vec();
        bytes.extend(60_000_u32.to_le_bytes());
        bytes.extend(60_000_u32.to_le_bytes());
        bytes.extend([1, 0, 24, 0]);
        bytes.resize(54, 0);
        let error = decode(Cursor::new(bytes)).expect_err("too large");
        assert_eq!(error, "expected at most 33554432 pixels, got 60000 × 60000");
    }

    #[test]
    fn other_files_are_refused() {
        for bytes in [b"".as_slice(), b"hello", b"GIF89a\x01\0\x01\0\0\0\0;"] {
            let error = decode(Cursor::new(bytes)).expect_err("no picture");
            assert!(error.starts_with("expected a PNG, JPEG, BMP or TIFF picture"), "{error}");
        }
    }
}
