//! TIFF and BigTIFF: the first page, in 8 or 16 bits a channel, unsigned.
//!
//! The crate `tiff` (version 0.11) reads the directory. Strips and tiles become pixels here, a row
//! at a time: the crate undoes differences across channels that it has dropped before, refuses
//! LZW tiles that are sound, and panics at tiles of single channels that reach below the picture.

use std::io::{self, Cursor, ErrorKind, Read};

use flate2::read::ZlibDecoder;
use image::{DynamicImage, ImageBuffer};
use tiff::TiffError;
use tiff::decoder::Decoder;
use tiff::tags::{
    ByteOrder, CompressionMethod, PhotometricInterpretation, PlanarConfiguration, Predictor,
    SampleFormat, Tag,
};
use weezl::{BitOrder, LzwStatus};

use super::{Error, Format, check_size, from_16, upright};
use crate::engine::shape::MAX_PIXELS;

/// Most bytes of all strips or tiles without compression: [`MAX_PIXELS`] of eight channels of 16
/// bits, or of four in tiles that reach beyond the picture.
const MAX_UNPACKED: u64 = MAX_PIXELS as u64 * 16;

type Tags<'a> = Decoder<Cursor<&'a [u8]>>;

pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let mut tags = Decoder::new(Cursor::new(bytes)).map_err(unreadable)?;
    let size = tags.dimensions().map_err(unreadable)?;
    check_size(size)?;
    let orientation = number(&mut tags, Tag::Orientation, 1)?;
    let orientation = upright(Format::Tiff, orientation as usize)?;
    let kind = Kind::of(&mut tags)?;
    let chunks = Chunks::of(&mut tags, &kind, size, bytes)?;
    let mut picture = kind
        .picture(size, chunks.assemble(&kind)?)
        .ok_or_else(|| damaged("pixels of another number".into()))?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

fn number(tags: &mut Tags, tag: Tag, default: u64) -> Result<u64, Error> {
    Ok(tags.find_tag_unsigned(tag).map_err(unreadable)?.unwrap_or(default))
}

fn numbers(tags: &mut Tags, tag: Tag) -> Result<Vec<u64>, Error> {
    Ok(tags.find_tag_unsigned_vec(tag).map_err(unreadable)?.unwrap_or_default())
}

/// What a pixel is, and how it is stored.
struct Kind {
    is_wide: bool,
    order: ByteOrder,
    /// Channels as stored.
    stored: usize,
    /// Of those the first ones, which are colours: 1 for grey, 3 for RGB, 4 for CMYK.
    colours: usize,
    is_inverted: bool,
    /// Each channel is stored on its own.
    is_planar: bool,
    /// Differences to the pixel on the left are stored.
    is_difference: bool,
    compression: CompressionMethod,
}

