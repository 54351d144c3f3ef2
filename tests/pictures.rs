//! Reading pictures, whole and damaged, and how their names are shown.

#[path = "support/program.rs"]
mod program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use image::{DynamicImage, GenericImageView, Rgb};
use program::{Ran, run};
use smr_gpu::picture::{self, decode, read};

fn stored(name: &str) -> Vec<u8> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/pictures").join(name);
    fs::read(file).expect("the picture")
}

#[track_caller]
fn refused(bytes: &[u8], phrase: &str) {
    let error = decode(bytes).expect_err("a bad picture").to_string();
    assert!(error.contains(phrase), "no `{phrase}` in: {error}");
}

/// Whether the pixel's channels are within JPEG's loss of the expected ones.
fn is_near(picture: &DynamicImage, x: u32, y: u32, expected: [u8; 3]) -> bool {
    let Rgb(got) = *picture.to_rgb8().get_pixel(x, y);
    got.iter().zip(expected).all(|(g, e)| g.abs_diff(e) < 24)
}

#[test]
fn other_files_are_refused_by_name() {
    for (bytes, got) in [
        (b"".as_slice(), "got an empty one"),
        (b"hello", "got something else"),
        (b"GIF89a\x01\0\x01\0\0\0\0;", "got Gif"),
        (b"\x89PNG", "got something else"),
        (b"RIFF\x1a\0\0\0WEBPVP8L", "got WebP"),
    ] {
        refused(bytes, "expected a PNG, JPEG, BMP or TIFF picture");
        refused(bytes, got);
        // The first bytes of a stream say so too.
        let error = picture::read_from(bytes).expect_err("no picture").to_string();
        assert!(error.ends_with(got), "{error}");
    }
}

#[test]
fn huge_pictures_are_refused_by_their_header() {
    // A BMP header alone: 60 000 × 60 000 in 24 bits.
    let mut bytes = b"BM\0\0\0\0\0\0\0\0\x36\0\0\0\x28\0\0\0".to_vec();
    bytes.extend(60_000_u32.to_le_bytes());
    bytes.extend(60_000_u32.to_le_bytes());
    bytes.extend([1, 0, 24, 0]);
    bytes.resize(54, 0);
    for bytes in [bytes, stored("huge.png")] {
        refused(&bytes, "expected at most 33554432 pixels, got 60000 × 60000");
    }
    let mut tiff = grey_tiff();
    tiff.set(256, 4, vec![60_000]);
    tiff.set(257, 4, vec![60_000]);
    tiff.set(278, 4, vec![60_000]);
    refused(&tiff.bytes(), "expected at most 33554432 pixels, got 60000 × 60000");
    let jpeg =
        changed(&stored("baseline.jpg"), b"\x08\0\x18\0\x28\x03", b"\x08\xff\xff\xff\xff\x03");
    refused(&jpeg, "expected at most 33554432 pixels, got 65535 × 65535");
}

/// The bytes with the one place that holds `from` changed.
fn changed(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|w| w == from).expect("the place");
    [&bytes[..at], to, &bytes[at + from.len()..]].concat()
}

#[test]
fn no_part_of_a_picture_is_one() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/pictures");
    let entries = fs::read_dir(folder).expect("the corpus");
    for file in entries.map(|e| e.expect("an entry").path()) {
        let whole = fs::read(&file).expect("the picture");
        decode(&whole).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        for end in 0..whole.len() {
            assert!(decode(&whole[..end]).is_err(), "{} to {end}", file.display());
        }
    }
}

mod png {
    use image::ImageFormat;

    use super::*;

