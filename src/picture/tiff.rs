//! TIFF and BigTIFF: the first page, in 8 or 16 bits a channel, unsigned.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageBuffer};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{
    CompressionMethod, PhotometricInterpretation, PlanarConfiguration, SampleFormat, Tag,
};
use tiff::{ColorType, TiffError};

use super::{Error, Format, MAX_ENCODED, check_size};
use crate::model::MAX_PIXELS;

pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(unreadable)?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_PIXELS * 8;
    limits.intermediate_buffer_size = MAX_ENCODED as usize;
    let size = decoder.dimensions().map_err(unreadable)?;
    check_size(size)?;
    let kind = Kind::of(&mut decoder)?;
    check_chunks(&mut decoder, bytes.len() as u64)?;
    let orientation = decoder.find_tag(Tag::Orientation).map_err(unreadable)?;
    let orientation = orientation.and_then(|o| o.into_u16().ok()).and_then(|o| o.try_into().ok());
    let orientation = orientation.and_then(Orientation::from_exif);
    let mut decoder = decoder.with_limits(limits);
    let mut picture = match kind.bits {
        8 => kind.picture8(size, assemble(&mut decoder, size, &kind, samples8)?),
        _ => kind.picture16(size, assemble(&mut decoder, size, &kind, samples16)?),
    }
    .ok_or_else(|| damaged("pixels of another number".into()))?;
    picture.apply_orientation(orientation.unwrap_or(Orientation::NoTransforms));
    Ok(picture)
}

/// Refuses strips or tiles that share bytes: a small file could ask for the work of a huge one.
fn check_chunks(decoder: &mut Decoder<Cursor<&[u8]>>, length: u64) -> Result<(), Error> {
    for tag in [Tag::StripByteCounts, Tag::TileByteCounts] {
        let counts = decoder.find_tag_unsigned_vec(tag).map_err(unreadable)?.unwrap_or_default();
        let total = counts.iter().fold(0, |total: u64, count| total.saturating_add(*count));
        if total > length {
            return Err(damaged(format!("strips or tiles of {total} bytes in {length}")));
        }
    }
    Ok(())
}

/// What a pixel is.
struct Kind {
    /// 8 or 16.
    bits: u8,
    /// 1 for grey, 3 and 4 for RGB without and with transparency, 4 and 5 for CMYK likewise.
    channels: usize,
    is_cmyk: bool,
    /// Each channel is stored on its own.
    is_planar: bool,
}

impl Kind {
    fn of(decoder: &mut Decoder<Cursor<&[u8]>>) -> Result<Self, Error> {
        let meaning = decoder.find_tag_unsigned(Tag::PhotometricInterpretation);
        if meaning.map_err(unreadable)? == Some(PhotometricInterpretation::RGBPalette.to_u16()) {
            return Err(unsupported("grey, RGB or CMYK in a TIFF", "a palette".into()));
        }
        let colour = decoder.colortype().map_err(unreadable)?;
        let formats = decoder.find_tag_unsigned_vec(Tag::SampleFormat).map_err(unreadable)?;
        for format in formats.unwrap_or_default().into_iter().map(SampleFormat::from_u16_exhaustive)
        {
            let sign = match format {
                SampleFormat::Uint => continue,
                SampleFormat::Int => "signed integers",
                SampleFormat::IEEEFP => "floating point numbers",
                _ => "samples of no stated kind",
            };
            let got = format!("{sign} of {} bits", colour.bit_depth());
            return Err(unsupported("8 or 16 bits unsigned in a TIFF", got));
        }
        let bits = colour.bit_depth();
        if !matches!(bits, 8 | 16) {
            let got = format!("{bits} bits");
            return Err(unsupported("8 or 16 bits unsigned in a TIFF", got));
        }
        if !matches!(
            colour,
            ColorType::Gray(_)
                | ColorType::RGB(_)
                | ColorType::RGBA(_)
                | ColorType::CMYK(_)
                | ColorType::CMYKA(_)
        ) {
            let got = match colour {
                ColorType::Multiband { num_samples, .. } => format!("{num_samples} channels"),
                other => format!("{other:?}"),
            };
            return Err(unsupported("grey, RGB or CMYK in a TIFF", got));
        }
        let compression = decoder.find_tag_unsigned(Tag::Compression).map_err(unreadable)?;
        let compression = CompressionMethod::from_u16_exhaustive(compression.unwrap_or(1));
        if !matches!(
            compression,
            CompressionMethod::None
                | CompressionMethod::LZW
                | CompressionMethod::Deflate
                | CompressionMethod::OldDeflate
                | CompressionMethod::PackBits
        ) {
            let got = format!("{compression:?}");
            return Err(unsupported("no compression, LZW, Deflate or PackBits in a TIFF", got));
        }
        let planes = decoder.find_tag_unsigned(Tag::PlanarConfiguration).map_err(unreadable)?;
        Ok(Self {
            bits,
            channels: colour.num_samples().into(),
            is_cmyk: matches!(colour, ColorType::CMYK(_) | ColorType::CMYKA(_)),
            is_planar: planes == Some(PlanarConfiguration::Planar.to_u16()),
        })
    }