impl Kind {
    fn of(tags: &mut Tags) -> Result<Self, Error> {
        let bits = numbers(tags, Tag::BitsPerSample)?.first().copied().unwrap_or(1);
        let formats = numbers(tags, Tag::SampleFormat)?;
        for format in formats.into_iter().map(|f| SampleFormat::from_u16_exhaustive(f as u16)) {
            let sign = match format {
                SampleFormat::Uint => continue,
                SampleFormat::Int => "signed integers",
                SampleFormat::IEEEFP => "floating point numbers",
                _ => "samples of no stated kind",
            };
            return Err(unsupported(
                "8 or 16 bits unsigned in a TIFF",
                format!("{sign} of {bits} bits"),
            ));
        }
        let stored = number(tags, Tag::SamplesPerPixel, 1)?;
        let extra = numbers(tags, Tag::ExtraSamples)?.len() as u64;
        let meaning = number(tags, Tag::PhotometricInterpretation, 1)?;
        let meaning = PhotometricInterpretation::from_u16(meaning as u16);
        // Viewers take what is beyond three colours for transparency, listed as such or not.
        let (colours, is_inverted) = match meaning {
            Some(PhotometricInterpretation::BlackIsZero) if stored == extra + 1 => (1, false),
            Some(PhotometricInterpretation::WhiteIsZero) if stored == extra + 1 => (1, true),
            Some(PhotometricInterpretation::RGB) if stored >= extra + 3 => (3, false),
            Some(PhotometricInterpretation::CMYK) if stored >= extra + 4 => (4, false),
            other => {
                let got = match other {
                    Some(PhotometricInterpretation::RGBPalette) => "a palette".into(),
                    Some(
                        PhotometricInterpretation::BlackIsZero
                        | PhotometricInterpretation::WhiteIsZero,
                    ) => format!("{stored} channels"),
                    Some(other) => format!("{other:?} in {stored} channels"),
                    None => "colours of no known kind".into(),
                };
                return Err(unsupported("grey, RGB or CMYK in a TIFF", got));
            }
        };
        if !matches!(bits, 8 | 16) {
            return Err(unsupported("8 or 16 bits unsigned in a TIFF", format!("{bits} bits")));
        }
        if colours == 4 && number(tags, Tag::Unknown(332), 1)? != 1 {
            return Err(unsupported("grey, RGB or CMYK in a TIFF", "inks of other colours".into()));
        }
        if number(tags, Tag::FillOrder, 1)? != 1 {
            let got = "the lowest first".into();
            return Err(unsupported("a TIFF whose bytes have their highest bit first", got));
        }
        let compression = number(tags, Tag::Compression, 1)?;
        let compression = CompressionMethod::from_u16_exhaustive(compression as u16);
        let takes_differences = match compression {
            CompressionMethod::None | CompressionMethod::PackBits => false,
            CompressionMethod::LZW | CompressionMethod::Deflate | CompressionMethod::OldDeflate => {
                true
            }
            other => {
                let expected = "no compression, LZW, Deflate or PackBits in a TIFF";
                return Err(unsupported(expected, format!("{other:?}")));
            }
        };
        let predictor = number(tags, Tag::Predictor, 1)?;
        let is_difference = match Predictor::from_u16(predictor as u16) {
            Some(Predictor::None) => false,
            Some(Predictor::Horizontal) if takes_differences => true,
            _ => {
                let got = format!("predictor {predictor} with {compression:?}");
                let expected = "predictor 1, or 2 with LZW or Deflate, in a TIFF of integers";
                return Err(unsupported(expected, got));
            }
        };
        let planes = number(tags, Tag::PlanarConfiguration, 1)?;
        Ok(Self {
            is_wide: bits == 16,
            order: tags.byte_order(),
            stored: stored as usize,
            colours,
            is_inverted,
            is_planar: planes == u64::from(PlanarConfiguration::Planar.to_u16()),
            is_difference,
            compression,
        })
    }

    /// Bytes of a channel.
    fn width(&self) -> usize {
        1 + usize::from(self.is_wide)
    }

    /// The values of a row's bytes, of `step` channels a pixel.
    fn values(&self, row: &[u8], step: usize, values: &mut Vec<u16>) {
        values.clear();
        match (self.is_wide, self.order) {
            (false, _) => values.extend(row.iter().map(|v| u16::from(*v))),
            (true, ByteOrder::LittleEndian) => {
                values.extend(row.as_chunks().0.iter().map(|v| u16::from_le_bytes(*v)));
            }
            (true, ByteOrder::BigEndian) => {
                values.extend(row.as_chunks().0.iter().map(|v| u16::from_be_bytes(*v)));
            }
        }
        if self.is_difference {
            let mask = if self.is_wide { u16::MAX } else { 255 };
            for i in step..values.len() {
                values[i] = values[i].wrapping_add(values[i - step]) & mask;
            }
        }
    }

    /// A value in 8 bits, of which 255 is the brightest, or the most ink.
    fn sample(&self, value: u16) -> u8 {
        let sample = if self.is_wide { from_16(value) } else { value as u8 };
        if self.is_inverted { 255 - sample } else { sample }
    }