    /// A chunk with its checksum.
    fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
        let mut crc = u32::MAX;
        for byte in kind.iter().chain(data) {
            crc ^= u32::from(*byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
            }
        }
        let length = (data.len() as u32).to_be_bytes();
        [&length, &kind[..], data, &(!crc).to_be_bytes()].concat()
    }

    fn saved(picture: DynamicImage) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut bytes, ImageFormat::Png).expect("encoded");
        bytes.into_inner()
    }

    #[test]
    fn palettes_that_are_no_triples_are_refused() {
        let whole = stored("palette.png");
        decode(&whole).expect("a picture");
        let at = whole.windows(4).position(|w| w == b"PLTE").expect("a palette") - 4;
        let length = u32::from_be_bytes(*whole[at..].first_chunk().expect("a length")) as usize;
        for cut in [1, 2] {
            let palette = chunk(b"PLTE", &whole[at + 8..at + 8 + length - cut]);
            let bytes = [&whole[..at], &palette, &whole[at + 12 + length..]].concat();
            refused(&bytes, "no multiple of 3");
        }
    }

    #[test]
    fn an_orientation_behind_the_pixels_counts() {
        let picture = image::RgbImage::from_fn(3, 2, |x, y| Rgb([x as u8 * 100, y as u8 * 100, 7]));
        let plain = saved(picture.clone().into());
        // EXIF's header, and one entry: orientation 6, to be shown turned clockwise.
        let exif = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        let exif = chunk(b"eXIf", exif);
        let end = plain.len() - 12;
        let in_front = [&plain[..33], &exif, &plain[33..]].concat();
        let behind = [&plain[..end], &exif, &plain[end..]].concat();
        let turned = DynamicImage::from(image::imageops::rotate90(&picture));
        assert_eq!(decode(&in_front).expect("a picture"), turned);
        assert_eq!(decode(&behind).expect("a picture"), turned);
        assert_eq!(decode(&plain).expect("a picture"), picture.into());
    }

    /// Orientation 8, turned clockwise to be stored, behind an entry of another kind, in both orders of bytes.
    #[test]
    fn exif_data_begin_with_either_end() {
        let picture = image::RgbImage::from_fn(3, 2, |x, y| Rgb([x as u8 * 100, y as u8 * 100, 7]));
        let plain = saved(picture.clone().into());
        let big = b"MM\0\x2a\0\0\0\x08\0\x02\x01\0\0\x03\0\0\0\x01\0\x03\0\0\
            \x01\x12\0\x03\0\0\0\x01\0\x08\0\0";
        let little = b"II\x2a\0\x08\0\0\0\x02\0\0\x01\x03\0\x01\0\0\0\x03\0\0\0\
            \x12\x01\x03\0\x01\0\0\0\x08\0\0\0";
        let turned = DynamicImage::from(image::imageops::rotate270(&picture));
        for exif in [&big[..], little] {
            let bytes = [&plain[..33], &chunk(b"eXIf", exif), &plain[33..]].concat();
            assert_eq!(decode(&bytes).expect("a picture"), turned);
        }
    }

    /// A picture with this EXIF data.
    fn with_exif(exif: &[u8]) -> Vec<u8> {
        let plain = saved(image::RgbImage::new(3, 2).into());
        [&plain[..33], &chunk(b"eXIf", exif), &plain[33..]].concat()
    }

    #[test]
    fn orientations_that_are_damaged_are_refused() {
        let exif = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        let whole = with_exif(exif);
        assert_eq!(decode(&whole).expect("a picture").dimensions(), (2, 3));
        // Wherever a byte of the chunk is damaged, the checksum tells.
        let at = whole.windows(4).position(|w| w == b"eXIf").expect("the chunk");
        for i in 0..exif.len() + 4 {
            let mut damaged = whole.clone();
            damaged[at + 4 + i] ^= 1;
            refused(&damaged, "CRC error");
        }
        // Or the writer was at fault.
        for end in 0..22 {
            refused(&with_exif(&exif[..end]), "EXIF data that cannot be read");
        }
        for (place, byte, phrase) in [
            (0, b'X', "EXIF data that cannot be read"),
            (3, 0, "EXIF data that cannot be read"),
            (7, 99, "EXIF data that cannot be read"),
            (13, 4, "an orientation that is no number"),
            (17, 2, "an orientation that is no number"),
            (19, 9, "orientation 9 of 8"),
            (18, 1, "orientation 262 of 8"),
        ] {
            let mut damaged = exif.to_vec();
            damaged[place] = byte;
            refused(&with_exif(&damaged), phrase);
        }
        // Without one, or with the one that cameras write for none, a picture stays as it is.
        for (place, byte) in [(11, 0x13), (19, 0), (9, 0)] {
            let mut other = exif.to_vec();
            other[place] = byte;
            assert_eq!(decode(&with_exif(&other)).expect("a picture").dimensions(), (3, 2));
        }
    }

    #[test]
    fn every_kind_keeps_its_samples_in_8_bits() {
        let samples = |n: usize| (0..n).map(|i| (i * 37 % 256) as u8).collect::<Vec<_>>();
        let wide = |n: usize| (0..n).map(|i| (i * 4099 % 65_536) as u16).collect::<Vec<_>>();
        let (w, h, n) = (5, 3, 15);
        let small = [
            DynamicImage::ImageLuma8(image::ImageBuffer::from_raw(w, h, samples(n)).unwrap()),
            DynamicImage::ImageLumaA8(image::ImageBuffer::from_raw(w, h, samples(2 * n)).unwrap()),
            DynamicImage::ImageRgb8(image::ImageBuffer::from_raw(w, h, samples(3 * n)).unwrap()),
            DynamicImage::ImageRgba8(image::ImageBuffer::from_raw(w, h, samples(4 * n)).unwrap()),
        ];
        let [a, b, c, d] = [1, 2, 3, 4].map(|channels| wide(channels * n));
        let wide = [
            DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(w, h, a).unwrap()),
            DynamicImage::ImageLumaA16(image::ImageBuffer::from_raw(w, h, b).unwrap()),
            DynamicImage::ImageRgb16(image::ImageBuffer::from_raw(w, h, c).unwrap()),
            DynamicImage::ImageRgba16(image::ImageBuffer::from_raw(w, h, d).unwrap()),
        ];
        let halved = [
            DynamicImage::from(wide[0].to_luma8()),
            wide[1].to_luma_alpha8().into(),
            wide[2].to_rgb8().into(),
            wide[3].to_rgba8().into(),
        ];
        let small = small.clone().into_iter().zip(small);
        for (picture, expected) in small.chain(wide.into_iter().zip(halved)) {
            let bytes = saved(picture);
            assert_eq!(decode(&bytes).expect("a picture"), expected);
            for end in 0..bytes.len() {
                decode(&bytes[..end]).expect_err("a part of a PNG");
            }
        }
    }
}