    fn picture8(&self, (width, height): (u32, u32), samples: Vec<u8>) -> Option<DynamicImage> {
        if self.is_cmyk {
            let rgb = samples.chunks_exact(self.channels).flat_map(|ink| {
                let light = |i: usize| 255 - u32::from(ink[i]);
                [0, 1, 2].map(|i| ((light(i) * light(3) + 127) / 255) as u8)
            });
            let rgb = ImageBuffer::from_raw(width, height, rgb.collect());
            return rgb.map(DynamicImage::ImageRgb8);
        }
        match self.channels {
            1 => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLuma8),
            3 => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb8),
            _ => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgba8),
        }
    }

    fn picture16(&self, (width, height): (u32, u32), samples: Vec<u16>) -> Option<DynamicImage> {
        if self.is_cmyk {
            let rgb = samples.chunks_exact(self.channels).flat_map(|ink| {
                let light = |i: usize| 65_535 - u64::from(ink[i]);
                [0, 1, 2].map(|i| ((light(i) * light(3) + 32_767) / 65_535) as u16)
            });
            let rgb = ImageBuffer::from_raw(width, height, rgb.collect());
            return rgb.map(DynamicImage::ImageRgb16);
        }
        match self.channels {
            1 => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLuma16),
            3 => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb16),
            _ => ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgba16),
        }
    }
}

fn samples8(result: DecodingResult) -> Option<Vec<u8>> {
    match result {
        DecodingResult::U8(samples) => Some(samples),
        _ => None,
    }
}

fn samples16(result: DecodingResult) -> Option<Vec<u16>> {
    match result {
        DecodingResult::U16(samples) => Some(samples),
        _ => None,
    }
}

/// The channels of each pixel side by side, from strips or tiles of all or of single channels.
///
/// The decoder's own reading of whole pictures (version 0.11) panics at tiles of single channels
/// whose last row is partly below the picture.
fn assemble<T: Copy + Default>(
    decoder: &mut Decoder<Cursor<&[u8]>>,
    (width, height): (u32, u32),
    kind: &Kind,
    samples: fn(DecodingResult) -> Option<Vec<T>>,
) -> Result<Vec<T>, Error> {
    let (width, height) = (width as usize, height as usize);
    let (chunk_width, chunk_height) = decoder.chunk_dimensions();
    let (chunk_width, chunk_height) = (chunk_width as usize, chunk_height as usize);
    let (across, down) = (width.div_ceil(chunk_width), height.div_ceil(chunk_height));
    let planes = if kind.is_planar { kind.channels } else { 1 };
    // Channels in a chunk.
    let step = kind.channels / planes;
    let mut picture = vec![T::default(); width * height * kind.channels];
    for chunk in 0..across * down * planes {
        let (plane, place) = (chunk / (across * down), chunk % (across * down));
        let (x, y) = (place % across * chunk_width, place / across * chunk_height);
        let read = decoder.read_chunk(chunk as u32).map_err(unreadable)?;
        let short = || damaged(format!("a strip or tile of too few samples at {x}, {y}"));
        let read = samples(read).ok_or_else(short)?;
        let columns = chunk_width.min(width - x);
        // A tile may bring rows below the picture.
        let rows = chunk_height.min(height - y);
        if read.len() < columns * rows * step {
            return Err(short());
        }
        for (row, from) in read.chunks_exact(columns * step).take(rows).enumerate() {
            let start = ((y + row) * width + x) * kind.channels;
            let to = &mut picture[start..start + columns * kind.channels];
            for (to, from) in to.chunks_exact_mut(kind.channels).zip(from.chunks_exact(step)) {
                to[plane..plane + step].copy_from_slice(from);
            }
        }
    }
    Ok(picture)
}

fn unreadable(error: TiffError) -> Error {
    match error {
        TiffError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            damaged("one that ends early".into())
        }
        e => Error::Unreadable { format: Format::Tiff, message: e.to_string() },
    }
}

fn unsupported(expected: &'static str, got: String) -> Error {
    Error::Unsupported { expected, got }
}

fn damaged(got: String) -> Error {
    Error::Damaged { format: Format::Tiff, got }
}