    fn picture(&self, (width, height): (u32, u32), mut samples: Vec<u8>) -> Option<DynamicImage> {
        if self.colours == 1 {
            let grey = ImageBuffer::from_raw(width, height, samples);
            return grey.map(DynamicImage::ImageLuma8);
        }
        if self.colours == 4 {
            let pixels = samples.len() / 4;
            for i in 0..pixels {
                let light = |channel: usize| 255 - u32::from(samples[4 * i + channel]);
                let rgb = [0, 1, 2].map(|c| ((light(c) * light(3) + 127) / 255) as u8);
                samples[3 * i..3 * i + 3].copy_from_slice(&rgb);
            }
            samples.truncate(3 * pixels);
        }
        ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb8)
    }
}

/// Strips or tiles.
struct Chunks<'a> {
    /// The picture's size.
    size: [usize; 2],
    /// A strip's or tile's.
    chunk: [usize; 2],
    bytes: Vec<&'a [u8]>,
}

impl<'a> Chunks<'a> {
    fn of(
        tags: &mut Tags,
        kind: &Kind,
        (width, height): (u32, u32),
        bytes: &'a [u8],
    ) -> Result<Self, Error> {
        let (chunk_width, chunk_height) = tags.chunk_dimensions();
        // A single strip may say that it has any number of rows.
        let chunk_height = match tags.get_chunk_type() {
            tiff::decoder::ChunkType::Strip => chunk_height.min(height),
            tiff::decoder::ChunkType::Tile => chunk_height,
        };
        let unpacked = |size: u32, chunk: u32| u128::from(size.div_ceil(chunk)) * u128::from(chunk);
        let unpacked = unpacked(width, chunk_width)
            * unpacked(height, chunk_height)
            * (kind.stored * kind.width()) as u128;
        if unpacked > u128::from(MAX_UNPACKED) {
            let limit = format!("{MAX_UNPACKED} bytes in a TIFF's strips or tiles");
            return Err(Error::TooLarge { limit, got: unpacked.to_string() });
        }
        let mut offsets = numbers(tags, Tag::StripOffsets)?;
        offsets.extend(numbers(tags, Tag::TileOffsets)?);
        let mut lengths = numbers(tags, Tag::StripByteCounts)?;
        lengths.extend(numbers(tags, Tag::TileByteCounts)?);
        // If they shared bytes, a small file could ask for the work of a huge one.
        let total = lengths.iter().fold(0, |total: u64, length| total.saturating_add(*length));
        if total > bytes.len() as u64 {
            return Err(damaged(format!("strips or tiles of {total} bytes in {}", bytes.len())));
        }
        let chunks = offsets.into_iter().zip(lengths).map(|(offset, length)| {
            let end = offset.checked_add(length)?;
            bytes.get(usize::try_from(offset).ok()?..usize::try_from(end).ok()?)
        });
        let chunks: Option<Vec<_>> = chunks.collect();
        Ok(Self {
            size: [width, height].map(|n| n as usize),
            chunk: [chunk_width, chunk_height].map(|n| n as usize),
            bytes: chunks.ok_or_else(|| damaged("one that ends early".into()))?,
        })
    }