/// BMPs with a palette of 3 colours: black, red, blue.
mod bmp {
    use super::*;

    fn bmp(width: i32, height: i32, bits: u16, compression: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"BM\0\0\0\0\0\0\0\0\x42\0\0\0\x28\0\0\0".to_vec();
        bytes.extend([width.to_le_bytes(), height.to_le_bytes()].concat());
        bytes.extend([1_u16.to_le_bytes(), bits.to_le_bytes()].concat());
        bytes.extend([compression, 0, 0, 0, 3, 0].map(u32::to_le_bytes).concat());
        bytes.extend([0, 0, 0, 0, 0, 0, 255, 0, 255, 0, 0, 0]);
        [&bytes, data].concat()
    }

    const RED: [u8; 3] = [255, 0, 0];
    const BLUE: [u8; 3] = [0, 0, 255];

    #[test]
    fn runs_that_bring_every_pixel_are_read() {
        // The lower row first: four red; then one blue, as it stands three red.
        let eight = [4, 1, 0, 0, 1, 2, 0, 3, 1, 1, 1, 0, 0, 0, 0, 1];
        let four = [4, 0x11, 0, 0, 1, 0x20, 0, 3, 0x11, 0x10, 0, 0, 0, 1];
        for (bits, compression, data) in [(8, 1, &eight[..]), (4, 2, &four)] {
            let whole = bmp(4, 2, bits, compression, data);
            let picture = decode(&whole).expect("a picture").into_rgb8();
            assert_eq!(*picture, [BLUE, RED, RED, RED, RED, RED, RED, RED].concat()[..]);
            for end in 0..whole.len() {
                decode(&whole[..end]).expect_err("a part of a BMP");
            }
            // The last row's end may be left out.
            let end = whole.len() - 4;
            decode(&[&whole[..end], &[0, 1]].concat()).expect("a picture");
        }
    }

    #[test]
    fn runs_that_are_damaged_are_refused() {
        for (data, phrase) in [
            (&[5, 1, 0, 0, 4, 1, 0, 1][..], "a run beyond the end of row 0 of 2"),
            (&[3, 1, 0, 4, 1, 1, 1, 1, 0, 0, 4, 1, 0, 1], "a run beyond the end of row 0 of 2"),
            (&[4, 1, 0, 0, 4, 1, 0, 0, 1, 1, 0, 1], "a run beyond the end of row 2 of 2"),
            (&[3, 1, 0, 0, 4, 1, 0, 1], "3 of 4 pixels in row 0 of 2"),
            (&[4, 1, 0, 0, 0, 0, 0, 1], "0 of 4 pixels in row 1 of 2"),
            (&[4, 1, 0, 1], "one that ends in row 0 of 2"),
            (&[4, 1, 0, 0, 3, 1, 0, 1], "one that ends in row 1 of 2"),
            (&[4, 1, 0, 0, 4, 1, 0, 0], "one that ends early"),
            (&[4, 1, 0, 0, 0, 3, 1], "one that ends early"),
            (&[0, 2, 0, 1, 4, 1, 0, 1], "a jump over some"),
            (&[4, 1, 0, 0, 4, 3, 0, 1], "colour 3 of 3"),
            (&[4, 1, 0, 0, 0, 4, 1, 1, 1, 7, 0, 1], "colour 7 of 3"),
        ] {
            refused(&bmp(4, 2, 8, 1, data), phrase);
        }
        for (data, phrase) in [
            (&[5, 0x11, 0, 0, 4, 0x11, 0, 1][..], "a run beyond the end of row 0 of 2"),
            (&[4, 0x11, 0, 0, 2, 0x15, 2, 0x11, 0, 1], "colour 5 of 3"),
        ] {
            refused(&bmp(4, 2, 4, 2, data), phrase);
        }
    }

