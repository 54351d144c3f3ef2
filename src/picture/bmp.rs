//! BMP. The decoder (`image` 0.25) cuts off runs that are too long, paints black what no run
//! brings, and takes colours beyond the palette for black: so pictures with a palette are walked
//! first.

use std::io::Cursor;

use image::DynamicImage;
use image::codecs::bmp::BmpDecoder;

use super::{Error, Format, check_size, finish, unreadable};

pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let decoder = BmpDecoder::new(Cursor::new(bytes)).map_err(|e| unreadable(Format::Bmp, e))?;
    // The header's numbers stand at the same places in all versions but the first.
    let number = |at: usize, length: usize| {
        let bytes = bytes.get(at..at + length).unwrap_or_default().iter().rev();
        bytes.fold(0, |value, byte| value << 8 | u32::from(*byte))
    };
    let is_first = number(14, 4) == 12;
    let (width, height, bits, compression, colours) = match is_first {
        true => (number(18, 2), number(20, 2), number(24, 2), 0, 0),
        false => {
            let height = (number(22, 4) as i32).unsigned_abs();
            (number(18, 4), height, number(28, 2), number(30, 4), number(46, 4))
        }
    };
    if bits <= 8 {
        check_size((width, height))?;
        let indices = Indices {
            bytes: bytes.get(number(10, 4) as usize..).unwrap_or_default(),
            width: width as usize,
            height: height as usize,
            bits: bits as usize,
            colours: if colours == 0 { 1 << bits } else { colours as usize },
        };
        match compression {
            0 => indices.check_plain()?,
            _ => indices.check_runs()?,
        }
    }
    finish(Format::Bmp, decoder)
}

/// Pixels that name a colour of the palette.
struct Indices<'a> {
    bytes: &'a [u8],
    width: usize,
    height: usize,
    bits: usize,
    colours: usize,
}

impl<'a> Indices<'a> {
    fn check_plain(&self) -> Result<(), Error> {
        let stride = (self.width * self.bits).div_ceil(32) * 4;
        // The decoder refuses what is too short.
        self.bytes
            .chunks(stride.max(1))
            .take(self.height)
            .try_for_each(|row| self.check_colours(row, self.width))
    }

    /// Whether the palette has the colours of the first `count` pixels in these bytes.
    fn check_colours(&self, bytes: &[u8], count: usize) -> Result<(), Error> {
        if self.colours >> self.bits > 0 {
            return Ok(());
        }
        let mask = (1 << self.bits) - 1;
        let in_byte = (0..8).step_by(self.bits).map(|shift| 8 - self.bits - shift);
        let indices = bytes.iter().flat_map(|byte| in_byte.clone().map(move |s| byte >> s));
        match indices.take(count).map(|i| usize::from(i) & mask).find(|i| *i >= self.colours) {
            None => Ok(()),
            Some(index) => Err(damaged(format!("colour {index} of {}", self.colours))),
        }
    }

    /// Whether the runs bring every pixel, and no more.
    fn check_runs(&self) -> Result<(), Error> {
        let mut rest = self.bytes;
        let (mut x, mut y) = (0, 0);
        loop {
            let (first, second) = (self.take(&mut rest, 1)?[0], self.take(&mut rest, 1)?[0]);
            let is_end = x == self.width;
            match (first, second) {
                (0, 1) if y == self.height || is_end && y + 1 == self.height => return Ok(()),
                (0, 1) => {
                    let got = format!("one that ends in row {y} of {}", self.height);
                    return Err(damaged(got));
                }
                (0, 0) if is_end && y < self.height => (x, y) = (0, y + 1),
                (0, 0) => {
                    let got = format!("{x} of {} pixels in row {y} of {}", self.width, self.height);
                    return Err(damaged(got));
                }
                (0, 2) => {
                    let expected = "runs for all pixels in a BMP";
                    return Err(Error::Unsupported { expected, got: "a jump over some".into() });
                }
                (0, count) => {
                    let count = usize::from(count);
                    let length = (count * self.bits).div_ceil(8);
                    let bytes = self.take(&mut rest, length.next_multiple_of(2))?;
                    self.check_colours(bytes, count)?;
                    x += count;
                }
                (count, byte) => {
                    // Its two colours by turns, in 4 bits.
                    self.check_colours(&[byte], usize::from(count).min(8 / self.bits))?;
                    x += usize::from(count);
                }
            }
            if x > self.width || y == self.height && x > 0 {
                let got = format!("a run beyond the end of row {y} of {}", self.height);
                return Err(damaged(got));
            }
        }
    }

    fn take(&self, rest: &mut &'a [u8], count: usize) -> Result<&'a [u8], Error> {
        let (taken, behind) =
            rest.split_at_checked(count).ok_or_else(|| damaged("one that ends early".into()))?;
        *rest = behind;
        Ok(taken)
    }
}

fn damaged(got: String) -> Error {
    Error::Damaged { format: Format::Bmp, got }
}
