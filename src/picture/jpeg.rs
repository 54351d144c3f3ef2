//! JPEG: 8 bits, Huffman-coded, sequential or progressive (ITU-T T.81).
//!
//! It has no checksum, and decoders paint grey what is missing. Here every scan must bring every
//! block and end where its data does. No decoder in Rust (zune-jpeg 0.5, jpeg-decoder 0.3) gives
//! the right pixels where a sequential file has a scan for each component, or where chroma is
//! sampled finer than luma: each gives another picture without an error. So the blocks, which are
//! read anyway, become pixels here ([`pixels`]).

mod pixels;
mod tables;

use image::DynamicImage;

use self::pixels::Plane;
use super::{Error, Format, check_size, orientation};

/// Most scans of a progressive JPEG; encoders use about ten.
pub const MAX_SCANS: usize = 64;
/// Most bytes between a scan's last block and the next marker: some cameras fill up there.
const MAX_SURPLUS: usize = 16;

/// Most blocks in a unit of an interleaved scan (T.81, B.2.3).
const MAX_BLOCKS: usize = 10;

/// The coefficients of a block, in zigzag order.
type Block = [i16; 64];

pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, Error> {
    let mut walk = Walk::new(bytes);
    walk.run()?;
    let orientation = orientation(Format::Jpeg, walk.exif)?;
    let colour = walk.colour()?;
    let frame = walk.frame.take().ok_or_else(|| damaged("one without a frame"))?;
    let size = (frame.width, frame.height);
    let planes = frame.components.into_iter().map(Component::into_plane).collect();
    let mut picture =
        pixels::picture(size, planes, colour).ok_or_else(|| damaged("pixels of another number"))?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// What the components are.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Colour {
    Grey,
    Rgb,
    YCbCr,
    /// Inverted, as Adobe writes it: 255 is no ink.
    Cmyk,
    /// YCbCr of inverted C, M and Y, and inverted K.
    Ycck,
}

/// A component of the frame.
struct Component {
    id: u8,
    /// Blocks of 8 × 8 samples in a unit of an interleaved scan, across and down.
    across: usize,
    down: usize,
    /// Blocks that hold the component's samples: the units of a scan of its own.
    columns: usize,
    rows: usize,
    /// The lowest bit sent of each coefficient, in zigzag order; [`NEVER`] before its first scan.
    lowest_bit: [u8; 64],
    /// Which quantisation table is the component's.
    table: usize,
    /// That table as it was at the component's first scan.
    steps: Option<[u16; 64]>,
    /// The mean of the last block, of which the next brings the difference.
    mean: i16,
    plane: Plane,
    /// In a progressive frame, all blocks, as the plane has them.
    blocks: Vec<Block>,
}

const NEVER: u8 = u8::MAX;

struct Frame {
    is_progressive: bool,
    width: u16,
    height: u16,
    /// Units of an interleaved scan, across and down.
    columns: usize,
    rows: usize,
    components: Vec<Component>,
}

/// A component's part in a scan.
struct Part {
    component: usize,
    dc: usize,
    ac: usize,
}

/// What coefficients a scan brings.
struct Band {
    start: u8,
    end: u8,
    /// The lowest bit sent before, 0 in a first scan.
    high: u8,
    low: u8,
}

/// A walk over the segments and scans (ITU-T T.81).
struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
    frame: Option<Frame>,
    dc: [Option<Table>; 4],
    ac: [Option<Table>; 4],
    /// Quantisation steps in zigzag order.
    steps: [Option<[u16; 64]>; 4],
    /// Units between restart markers; 0 for none.
    restart: usize,
    is_jfif: bool,
    /// The transform that Adobe's marker names.
    adobe: Option<u8>,
    exif: Option<&'a [u8]>,
    scans: usize,
}