    #[test]
    fn colours_beyond_the_palette_are_refused() {
        let rows = [1, 1, 2, 9, 1, 1, 2, 1];
        let picture = decode(&bmp(3, 2, 8, 0, &rows)).expect("a picture").into_rgb8();
        assert_eq!(*picture, [RED, RED, BLUE, RED, RED, BLUE].concat()[..]);
        refused(&bmp(4, 2, 8, 0, &rows), "colour 9 of 3");
        refused(&bmp(3, 2, 4, 0, &[0x11, 0x20, 0, 0, 0x13, 0x20, 0, 0]), "colour 3 of 3");
        decode(&bmp(3, 2, 4, 0, &[0x11, 0x2f, 0, 0, 0x12, 0x20, 0, 0])).expect("a picture");
    }
}

/// A TIFF file put together from its entries: tag, type and values.
struct Tiff {
    is_big: bool,
    entries: Vec<(u16, u16, Vec<u32>)>,
    /// Strips or tiles.
    chunks: Vec<Vec<u8>>,
    tags_of_chunks: [u16; 2],
}

impl Tiff {
    fn set(&mut self, tag: u16, kind: u16, values: Vec<u32>) {
        self.entries.retain(|(t, ..)| *t != tag);
        self.entries.push((tag, kind, values));
    }

    /// The file, little-endian: header, strips or tiles, directory, longer values.
    fn bytes(&self) -> Vec<u8> {
        // Bytes of an offset.
        let size = if self.is_big { 8 } else { 4 };
        let number = |value: u64| value.to_le_bytes()[..size].to_vec();
        let head = if self.is_big { 16 } else { 8 };
        let mut offset = head as u32;
        let mut offsets = Vec::new();
        for chunk in &self.chunks {
            offsets.push(offset);
            offset += chunk.len() as u32;
        }
        let mut entries = self.entries.clone();
        let lengths = self.chunks.iter().map(|c| c.len() as u32).collect();
        entries
            .extend([(self.tags_of_chunks[0], 4, offsets), (self.tags_of_chunks[1], 4, lengths)]);
        entries.sort();
        let count = if self.is_big { 8 } else { 2 };
        let directory = count + entries.len() * (4 + 2 * size) + size;
        let mut long = Vec::new();
        let mut listed = (entries.len() as u64).to_le_bytes()[..count].to_vec();
        for (tag, kind, values) in entries {
            let width = if kind == 3 { 2 } else { 4 };
            let data: Vec<u8> =
                values.iter().flat_map(|v| v.to_le_bytes()[..width].to_vec()).collect();
            listed.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            listed.extend(number(values.len() as u64));
            if data.len() <= size {
                listed.extend(data.iter().chain(&[0; 8]).take(size));
            } else {
                listed.extend(number(offset as u64 + (directory + long.len()) as u64));
                long.extend(data);
            }
        }
        listed.extend(number(0));
        let mut bytes = match self.is_big {
            true => b"II\x2b\0\x08\0\0\0".to_vec(),
            false => b"II\x2a\0".to_vec(),
        };
        bytes.extend(number(offset.into()));
        bytes.extend(self.chunks.concat());
        bytes.extend(listed);
        bytes.extend(long);
        bytes
    }
}

const WIDTH: usize = 5;
const HEIGHT: usize = 7;

/// 5 × 7 pixels of `channels` bytes.
fn samples(channels: usize) -> Vec<u8> {
    (0..WIDTH * HEIGHT * channels).map(|i| (i * 37 % 251) as u8).collect()
}

