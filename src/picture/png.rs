//! PNG. Read to its end, since an orientation may stand behind the pixels, and since a checksum
//! that nobody reached protects nothing.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageBuffer};
use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};

use super::{Error, Format, MAX_ENCODED, check_size};

pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    // Limits what the decoder allocates beside the pixels: a row, chunks.
    let limits = Limits { bytes: MAX_ENCODED as usize };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    check_size(decoder.read_header_info().map_err(unreadable)?.size())?;
    let mut reader = decoder.read_info().map_err(unreadable)?;
    let info = reader.info();
    let (width, height) = info.size();
    // Version 0.18 of the decoder takes it for granted.
    if let Some(palette) = info.palette.as_ref().filter(|p| p.len() % 3 != 0) {
        return Err(damaged(format!("a palette of {} bytes, no multiple of 3", palette.len())));
    }
    let size = reader.output_buffer_size().ok_or_else(|| damaged("no size".into()))?;
    let mut samples = vec![0; size];
    let frame = reader.next_frame(&mut samples).map_err(unreadable)?;
    if (frame.width, frame.height) != (width, height) {
        let got = format!("{} × {} of {width} × {height} pixels", frame.width, frame.height);
        return Err(damaged(got));
    }
    reader.finish().map_err(unreadable)?;
    let exif = reader.info().exif_metadata.as_deref();
    let orientation = exif.and_then(Orientation::from_exif_chunk);
    let wide = || samples.chunks_exact(2).map(|s| u16::from_be_bytes([s[0], s[1]])).collect();
    let picture = match (frame.color_type, frame.bit_depth) {
        (ColorType::Grayscale, BitDepth::Eight) => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLuma8)
        }
        (ColorType::GrayscaleAlpha, BitDepth::Eight) => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLumaA8)
        }
        (ColorType::Rgb, BitDepth::Eight) => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb8)
        }
        (ColorType::Rgba, BitDepth::Eight) => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgba8)
        }
        (ColorType::Grayscale, BitDepth::Sixteen) => {
            ImageBuffer::from_raw(width, height, wide()).map(DynamicImage::ImageLuma16)
        }
        (ColorType::GrayscaleAlpha, BitDepth::Sixteen) => {
            ImageBuffer::from_raw(width, height, wide()).map(DynamicImage::ImageLumaA16)
        }
        (ColorType::Rgb, BitDepth::Sixteen) => {
            ImageBuffer::from_raw(width, height, wide()).map(DynamicImage::ImageRgb16)
        }
        (ColorType::Rgba, BitDepth::Sixteen) => {
            ImageBuffer::from_raw(width, height, wide()).map(DynamicImage::ImageRgba16)
        }
        // Expanded to one of the above.
        _ => None,
    };
    let mut picture = picture.ok_or_else(|| damaged("pixels of another number".into()))?;
    picture.apply_orientation(orientation.unwrap_or(Orientation::NoTransforms));
    Ok(picture)
}

fn unreadable(error: DecodingError) -> Error {
    match error {
        DecodingError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            damaged("one that ends early".into())
        }
        e => Error::Unreadable { format: Format::Png, message: e.to_string() },
    }
}

fn damaged(got: String) -> Error {
    Error::Damaged { format: Format::Png, got }
}
