//! Reading pictures that nobody vouches for.

use std::fs::File;
use std::io::{Cursor, Read};

use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use smr_gpu::detector::MAX_PIXELS;

use super::source::Source;

/// Most bytes of a decoded picture: [`MAX_PIXELS`] of four 32-bit floats.
const MAX_DECODED: u64 = MAX_PIXELS as u64 * 16;
/// Most bytes of a picture as it is stored.
const MAX_ENCODED: u64 = 1 << 30;

/// Reads a PNG, JPEG, BMP or TIFF picture and turns it upright as its EXIF orientation says.
///
/// # Errors
/// A line with what was expected and what came, without the picture's name.
pub(super) fn read(source: &Source) -> Result<DynamicImage, String> {
    let mut bytes = Vec::new();
    match source {
        Source::File(path) => {
            File::open(path).and_then(|f| f.take(MAX_ENCODED).read_to_end(&mut bytes))
        }
        Source::Stdin => std::io::stdin().lock().take(MAX_ENCODED).read_to_end(&mut bytes),
    }
    .map_err(|e| e.to_string())?;
    decode(&bytes)
}

fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let mut reader = reader.map_err(|e| e.to_string())?;
    let format = reader.format().filter(|f| f.reading_enabled());
    let format = format.ok_or("expected a PNG, JPEG, BMP or TIFF picture, got something else")?;
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_DECODED);
    reader.limits(limits);
    let readable = |e: ImageError| format!("expected a readable {format:?}, got an error: {e}");
    let mut decoder = reader.into_decoder().map_err(readable)?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS as u64 {
        return Err(format!("expected at most {MAX_PIXELS} pixels, got {width} × {height}"));
    }
    if format == ImageFormat::Jpeg && !jpeg_is_whole(bytes) {
        return Err("expected a whole Jpeg, got one without its end".into());
    }
    let orientation = decoder.orientation().map_err(readable)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(readable)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// Whether a JPEG's markers lead to its end-of-image marker; the decoder would fill in what is
/// missing with grey.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const END: u8 = 0xd9;
    const SCAN: u8 = 0xda;
    // Behind the start-of-image marker.
    let mut at = 2;
    let mut in_scan = false;
    while let Some([0xff, marker]) = bytes.get(at..at + 2) {
        at += match *marker {
            END => return true,
            // Fill bytes.
            0xff => 1,
            // A stuffed zero, and markers without a segment.
            0x00 | 0x01 | 0xd0..=0xd7 => 2,
            other => {
                in_scan = other == SCAN;
                let length = bytes.get(at + 2..at + 4).map_or([0, 0], |l| [l[0], l[1]]);
                2 + usize::from(u16::from_be_bytes(length)).max(2)
            }
        };
        if in_scan {
            let rest = bytes.get(at..).unwrap_or_default();
            at += rest.iter().position(|b| *b == 0xff).unwrap_or(rest.len());
        }
    }
    false
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
        let error = decode(&bytes).expect_err("too large");
        assert_eq!(error, "expected at most 33554432 pixels, got 60000 × 60000");
    }

    #[test]
    fn other_files_are_refused() {
        for bytes in [b"".as_slice(), b"hello", b"GIF89a\x01\0\x01\0\0\0\0;"] {
            let error = decode(bytes).expect_err("no picture");
            assert!(error.starts_with("expected a PNG, JPEG, BMP or TIFF picture"), "{error}");
        }
    }

    #[test]
    fn jpegs_that_end_early_are_refused() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/pictures/turned.jpg");
        let whole = std::fs::read(file).expect("the picture");
        assert!(whole.ends_with(&[0xff, 0xd9]));
        for end in 0..whole.len() {
            decode(&whole[..end]).expect_err("a part of a JPEG");
        }
        // What cameras append behind the end is no harm.
        decode(&[&whole[..], b"\xff\xda and more"].concat()).expect("a whole JPEG");
    }
}