fn tiff(channels: usize, photometric: u32) -> Tiff {
    Tiff {
        is_big: false,
        entries: vec![
            (256, 3, vec![WIDTH as u32]),
            (257, 3, vec![HEIGHT as u32]),
            (258, 3, vec![8; channels]),
            (259, 3, vec![1]),
            (262, 3, vec![photometric]),
            (277, 3, vec![channels as u32]),
            (278, 3, vec![HEIGHT as u32]),
        ],
        chunks: vec![samples(channels)],
        tags_of_chunks: [273, 279],
    }
}

fn grey_tiff() -> Tiff {
    tiff(1, 1)
}

fn rgb(samples: Vec<u8>) -> DynamicImage {
    let picture = image::RgbImage::from_raw(WIDTH as u32, HEIGHT as u32, samples);
    picture.expect("a picture").into()
}

#[test]
fn tiffs_of_the_listed_kinds_are_read() {
    let grey = image::GrayImage::from_raw(WIDTH as u32, HEIGHT as u32, samples(1));
    let grey = DynamicImage::from(grey.expect("a picture"));
    assert_eq!(decode(&grey_tiff().bytes()).expect("grey"), grey);
    let big = Tiff { is_big: true, ..grey_tiff() };
    assert_eq!(decode(&big.bytes()).expect("a BigTIFF"), grey);
    assert_eq!(decode(&tiff(3, 2).bytes()).expect("RGB"), rgb(samples(3)));

    let mut turned = tiff(3, 2);
    turned.set(274, 3, vec![3]);
    assert_eq!(decode(&turned.bytes()).expect("turned"), rgb(samples(3)).rotate180());

    let mut wide = grey_tiff();
    wide.set(258, 3, vec![16]);
    wide.chunks = vec![samples(2)];
    let picture = decode(&wide.bytes()).expect("16 bits");
    let rounded = |s: &[u8]| (f64::from(u16::from_le_bytes([s[0], s[1]])) / 257.0).round() as u8;
    let expected = samples(2).chunks(2).map(rounded).collect::<Vec<_>>();
    assert_eq!(picture.as_luma8().expect("grey").as_raw(), &expected);

    // Ink 0 is paper; full black, or full ink of a channel, leaves no light of it.
    let mut cmyk = tiff(4, 5);
    cmyk.chunks[0][..12].copy_from_slice(&[0, 0, 0, 0, 255, 0, 51, 0, 0, 0, 0, 255]);
    let picture = decode(&cmyk.bytes()).expect("CMYK").to_rgb8();
    assert_eq!(picture.as_raw()[..9], [255, 255, 255, 0, 255, 204, 0, 0, 0]);

    let bytes = tiff(3, 2).bytes();
    for end in 0..bytes.len() {
        decode(&bytes[..end]).expect_err("a part of a TIFF");
    }
}

#[test]
fn tiffs_in_tiles_and_planes_are_put_together() {
    let pixels = samples(3);
    // 5 × 7 pixels in tiles of 16 × 16 and of 4 × 4, whose last reach beyond the picture.
    for (tile_width, tile_height) in [(16, 16), (4, 4), (8, 4)] {
        for is_planar in [false, true] {
            let mut tiff = tiff(3, 2);
            tiff.set(284, 3, vec![1 + u32::from(is_planar)]);
            tiff.set(322, 3, vec![tile_width as u32]);
            tiff.set(323, 3, vec![tile_height as u32]);
            tiff.entries.retain(|(tag, ..)| *tag != 278);
            tiff.tags_of_chunks = [324, 325];
            tiff.chunks.clear();
            let planes: &[&[usize]] = if is_planar { &[&[0], &[1], &[2]] } else { &[&[0, 1, 2]] };
            for plane in planes {
                for top in (0..HEIGHT).step_by(tile_height) {
                    for left in (0..WIDTH).step_by(tile_width) {
                        let mut tile = Vec::new();
                        for (y, x) in (0..tile_height * tile_width)
                            .map(|i| (top + i / tile_width, left + i % tile_width))
                        {
                            let sample = |c: &usize| match y < HEIGHT && x < WIDTH {
                                true => pixels[(y * WIDTH + x) * 3 + c],
                                false => 255,
                            };
                            tile.extend(plane.iter().map(sample));
                        }
                        tiff.chunks.push(tile);
                    }
                }
            }
            let got = decode(&tiff.bytes());
            let case = format!("tiles of {tile_width} × {tile_height}, planar: {is_planar}");
            assert_eq!(got.expect(&case), rgb(pixels.clone()), "{case}");
        }
    }
    // Strips of two rows, each channel on its own.
    let mut tiff = tiff(3, 2);
    tiff.set(284, 3, vec![2]);
    tiff.set(278, 3, vec![2]);
    let plane = |c: usize| pixels.iter().skip(c).step_by(3).copied().collect::<Vec<u8>>();
    let strips = |c| plane(c).chunks(2 * WIDTH).map(<[u8]>::to_vec).collect::<Vec<_>>();
    tiff.chunks = (0..3).flat_map(strips).collect();
    assert_eq!(decode(&tiff.bytes()).expect("strips"), rgb(pixels));
}

