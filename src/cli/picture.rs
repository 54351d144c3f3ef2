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