impl<'a> Walk<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            // Behind the start-of-image marker.
            at: 2,
            frame: None,
            dc: Default::default(),
            ac: Default::default(),
            steps: [None; 4],
            restart: 0,
            is_jfif: false,
            adobe: None,
            exif: None,
            scans: 0,
        }
    }

    /// Walks to the end-of-image marker.
    fn run(&mut self) -> Result<(), Error> {
        loop {
            match self.marker()? {
                0xd9 => return self.check_end(),
                // Restart markers that some encoders write behind a scan, and a reserved one.
                0xd0..=0xd7 | 0x01 => {}
                0xd8 => return Err(damaged("a second beginning")),
                0xc0..=0xc2 if self.frame.is_some() => return Err(damaged("a second frame")),
                marker @ 0xc0..=0xc2 => {
                    let segment = self.segment()?;
                    self.frame = Some(self.frame_of(segment, marker == 0xc2)?);
                }
                0xc4 => {
                    let segment = self.segment()?;
                    self.tables(segment)?;
                }
                0xc3 | 0xc5..=0xcf => {
                    return Err(unsupported(
                        "a Huffman-coded JPEG",
                        "a lossless or arithmetic one",
                    ));
                }
                0xda => self.scan()?,
                0xdb => {
                    let segment = self.segment()?;
                    self.quantisation(segment)?;
                }
                0xdc => return Err(unsupported("a JPEG with its height in front", "one behind")),
                0xdd => {
                    let segment = self.segment()?;
                    let interval = segment.try_into().map(u16::from_be_bytes);
                    self.restart = interval.map_err(|_| damaged("a bad restart interval"))?.into();
                }
                0xe0 => self.is_jfif |= self.segment()?.starts_with(b"JFIF\0"),
                0xe1 => {
                    let exif = self.segment()?.strip_prefix(b"Exif\0\0");
                    self.exif = self.exif.or(exif);
                }
                0xee => {
                    let segment = self.segment()?;
                    if let (true, Some(transform)) =
                        (segment.starts_with(b"Adobe"), segment.get(11))
                    {
                        self.adobe = Some(*transform);
                    }
                }
                _ => {
                    self.segment()?;
                }
            }
        }
    }

    /// The next marker; what lies before it is passed over, as decoders do.
    fn marker(&mut self) -> Result<u8, Error> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let found = rest.windows(2).position(|w| w[0] == 0xff && !matches!(w[1], 0 | 0xff));
        let found = found.ok_or_else(|| damaged("one without its end"))?;
        self.at += found + 2;
        Ok(rest[found + 1])
    }

    /// The contents of the segment behind a marker.
    fn segment(&mut self) -> Result<&'a [u8], Error> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let length = rest.first_chunk().map(|l| usize::from(u16::from_be_bytes(*l)));
        let segment = length.and_then(|length| rest.get(2..length));
        let segment = segment.ok_or_else(|| damaged("one without its end"))?;
        self.at += 2 + segment.len();
        Ok(segment)
    }

    fn frame_of(&self, segment: &[u8], is_progressive: bool) -> Result<Frame, Error> {
        let &[bits, h1, h0, w1, w0, count, ref listed @ ..] = segment else {
            return Err(damaged("a bad frame header"));
        };
        if bits != 8 {
            let got = format!("{bits} bits");
            return Err(Error::Unsupported { expected: "8 bits in a JPEG", got });
        }
        if !matches!(count, 1 | 3 | 4) {
            let got = format!("{count} components");
            return Err(Error::Unsupported { expected: "grey, colour or CMYK in a JPEG", got });
        }
        let [width, height] = [[w1, w0], [h1, h0]].map(u16::from_be_bytes);
        check_size((width.into(), height.into()))?;
        let factors = |c: &[u8]| [usize::from(c[1] >> 4), usize::from(c[1] & 15)];
        let (listed, []) = listed.as_chunks::<3>() else {
            return Err(damaged("a bad frame header"));
        };
        let in_range = |c: &[u8; 3]| factors(c).iter().all(|f| (1..=4).contains(f));
        if width == 0
            || height == 0
            || listed.len() != usize::from(count)
            || !listed.iter().all(in_range)
        {
            return Err(damaged("a bad frame header"));
        }
        for [id, _, table] in listed {
            if *table > 3 || listed.iter().filter(|c| c[0] == *id).count() > 1 {
                return Err(damaged("a bad frame header"));
            }
        }
        let most = |i: usize| listed.iter().map(|c| factors(c)[i]).max().unwrap_or(1);
        let [most_across, most_down] = [most(0), most(1)];
        if let Some(c) = listed.iter().find(|c| {
            !most_across.is_multiple_of(factors(*c)[0]) || !most_down.is_multiple_of(factors(*c)[1])
        }) {
            let [across, down] = factors(c);
            let got = format!("{across} × {down} beside {most_across} × {most_down}");
            let expected = "components of a JPEG sampled a whole number of times coarser";
            return Err(Error::Unsupported { expected, got });
        }
        let columns = usize::from(width).div_ceil(8 * most_across);
        let rows = usize::from(height).div_ceil(8 * most_down);
        let component = |c: &[u8; 3]| {
            let [across, down] = factors(c);
            let samples =
                |size: u16, factor: usize, most: usize| (usize::from(size) * factor).div_ceil(most);
            let plane = Plane {
                width: samples(width, across, most_across),
                height: samples(height, down, most_down),
                columns: columns * across,
                across: most_across / across,
                down: most_down / down,
                samples: Vec::new(),
            };
            Component {
                id: c[0],
                across,
                down,
                columns: plane.width.div_ceil(8),
                rows: plane.height.div_ceil(8),
                lowest_bit: [NEVER; 64],
                table: c[2].into(),
                steps: None,
                mean: 0,
                plane,
                blocks: Vec::new(),
            }
        };
        Ok(Frame {
            is_progressive,
            width,
            height,
            columns,
            rows,
            components: listed.iter().map(component).collect(),
        })
    }

    fn tables(&mut self, mut segment: &[u8]) -> Result<(), Error> {
        while let [id, rest @ ..] = segment {
            let (table, rest) = Table::new(rest).ok_or_else(|| damaged("a bad Huffman table"))?;
            let tables = if id >> 4 == 0 { &mut self.dc } else { &mut self.ac };
            let slot = tables.get_mut(usize::from(id & 15)).filter(|_| id >> 4 < 2);
            *slot.ok_or_else(|| damaged("a bad Huffman table"))? = Some(table);
            segment = rest;
        }
        Ok(())
    }

    fn quantisation(&mut self, mut segment: &[u8]) -> Result<(), Error> {
        let bad = || damaged("a bad quantisation table");
        while let [id, rest @ ..] = segment {
            let (wide, slot) = (usize::from(id >> 4), usize::from(id & 15));
            let (values, rest) = rest.split_at_checked(64 * (wide + 1)).ok_or_else(bad)?;
            let steps = std::array::from_fn(|k| match wide {
                0 => values[k].into(),
                _ => u16::from_be_bytes([values[2 * k], values[2 * k + 1]]),
            });
            let slot = self.steps.get_mut(slot).filter(|_| wide < 2 && !steps.contains(&0));
            *slot.ok_or_else(bad)? = Some(steps);
            segment = rest;
        }
        Ok(())
    }

    /// What the components are, by the rules of libjpeg.
    fn colour(&self) -> Result<Colour, Error> {
        let components = self.frame.as_ref().map(|f| &f.components[..]).unwrap_or_default();
        let ids: Vec<u8> = components.iter().map(|c| c.id).collect();
        Ok(match (components.len(), self.is_jfif, self.adobe) {
            (1, ..) => Colour::Grey,
            (3, true, _) => Colour::YCbCr,
            (3, _, Some(0)) => Colour::Rgb,
            (3, _, None) if ids == *b"RGB" => Colour::Rgb,
            (3, ..) => Colour::YCbCr,
            (_, _, Some(0)) => Colour::Cmyk,
            (_, _, Some(_)) => Colour::Ycck,
            // With the marker 255 is no ink. Without it that is anybody's guess.
            (_, _, None) => {
                return Err(unsupported("Adobe's marker in a JPEG of four components", "none"));
            }
        })
    }

    /// Walks a scan, from its header to the marker behind it.
    fn scan(&mut self) -> Result<(), Error> {
        let header = || damaged("a bad scan header");
        let segment = self.segment()?;
        let frame = self.frame.as_mut().ok_or_else(header)?;
        self.scans += 1;
        if self.scans > MAX_SCANS {
            let limit = format!("{MAX_SCANS} scans");
            return Err(Error::TooLarge { limit, got: "more".into() });
        }
        let [_, listed @ .., start, end, bits] = segment else { return Err(header()) };
        let (listed, []) = listed.as_chunks::<2>() else { return Err(header()) };
        let mut parts = Vec::new();
        for &[id, tables] in listed {
            let component = frame.components.iter().position(|c| c.id == id);
            let component = component.ok_or_else(header)?;
            if parts.iter().any(|p: &Part| p.component == component) {
                return Err(header());
            }
            parts.push(Part { component, dc: (tables >> 4).into(), ac: (tables & 15).into() });
        }
        if parts.is_empty() || segment[0] != listed.len() as u8 {
            return Err(header());
        }
        let band = match frame.is_progressive {
            // What the header says has no meaning in a sequential frame.
            false => Band { start: 0, end: 63, high: 0, low: 0 },
            true => Band { start: *start, end: *end, high: bits >> 4, low: bits & 15 },
        };
        let is_dc = frame.is_progressive && band.start == 0;
        if band.end > 63
            || band.start > band.end
            || is_dc && band.end > 0
            || frame.is_progressive && !is_dc && parts.len() > 1
        {
            return Err(header());
        }
        for part in &parts {
            let component = &mut frame.components[part.component];
            component.note(&band)?;
            if component.steps.is_none() {
                let steps = self.steps[component.table];
                component.steps =
                    Some(steps.ok_or_else(|| damaged("one without its quantisation"))?);
                component.allocate(frame.rows, frame.is_progressive);
            }
            component.mean = 0;
            if !frame.is_progressive {
                // Cameras that send Motion JPEG leave the usual tables out.
                tables::fill(&mut self.dc, &mut self.ac, part.dc, part.ac);
            }
        }
        let blocks =
            |p: &Part| frame.components[p.component].across * frame.components[p.component].down;
        if parts.len() > 1 && parts.iter().map(blocks).sum::<usize>() > MAX_BLOCKS {
            return Err(damaged("a scan with more than 10 blocks in a unit"));
        }
        let mut coder = Coder {
            bits: Bits { bytes: self.bytes, at: self.at, buffer: 0, count: 0 },
            dc: &self.dc,
            ac: &self.ac,
            is_progressive: frame.is_progressive,
            band,
            ends: 0,
        };
        let (columns, rows) = match &parts[..] {
            [one] => {
                let component = &frame.components[one.component];
                (component.columns, component.rows)
            }
            _ => (frame.columns, frame.rows),
        };
        let units = columns * rows;
        for unit in 0..units {
            if self.restart > 0 && unit > 0 && unit % self.restart == 0 {
                coder.restart(unit / self.restart - 1)?;
                frame.components.iter_mut().for_each(|c| c.mean = 0);
            }
            let at = [unit % columns, unit / columns];
            let coded = match &parts[..] {
                [one] => coder.block(one, &mut frame.components[one.component], at),
                _ => coder.unit(&parts, &mut frame.components, at),
            };
            coded.map_err(|fault| match fault {
                Fault::Missing => {
                    let row = unit / columns;
                    damaged(&format!("one whose data ends in block row {row} of {rows}"))
                }
                Fault::Code => damaged("one with a code that does not exist"),
                Fault::Table => damaged("one without its Huffman tables"),
            })?;
        }
        self.at = coder.end()?;
        Ok(())
    }

    /// Whether the scans brought every component.
    fn check_end(&self) -> Result<(), Error> {
        let frame = self.frame.as_ref().ok_or_else(|| damaged("one without a frame"))?;
        // A coefficient that no scan brings is zero, but its lower bits always follow the higher.
        let is_whole = |c: &Component| {
            c.lowest_bit[0] == 0 && c.lowest_bit.iter().all(|bit| matches!(*bit, 0 | NEVER))
        };
        match frame.components.iter().all(is_whole) {
            true => Ok(()),
            false => Err(damaged("one without some of its scans")),
        }
    }
}