#[test]
fn strips_that_share_bytes_are_refused() {
    let mut tiff = grey_tiff();
    tiff.set(278, 3, vec![2]);
    tiff.chunks = samples(1).chunks(2 * WIDTH).map(<[u8]>::to_vec).collect();
    let whole = tiff.bytes();
    decode(&whole).expect("strips side by side");
    let lengths = |of: [u32; 4]| of.map(u32::to_le_bytes).concat();
    let overlapping = changed(&whole, &lengths([10, 10, 10, 5]), &lengths([90; 4]));
    refused(&overlapping, "strips or tiles of 360 bytes in");
}

#[test]
fn tiffs_of_other_kinds_are_refused_by_name() {
    let with = |set: &[(u16, u32)], bytes: usize| {
        let mut tiff = grey_tiff();
        for (tag, value) in set {
            tiff.set(*tag, 3, vec![*value]);
        }
        tiff.chunks = vec![vec![0x40; WIDTH * HEIGHT * bytes]];
        tiff.bytes()
    };
    // Tag 258 is bits, 259 compression, 262 what 0 means, 339 the samples' format.
    for (set, bytes, got) in [
        (&[(258, 32)][..], 4, "got 32 bits"),
        (&[(258, 32), (339, 1)], 4, "got 32 bits"),
        (&[(258, 32), (339, 3)], 4, "got floating point numbers of 32 bits"),
        (&[(258, 16), (339, 3)], 2, "got floating point numbers of 16 bits"),
        (&[(258, 16), (339, 2)], 2, "got signed integers of 16 bits"),
        (&[(258, 8), (339, 2)], 1, "got signed integers of 8 bits"),
        (&[(258, 8), (339, 4)], 1, "got samples of no stated kind of 8 bits"),
        (&[(258, 1)], 1, "got 1 bits"),
        (&[(258, 4)], 1, "got 4 bits"),
    ] {
        let bytes = with(set, bytes);
        refused(&bytes, "expected 8 or 16 bits unsigned in a TIFF");
        refused(&bytes, got);
    }
    let mut deep = tiff(3, 2);
    deep.set(258, 3, vec![32; 3]);
    deep.chunks = vec![samples(12)];
    refused(&deep.bytes(), "expected 8 or 16 bits unsigned in a TIFF, got 32 bits");
    let mut palette = grey_tiff();
    palette.set(262, 3, vec![3]);
    palette.set(320, 3, vec![0; 768]);
    refused(&palette.bytes(), "expected grey, RGB or CMYK in a TIFF, got a palette");
    let mut pair = grey_tiff();
    pair.set(277, 3, vec![2]);
    pair.set(258, 3, vec![8; 2]);
    pair.chunks = vec![samples(2)];
    refused(&pair.bytes(), "got 2 channels");
    refused(&with(&[(259, 7)], 1), "expected no compression, LZW, Deflate or PackBits");
}

mod jpeg {
    use super::*;

    const FILES: [&str; 4] = ["baseline.jpg", "restarts.jpg", "progressive.jpg", "turned.jpg"];
    const END: [u8; 2] = [0xff, 0xd9];

    #[test]
    fn cmyk_becomes_rgb() {
        // Half magenta and yellow ink, half cyan ink: red beside cyan.
        let picture = decode(&stored("cmyk.jpg")).expect("a picture");
        assert_eq!(picture.dimensions(), (32, 16));
        assert!(is_near(&picture, 4, 8, [255, 0, 0]) && is_near(&picture, 28, 8, [0, 255, 255]));
    }

    #[test]
    fn cmyk_of_an_unknown_sign_is_refused() {
        let whole = stored("cmyk.jpg");
        let at = whole.windows(2).position(|w| w == [0xff, 0xee]).expect("Adobe's marker");
        let without = [&whole[..at], &whole[at + 16..]].concat();
        refused(&without, "expected Adobe's marker in a JPEG of four components, got none");
    }