    /// The colours of each pixel side by side, in 8 bits.
    fn assemble(&self, kind: &Kind) -> Result<Vec<u8>, Error> {
        let ([width, height], [chunk_width, chunk_height]) = (self.size, self.chunk);
        let (across, down) = (width.div_ceil(chunk_width), height.div_ceil(chunk_height));
        let planes = if kind.is_planar { kind.stored } else { 1 };
        if self.bytes.len() != across * down * planes {
            let got = format!("{} of {} strips or tiles", self.bytes.len(), across * down * planes);
            return Err(damaged(got));
        }
        // Channels in a chunk.
        let step = kind.stored / planes;
        let mut picture = vec![0; width * height * kind.colours];
        let mut stored = vec![0; chunk_width * step * kind.width()];
        let mut values = Vec::new();
        // Planes of what is no colour are left alone.
        let chunks = self.bytes.iter().take(across * down * planes.min(kind.colours));
        for (i, bytes) in chunks.enumerate() {
            let (plane, place) = (i / (across * down), i % (across * down));
            let (x, y) = (place % across * chunk_width, place / across * chunk_height);
            let columns = chunk_width.min(width - x);
            let mut reader = reader(kind.compression, bytes)?;
            // A tile may bring rows below the picture.
            for row in y..(y + chunk_height).min(height) {
                reader.read_exact(&mut stored).map_err(|e| match e.kind() {
                    ErrorKind::UnexpectedEof => {
                        damaged(format!("a strip or tile that ends early, in row {row}"))
                    }
                    _ => Error::Unreadable { format: Format::Tiff, message: e.to_string() },
                })?;
                kind.values(&stored, step, &mut values);
                let start = (row * width + x) * kind.colours;
                let to = &mut picture[start..start + columns * kind.colours];
                for (to, from) in to.chunks_exact_mut(kind.colours).zip(values.chunks_exact(step)) {
                    for (to, value) in to[plane..].iter_mut().zip(from) {
                        *to = kind.sample(*value);
                    }
                }
            }
        }
        Ok(picture)
    }
}

/// Reads what a strip or tile holds without its compression.
fn reader<'a>(
    compression: CompressionMethod,
    bytes: &'a [u8],
) -> Result<Box<dyn Read + 'a>, Error> {
    Ok(match compression {
        CompressionMethod::LZW => {
            // Bits in the other order, as programs before TIFF 5.0 wrote them.
            if matches!(bytes, [0, second, ..] if second & 1 == 1) {
                return Err(unsupported("LZW in a TIFF", "LZW of before TIFF 5.0".into()));
            }
            let decoder = weezl::decode::Configuration::with_tiff_size_switch(BitOrder::Msb, 8);
            Box::new(Lzw { bytes, decoder: decoder.with_yield_on_full_buffer(true).build() })
        }
        CompressionMethod::Deflate | CompressionMethod::OldDeflate => {
            Box::new(ZlibDecoder::new(bytes))
        }
        CompressionMethod::PackBits => Box::new(PackBits { bytes, run: Run::Literal(0) }),
        _ => Box::new(bytes),
    })
}

struct Lzw<'a> {
    bytes: &'a [u8],
    decoder: weezl::decode::Decoder,
}

impl Read for Lzw<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let done = self.decoder.decode_bytes(self.bytes, buffer);
            self.bytes = &self.bytes[done.consumed_in..];
            match done.status.map_err(|e| io::Error::new(ErrorKind::InvalidData, e))? {
                LzwStatus::Ok if done.consumed_out == 0 && done.consumed_in > 0 => {}
                _ => return Ok(done.consumed_out),
            }
        }
    }
}

/// Runs of bytes (TIFF 6.0, section 9).
struct PackBits<'a> {
    bytes: &'a [u8],
    run: Run,
}

enum Run {
    /// So many bytes as they stand.
    Literal(usize),
    /// One byte so many times.
    Same(u8, usize),
}

impl Read for PackBits<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match &mut self.run {
                Run::Literal(0) | Run::Same(_, 0) => {}
                Run::Literal(left) => {
                    let most = (*left).min(buffer.len());
                    let read = self.bytes.read(&mut buffer[..most])?;
                    *left -= read;
                    return Ok(read);
                }
                Run::Same(byte, left) => {
                    let written = (*left).min(buffer.len());
                    buffer[..written].fill(*byte);
                    *left -= written;
                    return Ok(written);
                }
            }
            let (run, rest) = match self.bytes {
                [length @ 0..=127, rest @ ..] => (Run::Literal(usize::from(*length) + 1), rest),
                [128, rest @ ..] => (Run::Literal(0), rest),
                [length, byte, rest @ ..] => (Run::Same(*byte, 257 - usize::from(*length)), rest),
                _ => return Ok(0),
            };
            (self.run, self.bytes) = (run, rest);
        }
    }
}

fn unreadable(error: TiffError) -> Error {
    match error {
        TiffError::IoError(e) if e.kind() == ErrorKind::UnexpectedEof => {
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
