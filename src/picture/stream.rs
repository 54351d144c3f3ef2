//! Pictures that follow one another in a stream, as programs write them into a pipe.
//!
//! PNG, JPEG (so Motion JPEG too) and BMP say where they end. A TIFF does not: it goes on to the end of the
//! stream.

use std::io::Read;

use super::{Error, Format, MAGIC, MAX_ENCODED, too_long};

/// Bytes asked of the stream at a time.
const CHUNK: usize = 1 << 18;
/// As many bytes as show that a PNG or a JPEG begins.
const START: usize = 8;

/// The pictures of a stream, each as it is stored.
///
/// An error that is not of one picture alone, of the system or of [`MAX_ENCODED`] bytes without an end, is the
/// last item. Bytes that belong to no picture are one error, [`Error::Unknown`], and the next picture comes
/// after it. At most [`MAX_ENCODED`] bytes are kept.
#[derive(Debug)]
pub struct Pictures<R> {
    reader: R,
    /// What was read and belongs to no earlier picture.
    buffer: Vec<u8>,
    has_ended: bool,
    has_begun: bool,
}

impl<R: Read> Pictures<R> {
    /// Those of a stream from here on.
    pub fn new(reader: R) -> Self {
        Self { reader, buffer: Vec::new(), has_ended: false, has_begun: false }
    }

    /// Reads until so many bytes are there; whether they are.
    fn has(&mut self, count: usize) -> Result<bool, Error> {
        while self.buffer.len() < count && !self.has_ended {
            if self.buffer.len() as u64 > MAX_ENCODED {
                return Err(too_long());
            }
            let before = self.buffer.len();
            // The system may have less to give, and a camera's picture must not wait for the next.
            self.buffer.resize(before + CHUNK, 0);
            let read = self.reader.read(&mut self.buffer[before..]);
            self.buffer.truncate(before + read.as_ref().map_or(0, |read| *read));
            match read {
                Ok(read) => self.has_ended = read == 0,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e.into()),
            }
        }
        Ok(self.buffer.len() >= count)
    }

    fn take(&mut self, count: usize) -> Vec<u8> {
        let rest = self.buffer.split_off(count.min(self.buffer.len()));
        std::mem::replace(&mut self.buffer, rest)
    }

    fn read_next(&mut self) -> Result<Option<Vec<u8>>, Error> {
        self.has(MAGIC as usize)?;
        let had_begun = std::mem::replace(&mut self.has_begun, true);
        if self.buffer.is_empty() {
            // Of a stream without a byte, decoding says so.
            return Ok((!had_begun).then(Vec::new));
        }
        let end = match Format::of(&self.buffer) {
            Ok(Format::Png) => self.end_of_png()?,
            Ok(Format::Jpeg) => self.end_of_jpeg()?,
            Ok(Format::Bmp) => self.end_of_bmp()?,
            Ok(Format::Tiff) => self.end_of_stream()?,
            Err(error) => return Err(self.pass_over(error)?),
        };
        Ok(Some(self.take(end)))
    }

    /// Leaves out what belongs to no picture; the error that says so.
    fn pass_over(&mut self, error: Error) -> Result<Error, Error> {
        let mut passed = 0;
        loop {
            let found = start(&self.buffer);
            let known = self.buffer.len().saturating_sub(START - 1);
            let gone = found.unwrap_or(if self.has_ended { self.buffer.len() } else { known });
            self.buffer.drain(..gone);
            passed += gone as u64;
            if found.is_some() || self.has_ended {
                break;
            }
            if passed > MAX_ENCODED {
                self.has_ended = true;
                self.buffer.clear();
                break;
            }
            self.has(self.buffer.len() + 1)?;
        }
        Ok(match error {
            Error::Unknown(got) if passed > 0 => Error::Unknown(format!("{passed} bytes of {got}")),
            error => error,
        })
    }

    /// Behind the chunk that ends a PNG; where a chunk cannot be one, before the next picture.
    fn end_of_png(&mut self) -> Result<usize, Error> {
        let mut at = 8;
        while self.has(at + 8)? {
            let header = &self.buffer[at..at + 8];
            let (length, kind) = header.split_at(4);
            let length = length.iter().fold(0, |value, byte| value << 8 | u64::from(*byte));
            if !kind.iter().all(u8::is_ascii_alphabetic) || length > MAX_ENCODED {
                return self.before_next(START);
            }
            let is_last = kind == b"IEND";
            // With its checksum.
            let end = at + 12 + length as usize;
            if is_last {
                self.has(end)?;
                return Ok(end);
            }
            at = end;
        }
        self.before_next(START)
    }

    /// Behind the marker that ends a JPEG; before one that begins the next.
    fn end_of_jpeg(&mut self) -> Result<usize, Error> {
        let mut at = 2;
        while self.has(at + 2)? {
            let rest = &self.buffer[at..];
            let found = rest.windows(2).position(|w| w[0] == 0xff && !matches!(w[1], 0 | 0xff));
            let Some(found) = found else {
                at = self.buffer.len() - 1;
                continue;
            };
            let marker = rest[found + 1];
            at += found;
            match marker {
                0xd8 => return Ok(at),
                0xd9 => return Ok(at + 2),
                0xd0..=0xd7 | 0x01 => at += 2,
                _ if self.has(at + 4)? => {
                    let length = u16::from_be_bytes([self.buffer[at + 2], self.buffer[at + 3]]);
                    at += 2 + usize::from(length);
                }
                _ => break,
            }
        }
        self.before_next(2)
    }

    /// As its header says; to the end of the stream where that says nothing.
    fn end_of_bmp(&mut self) -> Result<usize, Error> {
        let length = u32::from_le_bytes([2, 3, 4, 5].map(|i| self.buffer.get(i).map_or(0, |b| *b)));
        match length {
            0..26 => self.end_of_stream(),
            length if u64::from(length) > MAX_ENCODED => Err(too_long()),
            length => {
                self.has(length as usize)?;
                Ok(length as usize)
            }
        }
    }

    fn end_of_stream(&mut self) -> Result<usize, Error> {
        while self.has(self.buffer.len() + 1)? {}
        Ok(self.buffer.len())
    }

    /// Where the next picture begins after the first `from` bytes: this one is damaged.
    fn before_next(&mut self, mut from: usize) -> Result<usize, Error> {
        loop {
            if let Some(found) = self.buffer.get(from..).and_then(start) {
                return Ok(from + found);
            }
            from = from.max(self.buffer.len().saturating_sub(START - 1));
            if !self.has(self.buffer.len() + 1)? {
                return Ok(self.buffer.len());
            }
        }
    }
}