    #[test]
    fn orientation_is_applied() {
        // Stored red beside blue, to be shown turned clockwise: red above blue.
        let picture = decode(&stored("turned.jpg")).expect("a picture");
        assert_eq!(picture.dimensions(), (16, 32));
        assert!(is_near(&picture, 8, 4, [255, 0, 0]) && is_near(&picture, 8, 28, [0, 0, 255]));
    }

    #[test]
    fn parts_are_refused() {
        for name in FILES {
            let whole = stored(name);
            assert!(whole.ends_with(&END));
            for end in 0..whole.len() {
                decode(&whole[..end]).expect_err("a part of a JPEG");
            }
            // What cameras append behind the end is no harm.
            decode(&[&whole[..], b"\xff\xda and more"].concat()).expect("a whole JPEG");
        }
    }

    #[test]
    fn parts_that_have_an_end_are_refused() {
        for name in FILES {
            let whole = stored(name);
            let scan = whole.windows(2).position(|w| w == [0xff, 0xda]).expect("a scan");
            for end in scan..whole.len() - 2 {
                let part = [&whole[..end], &END].concat();
                assert!(decode(&part).is_err(), "{name} with {end} of {} bytes", whole.len());
            }
        }
    }

    #[test]
    fn a_scan_holds_no_more_than_the_picture() {
        // A frame header that says 8 rows fewer than the scan brings.
        let lower = changed(&stored("baseline.jpg"), b"\x08\0\x18\0\x28", b"\x08\0\x10\0\x28");
        refused(&lower, "left over behind a scan");
        // Cameras that fill up with a few bytes stay readable.
        let whole = stored("baseline.jpg");
        let filled = [&whole[..whole.len() - 2], &[0; 8], &END].concat();
        assert_eq!(decode(&filled).expect("a picture"), decode(&whole).expect("a picture"));
    }

    #[test]
    fn restarts_that_are_lost_or_exchanged_are_refused() {
        let whole = stored("restarts.jpg");
        let at = |marker| whole.windows(2).position(|w| w == [0xff, marker]).expect("a restart");
        let mut exchanged = whole.clone();
        exchanged[at(0xd1) + 1] = 0xd2;
        refused(&exchanged, "without its restart marker 1");
        let lost = [&whole[..at(0xd0)], &whole[at(0xd1)..]].concat();
        refused(&lost, "without its restart marker 0");
    }

    #[test]
    fn orientations_that_are_damaged_are_refused() {
        let whole = stored("turned.jpg");
        let at = whole.windows(6).position(|w| w == b"Exif\0\0").expect("an orientation");
        for (place, byte) in [(6, b'X'), (13, 99)] {
            let mut damaged = whole.clone();
            damaged[at + place] = byte;
            refused(&damaged, "EXIF data that cannot be read");
        }
    }

    #[test]
    fn units_of_many_blocks_are_refused() {
        // 4 × 2 blocks of luma, and two of one component and one of the other.
        let luma = changed(&stored("baseline.jpg"), b"\x01\x11\0\x02\x11", b"\x01\x42\0\x02\x21");
        refused(&luma, "more than 10 blocks in a unit");
    }

    #[test]
    fn scans_are_counted() {
        // One grey block, sent bit by bit and coefficient by coefficient; all are zero.
        let scans = |count: usize| {
            let mut bytes = b"\xff\xd8\xff\xc2\0\x0b\x08\0\x08\0\x08\x01\x01\x11\0".to_vec();
            let mut quantisation = vec![0xff, 0xdb, 0, 67, 0];
            quantisation.extend([1; 64]);
            bytes.extend(quantisation);
            // Tables of one code: no difference, or the block's end.
            for class in [0x00, 0x10] {
                bytes.extend([0xff, 0xc4, 0, 20, class, 1]);
                bytes.extend([0; 16]);
            }
            let bits = (0..64).flat_map(|k| (0..14).rev().map(move |low| (k, low)));
            for (k, low) in bits.take(count) {
                let high = if low == 13 { 0 } else { low + 1 };
                bytes.extend([0xff, 0xda, 0, 8, 1, 1, 0, k, k, high << 4 | low, 0x3f]);
            }
            bytes.extend(END);
            bytes
        };
        assert_eq!(decode(&scans(14 * 4)).expect("56 scans").dimensions(), (8, 8));
        refused(&scans(14 * 4 + 1), "without some of its scans");
        refused(&scans(14 * 5), "expected at most 64 scans");
    }
}

mod paths {
    use std::fs::File;

    use super::*;