impl Component {
    /// Notes that a scan brings these coefficients' bits, which must be the next ones.
    fn note(&mut self, band: &Band) -> Result<(), Error> {
        let before = if band.high == 0 { NEVER } else { band.high };
        for bit in &mut self.lowest_bit[band.start.into()..=band.end.into()] {
            if *bit != before || band.high != 0 && band.low + 1 != band.high {
                return Err(damaged("scans that do not follow one another"));
            }
            *bit = band.low;
        }
        Ok(())
    }

    /// Makes room for the samples of a frame with so many rows of units.
    fn allocate(&mut self, rows: usize, is_progressive: bool) {
        let blocks = self.plane.columns * rows * self.down;
        match is_progressive {
            true => self.blocks = vec![[0; 64]; blocks],
            false => self.plane.samples = vec![0; blocks * 64],
        }
    }

    /// Stores a whole block of a sequential frame.
    fn store(&mut self, block: &Block, at: [usize; 2]) {
        if let Some(steps) = &self.steps {
            self.plane.store(block, steps, at);
        }
    }

    fn into_plane(mut self) -> Plane {
        if let Some(steps) = self.steps.filter(|_| !self.blocks.is_empty()) {
            self.plane.samples = vec![0; self.blocks.len() * 64];
            for (i, block) in self.blocks.iter().enumerate() {
                let at = [i % self.plane.columns, i / self.plane.columns];
                self.plane.store(block, &steps, at);
            }
        }
        self.plane
    }
}

