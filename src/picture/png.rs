//! PNG. Read to its end, since an orientation may stand behind the pixels, and since a checksum
//! that nobody reached protects nothing.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageBuffer};
use png::{
    BitDepth, ColorType, DecodeOptions, Decoder, DecodingError, Limits, OutputInfo, Transformations,
};

use super::{Error, Format, MAX_ENCODED, check_size, from_16, orientation};

/// In 8 bits a channel.
pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let Samples { size: (width, height), frame, mut samples, orientation } = read(bytes)?;
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
    upright(picture, orientation)
}

/// In 16 bits a pixel, which it must have.
#[cfg(feature = "simulator")]
pub(super) fn decode_grey_16(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let Samples { size: (width, height), frame, samples, orientation } = read(bytes)?;
    if (frame.color_type, frame.bit_depth) != (ColorType::Grayscale, BitDepth::Sixteen) {
        let got = format!("{:?} of {} bits a channel", frame.color_type, frame.bit_depth as u8);
        return Err(Error::Unsupported { expected: super::GREY_16, got });
    }
    let samples = samples.chunks_exact(2).map(|two| u16::from_be_bytes([two[0], two[1]]));
    let picture = ImageBuffer::from_raw(width, height, samples.collect());
    upright(picture.map(DynamicImage::ImageLuma16), orientation)
}

fn upright(picture: Option<DynamicImage>, to: Orientation) -> Result<DynamicImage, Error> {
    let mut picture = picture.ok_or_else(|| damaged("pixels of another number".into()))?;
    picture.apply_orientation(to);
    Ok(picture)
}

/// A PNG's samples, each channel's big-endian.
struct Samples {
    size: (u32, u32),
    frame: OutputInfo,
    samples: Vec<u8>,
    orientation: Orientation,
}

fn read(bytes: &[u8]) -> Result<Samples, Error> {
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
    Ok(Samples { size: (width, height), frame, samples, orientation })
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