/// Where a PNG or a JPEG seems to begin.
fn start(bytes: &[u8]) -> Option<usize> {
    bytes.windows(START).position(|w| {
        // Of a JPEG also the marker of its first segment, lest compressed bytes look like one.
        w.starts_with(b"\x89PNG\r\n\x1a\n")
            || w.starts_with(&[0xff, 0xd8, 0xff])
                && matches!(w[3], 0xc0..=0xc4 | 0xdb..=0xef | 0xfe)
    })
}

impl<R: Read> Iterator for Pictures<R> {
    type Item = Result<Vec<u8>, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.read_next().transpose();
        if let Some(Err(Error::Io(_) | Error::TooLarge { .. })) = next {
            self.has_ended = true;
            self.buffer.clear();
        }
        next
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use image::{ImageFormat, RgbImage};

    use super::*;

    fn stored(format: ImageFormat, width: u32) -> Vec<u8> {
        let picture = RgbImage::from_fn(width, 20, |x, y| {
            image::Rgb([x * x * 7 + y, y * y * 3, x * y].map(|v| v as u8))
        });
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).expect("encoded");
        bytes.into_inner()
    }

    /// A stream that gives few bytes at a time.
    struct Drops<'a>(&'a [u8], usize);

    impl Read for Drops<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            let count = self.1.min(self.0.len()).min(buffer.len());
            buffer[..count].copy_from_slice(&self.0[..count]);
            self.0 = &self.0[count..];
            Ok(count)
        }
    }

    fn items(bytes: &[u8], drops: usize) -> Vec<Result<Vec<u8>, String>> {
        Pictures::new(Drops(bytes, drops)).map(|item| item.map_err(|e| e.to_string())).collect()
    }

    fn lengths(items: &[Result<Vec<u8>, String>]) -> Vec<Result<usize, &String>> {
        items.iter().map(|item| item.as_ref().map(Vec::len)).collect()
    }

    #[test]
    fn pictures_of_each_kind_end_where_the_next_begins() {
        let [png, jpeg] = [ImageFormat::Png, ImageFormat::Jpeg].map(|kind| stored(kind, 31));
        // What a TIFF holds is no matter here.
        let (bmp, tiff) = (stored(ImageFormat::Bmp, 17), [&b"II*\0"[..], &png].concat());
        let all = [&png, &jpeg, &jpeg, &bmp, &png, &bmp, &jpeg, &tiff].map(|p| p.clone());
        for drops in [1, 7, 1000, usize::MAX] {
            let got = items(&all.concat(), drops);
            assert!(got == all.clone().map(Ok), "{drops} bytes at a time: {:?}", lengths(&got));
        }
    }

    #[test]
    fn what_is_damaged_ends_before_the_next() {
        let [png, jpeg] = [ImageFormat::Png, ImageFormat::Jpeg].map(|kind| stored(kind, 31));
        let unknown =
            |got: &str| Err(format!("expected a PNG, JPEG, BMP or TIFF picture, got {got}"));
        for drops in [1, 1000] {
            // A JPEG within its last scan: its tables say how long they are.
            for (half, next) in
                [(&png[..90], &png), (&png[..90], &jpeg), (&jpeg[..jpeg.len() - 20], &jpeg)]
            {
                let half = half.to_vec();
                let got = items(&[&half, next, next].map(|p| &p[..]).concat(), drops);
                assert!(got == [half, next.clone(), next.clone()].map(Ok), "{:?}", lengths(&got));
            }
            let garbage = b"no picture at all, but BMX".to_vec();
            let got =
                items(&[&garbage, &png, &garbage, &jpeg, &garbage].map(|p| &p[..]).concat(), drops);
            let told = unknown("26 bytes of something else");
            assert_eq!(got, [told.clone(), Ok(png.clone()), told.clone(), Ok(jpeg.clone()), told]);
            assert_eq!(items(b"", drops), [Ok(vec![])]);
        }
        // A length that no PNG has.
        let mut long = png.clone();
        long[8..12].copy_from_slice(&[0xff; 4]);
        assert_eq!(items(&[&long[..], &png].concat(), 1000), [Ok(long), Ok(png)]);
    }

    #[test]
    fn streams_without_an_end_are_given_up() {
        let limit = format!("expected at most {MAX_ENCODED} bytes, got more");
        let ends = |magic: &'static [u8]| -> Vec<String> {
            let stream = magic.chain(std::io::repeat(0));
            Pictures::new(stream).map(|item| item.expect_err("no end").to_string()).collect()
        };
        assert_eq!(ends(b"\xff\xd8\xff\xe0"), std::slice::from_ref(&limit));
        assert_eq!(ends(b"BM\xff\xff\xff\xff"), [limit]);
        let [told] = &ends(b"")[..] else { panic!("one error") };
        assert!(told.ends_with(" bytes of something else"), "{told}");
    }

    /// A picture is there when its last byte is.
    #[test]
    fn no_picture_waits_for_the_next() {
        struct Then<'a>(&'a [u8]);
        impl Read for Then<'_> {
            fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
                assert!(!self.0.is_empty(), "it read on");
                let count = self.0.len().min(buffer.len());
                buffer[..count].copy_from_slice(&self.0[..count]);
                self.0 = &self.0[count..];
                Ok(count)
            }
        }
        for kind in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Bmp] {
            let bytes = stored(kind, 9);
            let first = Pictures::new(Then(&bytes)).next().expect("one").expect("whole");
            assert_eq!(first, bytes);
        }
    }
}