/// Why a block cannot be walked.
enum Fault {
    /// The data ends.
    Missing,
    /// No code begins like this, or it leads out of the block.
    Code,
    /// The scan names a table that was not given.
    Table,
}

/// Walks entropy-coded blocks.
struct Coder<'a> {
    bits: Bits<'a>,
    dc: &'a [Option<Table>; 4],
    ac: &'a [Option<Table>; 4],
    is_progressive: bool,
    band: Band,
    /// Blocks to come of which the band ends at once.
    ends: u32,
}

impl Coder<'_> {
    /// A unit of several components.
    fn unit(
        &mut self,
        parts: &[Part],
        components: &mut [Component],
        [x, y]: [usize; 2],
    ) -> Result<(), Fault> {
        for part in parts {
            let component = &mut components[part.component];
            let (across, down) = (component.across, component.down);
            for i in 0..across * down {
                let at = [x * across + i % across, y * down + i / across];
                self.block(part, component, at)?;
            }
        }
        Ok(())
    }

    fn block(
        &mut self,
        part: &Part,
        component: &mut Component,
        at @ [x, y]: [usize; 2],
    ) -> Result<(), Fault> {
        if !self.is_progressive {
            let mut block = [0; 64];
            component.mean = component.mean.wrapping_add(self.dc(part)?);
            block[0] = component.mean;
            self.first(part, 1, &mut block)?;
            component.store(&block, at);
            return Ok(());
        }
        let block = &mut component.blocks[y * component.plane.columns + x];
        match (self.band.start, self.band.high) {
            (0, 0) => {
                component.mean = component.mean.wrapping_add(self.dc(part)?);
                block[0] = component.mean.wrapping_shl(self.band.low.into());
            }
            (0, _) => block[0] |= (self.bits.take(1)? << self.band.low) as i16,
            (start, 0) if self.ends == 0 => self.first(part, start.into(), block)?,
            (_, 0) => self.ends -= 1,
            _ => self.refine(part, block)?,
        }
        Ok(())
    }

    /// The difference of a block's mean.
    fn dc(&mut self, part: &Part) -> Result<i16, Fault> {
        let length = self.bits.symbol(self.dc, part.dc)?;
        if length > 15 {
            return Err(Fault::Code);
        }
        self.bits.signed(length.into())
    }

    /// Coefficients from `k` on that come for the first time.
    fn first(&mut self, part: &Part, mut k: u32, block: &mut Block) -> Result<(), Fault> {
        let end = self.band.end.into();
        while k <= end {
            let code = self.bits.symbol(self.ac, part.ac)?;
            let (zeros, length) = (u32::from(code >> 4), u32::from(code & 15));
            match (zeros, length) {
                (15, 0) => k += 16,
                (0, 0) => break,
                (_, 0) if self.is_progressive => {
                    self.ends = (1 << zeros) - 1 + self.bits.take(zeros)?;
                    break;
                }
                (_, 0) => return Err(Fault::Code),
                _ => {
                    k += zeros;
                    if k > end {
                        return Err(Fault::Code);
                    }
                    block[k as usize] =
                        self.bits.signed(length)?.wrapping_shl(self.band.low.into());
                    k += 1;
                }
            }
        }
        Ok(())
    }

    /// One bit more of coefficients that came before, and new ones of that size.
    fn refine(&mut self, part: &Part, block: &mut Block) -> Result<(), Fault> {
        let (mut k, end) = (usize::from(self.band.start), usize::from(self.band.end));
        let bit = 1_i16.wrapping_shl(self.band.low.into());
        while self.ends == 0 && k <= end {
            let code = self.bits.symbol(self.ac, part.ac)?;
            let (mut zeros, length) = (u32::from(code >> 4), u32::from(code & 15));
            let mut new = 0;
            match length {
                0 if zeros < 15 => {
                    self.ends = (1 << zeros) + self.bits.take(zeros)?;
                    break;
                }
                0 => {}
                1 => new = if self.bits.take(1)? == 1 { bit } else { bit.wrapping_neg() },
                _ => return Err(Fault::Code),
            }
            // Over as many zeros, with a bit for each that is none.
            while k <= end {
                if block[k] != 0 {
                    self.refine_one(&mut block[k], bit)?;
                } else if zeros == 0 {
                    break;
                } else {
                    zeros -= 1;
                }
                k += 1;
            }
            if new != 0 {
                *block.get_mut(k).filter(|_| k <= end).ok_or(Fault::Code)? = new;
            }
            k += 1;
        }
        if self.ends > 0 {
            self.ends -= 1;
            for coefficient in block.iter_mut().take(end + 1).skip(k).filter(|c| **c != 0) {
                self.refine_one(coefficient, bit)?;
            }
        }
        Ok(())
    }

    fn refine_one(&mut self, coefficient: &mut i16, bit: i16) -> Result<(), Fault> {
        if self.bits.take(1)? == 1 {
            *coefficient = coefficient.wrapping_add(bit.wrapping_mul(coefficient.signum()));
        }
        Ok(())
    }

    /// Passes the restart marker with this number.
    fn restart(&mut self, number: usize) -> Result<(), Error> {
        let at = self.end()?;
        if self.bits.bytes.get(at + 1) != Some(&(0xd0 + (number % 8) as u8)) {
            return Err(damaged(&format!("one without its restart marker {number}")));
        }
        self.bits.at = at + 2;
        self.bits.count = 0;
        Ok(())
    }

    /// Where the marker behind the data begins, if the data ends there.
    fn end(&self) -> Result<usize, Error> {
        if self.ends > 0 {
            return Err(damaged("one whose data ends in a run of blocks"));
        }
        let rest = &self.bits.bytes[self.bits.at..];
        let marker = rest.windows(2).position(|w| w[0] == 0xff && !matches!(w[1], 0 | 0xff));
        let marker = marker.ok_or_else(|| damaged("one without its end"))?;
        let surplus = marker + self.bits.count as usize / 8;
        match surplus <= MAX_SURPLUS {
            true => Ok(self.bits.at + marker),
            false => Err(damaged(&format!("one with {surplus} bytes left over behind a scan"))),
        }
    }
}