    #[track_caller]
    fn refused(path: &Path, phrase: &str) {
        let error = read(path).expect_err("no picture").to_string();
        assert!(error.contains(phrase), "no `{phrase}` in: {error}");
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_not_opened() {
        use std::os::unix::net::UnixListener;

        let folder = tempfile::tempdir().expect("a folder");
        refused(folder.path(), "expected a file, got a folder");
        // Opening it would wait for a writer.
        let pipe = folder.path().join("pipe.png");
        assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
        refused(&pipe, "expected a file, got a named pipe");
        let socket = folder.path().join("socket.png");
        let _listener = UnixListener::bind(&socket).expect("a socket");
        refused(&socket, "expected a file, got a socket");
        refused(Path::new("/dev/zero"), "expected a file, got a device");
        let link = folder.path().join("link.png");
        std::os::unix::fs::symlink("/dev/zero", &link).expect("a link");
        refused(&link, "expected a file, got a device");
    }

    #[cfg(unix)]
    #[test]
    fn pipes_that_are_open_are_read() {
        use std::io::Write;
        use std::os::fd::AsRawFd;

        let whole = stored("baseline.jpg");
        let folder = tempfile::tempdir().expect("a folder");
        let link = folder.path().join("link");
        for (i, bytes) in [&whole[..], b"neither", &whole[..300]].into_iter().enumerate() {
            let (reader, mut writer) = std::io::pipe().expect("a pipe");
            writer.write_all(bytes).expect("it holds them");
            drop(writer);
            let path = PathBuf::from(format!("/dev/fd/{}", reader.as_raw_fd()));
            // As `/dev/stdin` is one.
            std::os::unix::fs::symlink(&path, &link).expect("a link");
            let got = read(if i == 0 { &link } else { &path }).map_err(|e| e.to_string());
            assert_eq!(got, decode(bytes).map_err(|e| e.to_string()));
            fs::remove_file(&link).expect("removed");
        }
    }

    #[test]
    fn long_files_are_not_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("long.bmp");
        let make = |magic: &[u8]| {
            fs::write(&path, magic).expect("written");
            // A hole: it takes no space.
            File::options()
                .write(true)
                .open(&path)
                .expect("a file")
                .set_len(1 << 40)
                .expect("long");
        };
        make(b"some text");
        refused(&path, "expected a PNG, JPEG, BMP or TIFF picture, got something else");
        make(b"BM");
        refused(
            &path,
            &format!("expected at most {} bytes, got {}", picture::MAX_ENCODED, 1_u64 << 40),
        );
    }
}

#[cfg(unix)]
#[test]
fn odd_names_and_entries_of_a_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    let good = "fine\u{1b}[31m\nsmr-gpu: done\u{202e}.png";
    image::RgbImage::new(32, 32).save(path(good)).expect("saved");
    fs::write(path("bad\u{1b}]0;x\u{7}\n.png"), "no picture").expect("written");
    std::os::unix::fs::symlink("gone", path("broken.png")).expect("a link");
    fs::create_dir(path("folder.png")).expect("created");
    assert!(Command::new("mkfifo").arg(path("pipe.png")).status().expect("mkfifo").success());

    let Ran { stdout, stderr, .. } = run(folder.path(), &["detect", "."]).expect(1);
    let shown = r"./fine\u{1b}[31m\nsmr-gpu: done\u{202e}.png  no snaps";
    assert!(stdout.lines().any(|l| l == shown), "{stdout}");
    for line in [
        r"smr-gpu: ./bad\u{1b}]0;x\u{7}\n.png: expected a PNG, JPEG, BMP or TIFF picture, got something else",
        "smr-gpu: ./broken.png: No such file or directory (os error 2)",
        "smr-gpu: ./pipe.png: expected a file, got a named pipe",
    ] {
        assert!(stderr.lines().any(|l| l == line), "no `{line}` in:\n{stderr}");
    }
    let raw = |text: &str| text.contains(['\u{1b}', '\u{7}', '\u{202e}']);
    assert!(!raw(&stdout) && !raw(&stderr), "{stdout}{stderr}");

    // Two arguments that are nothing do not end the third; JSON has the name as it is.
    let ran = run(folder.path(), &["detect", "[", "folder.png", good, "--json"]).expect(1);
    let [record] = &ran.json()[..] else { panic!("one record: {}", ran.stdout) };
    assert_eq!(record["file"], good);

    let ran = run(folder.path(), &["detect", "--\u{202e}x"]).expect(2).tells(r"--\u{202e}x");
    assert!(!raw(&ran.stderr), "{}", ran.stderr);
}
