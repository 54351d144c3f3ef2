//! PNG. Read to its end, since an orientation may stand behind the pixels, and since a checksum
//! that nobody reached protects nothing.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer};
use png::{BitDepth, ColorType, DecodeOptions, Decoder, DecodingError, Limits, Transformations};

use super::{Error, Format, MAX_ENCODED, check_size, from_16, orientation};

pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    // Limits what the decoder allocates beside the pixels: a row, chunks.
    let limits = Limits { bytes: MAX_ENCODED as usize };
    // By itself the decoder passes over an orientation whose checksum is wrong.
    let mut options = DecodeOptions::default();
    options.set_skip_ancillary_crc_failures(false);
    let mut decoder = Decoder::new_with_options(Cursor::new(bytes), options);
    decoder.set_limits(limits);
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
    let orientation = orientation(Format::Png, reader.info().exif_metadata.as_deref())?;
    if frame.bit_depth == BitDepth::Sixteen {
        // In place: there is no memory for a copy to spare.
        let count = samples.len() / 2;
        for i in 0..count {
            samples[i] = from_16(u16::from_be_bytes([samples[2 * i], samples[2 * i + 1]]));
        }
        samples.truncate(count);
        samples.shrink_to_fit();
    }
    let picture = match frame.color_type {
        ColorType::Grayscale => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLuma8)
        }
        ColorType::GrayscaleAlpha => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLumaA8)
        }
        ColorType::Rgb => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb8)
        }
        ColorType::Rgba => {
            ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgba8)
        }
        // Expanded to one of the above.
        ColorType::Indexed => None,
    };
    let mut picture = picture.ok_or_else(|| damaged("pixels of another number".into()))?;
    picture.apply_orientation(orientation);
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