/// Entropy-coded data, bit by bit, to the next marker.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The next `count` bits, at the low end.
    buffer: u64,
    count: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 56 {
            let byte = match self.bytes.get(self.at..).unwrap_or_default() {
                [0xff, 0, ..] => {
                    self.at += 1;
                    0xff
                }
                [0xff, ..] | [] => return,
                [byte, ..] => *byte,
            };
            self.at += 1;
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// The next `n` bits, at most 16.
    fn take(&mut self, n: u32) -> Result<u32, Fault> {
        self.skip(n)?;
        Ok((self.buffer >> self.count) as u32 & ((1 << n) - 1))
    }

    /// A number of `length` bits, at most 15, of which the first says the sign (T.81, F.2.2.1).
    fn signed(&mut self, length: u32) -> Result<i16, Fault> {
        let value = self.take(length)? as i32;
        let is_negative = length > 0 && value >> (length - 1) == 0;
        Ok((value - if is_negative { (1 << length) - 1 } else { 0 }) as i16)
    }

    /// Passes `n` bits, at most 32.
    fn skip(&mut self, n: u32) -> Result<(), Fault> {
        if self.count < n {
            self.fill();
        }
        self.count = self.count.checked_sub(n).ok_or(Fault::Missing)?;
        Ok(())
    }

    /// The next symbol by one of the tables.
    fn symbol(&mut self, tables: &[Option<Table>; 4], which: usize) -> Result<u8, Fault> {
        let table = tables.get(which).and_then(Option::as_ref).ok_or(Fault::Table)?;
        if self.count < 16 {
            self.fill();
        }
        // Past the end, zeros.
        let next = match self.count {
            0..16 => self.buffer << (16 - self.count),
            _ => self.buffer >> (self.count - 16),
        } as u16;
        match table.symbol(next) {
            Some((length, symbol)) => self.skip(length).map(|()| symbol),
            None if self.count < 16 => Err(Fault::Missing),
            None => Err(Fault::Code),
        }
    }
}

/// A Huffman table.
struct Table {
    /// For the next 8 bits: length and symbol, or length 0 where the code is longer.
    short: [(u8, u8); 256],
    /// For each length up to 16: behind the last code of that length, aligned to 16 bits.
    behind: [u32; 17],
    /// What to add to a code's number within its length for its symbol's place.
    offset: [i32; 17],
    symbols: Vec<u8>,
}

impl Table {
    /// A table, and the bytes behind it.
    fn new(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (counts, rest) = bytes.split_first_chunk::<16>()?;
        let total = counts.iter().map(|c| usize::from(*c)).sum();
        let (symbols, rest) = rest.split_at_checked(total)?;
        let mut table = Self {
            short: [(0, 0); 256],
            behind: [0; 17],
            offset: [0; 17],
            symbols: symbols.to_vec(),
        };
        let (mut code, mut place) = (0_u32, 0_usize);
        for (length, count) in (1_u32..).zip(counts) {
            table.offset[length as usize] = place as i32 - code as i32;
            for _ in 0..*count {
                if code >= 1 << length {
                    return None;
                }
                if length <= 8 {
                    let first = (code << (8 - length)) as usize;
                    let same = &mut table.short[first..first + (1 << (8 - length))];
                    same.fill((length as u8, symbols[place]));
                }
                code += 1;
                place += 1;
            }
            table.behind[length as usize] = code << (16 - length);
            code <<= 1;
        }
        Some((table, rest))
    }

    /// Length and symbol of the code that begins these 16 bits.
    fn symbol(&self, next: u16) -> Option<(u32, u8)> {
        if let (length @ 1.., symbol) = self.short[usize::from(next >> 8)] {
            return Some((length.into(), symbol));
        }
        let length = (9..=16).find(|l| u32::from(next) < self.behind[*l as usize])?;
        let place = i32::from(next >> (16 - length)) + self.offset[length as usize];
        self.symbols.get(place as usize).map(|symbol| (length, *symbol))
    }
}

fn damaged(got: &str) -> Error {
    Error::Damaged { format: Format::Jpeg, got: got.into() }
}

fn unsupported(expected: &'static str, got: &str) -> Error {
    Error::Unsupported { expected, got: got.into() }
}
