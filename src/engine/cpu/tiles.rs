//! Products of words, in tiles as large as registers allow, by the instructions that a CPU has for them. No crate
//! has those of narrow numbers, nor products of rows that overlap, as those of a convolution do.

#[cfg(target_arch = "aarch64")]
mod aarch64;
mod portable;
#[cfg(target_arch = "x86_64")]
mod x86_64;

use std::ops::Range;
use std::sync::OnceLock;

use super::words::Numbers;

/// A product of rows and the weights of some outputs. A word is a number, two in bf16 or four of 8 bits, the first in
/// its lowest bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Panel<'a> {
    /// `[words of a row][step]`, of which the first `width` are multiplied; those of 8 bits have a sign.
    pub weights: &'a [f32],
    pub step: usize,
    /// Outputs: 16, 32, 48 or 64.
    pub width: usize,
    /// Those of 8 bits have a sign if [`SIGNED`].
    pub rows: Rows<'a>,
    /// Where each row begins.
    pub starts: &'a [usize],
    /// Whether the sums are added to those that are there.
    pub add: bool,
}

/// Rows of words, each made of pieces. Those of an image under a kernel overlap.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows<'a> {
    pub words: &'a [f32],
    /// Rows of a line, of which each begins `pitch` words after the one before.
    pub line: usize,
    pub pitch: usize,
    /// Words from a line to the next.
    pub line_pitch: usize,
    /// Where a row's pieces begin, from where the row does.
    pub pieces: &'a [usize],
    /// Words of a piece.
    pub length: usize,
}

impl<'a> Rows<'a> {
    /// Rows of so many words, one after the other.
    pub fn contiguous(words: &'a [f32], length: usize) -> Self {
        Self { words, line: usize::MAX, pitch: length, line_pitch: 0, pieces: &[0], length }
    }

    /// The same rows in parts of at most so many words each, or of one piece, one part after the other.
    pub fn parts(self, most: usize) -> impl Iterator<Item = Self> {
        let length = self.length.min(most).max(1);
        let together = (most / length).max(1);
        // A piece that is too long is cut, each part of it a piece of its own.
        let cuts = self.length.div_ceil(length);
        let groups = self.pieces.chunks(if cuts > 1 { 1 } else { together });
        groups.flat_map(move |pieces| {
            (0..cuts).map(move |cut| Self {
                words: &self.words[(cut * length).min(self.words.len())..],
                pieces,
                length: length.min(self.length - cut * length),
                ..self
            })
        })
    }

    /// Where these rows begin.
    pub fn starts(&self, range: Range<usize>) -> Vec<usize> {
        let start = |row| row / self.line * self.line_pitch + row % self.line * self.pitch;
        range.map(start).collect()
    }

    /// Words from a row's start to the end of its last piece.
    fn reach(&self) -> usize {
        self.pieces.iter().max().map_or(0, |piece| piece + self.length)
    }
}

/// Multiplies: `sums[row · stride + o] = Σ weights[k · step + o] · rows[row][k]` for each row, products of 8 bits added
/// as 32 bits with a sign, as which they are written.
///
/// # Panics
/// For slices that are too short.
pub(super) type Multiply = fn(&Panel, sums: &mut [f32], stride: usize);

/// Whether inputs of 8 bits have a sign: one less 128, as NEON multiplies them, or none, as AVX does.
pub(super) const SIGNED: bool = cfg!(target_arch = "aarch64");

/// Of each kind of numbers the ways to multiply them, the fastest first.
#[derive(Debug, Default)]
struct Ways {
    f32: Vec<Multiply>,
    bf16: Vec<Multiply>,
    int8: Vec<Multiply>,
}

/// The ways in which this CPU multiplies such numbers, the fastest first; none if it cannot.
pub(super) fn ways(numbers: Numbers) -> &'static [Multiply] {
    static WAYS: OnceLock<Ways> = OnceLock::new();
    let ways = WAYS.get_or_init(|| {
        let mut ways = Ways::default();
        #[cfg(target_arch = "aarch64")]
        aarch64::add(&mut ways);
        #[cfg(target_arch = "x86_64")]
        x86_64::add(&mut ways);
        ways.f32.push(portable::multiply);
        ways
    });
    match numbers {
        Numbers::F32 => &ways.f32,
        Numbers::Bf16 => &ways.bf16,
        Numbers::Int8 => &ways.int8,
    }
}

// What follows is inlined into functions of a CPU's features, and with that compiled for them.

/// Whether the weights and the rows are as long as the panel says.
fn check(panel: &Panel) {
    let Panel { weights, step, width, rows, starts, .. } = *panel;
    let words = rows.pieces.len() * rows.length;
    assert!(words == 0 || weights.len() >= (words - 1) * step + width, "too few weights");
    let last = starts.iter().max().map_or(0, |start| start + rows.reach());
    assert!(rows.words.len() >= last, "a row reaches past the last word");
}

/// Tiles of R rows by W vectors of outputs, the last of half as many rows where those are enough.
///
/// # Safety
/// The CPU has V's features.
#[inline(always)]
unsafe fn tiles<V: Vector, const R: usize, const HALF: usize, const W: usize>(
    panel: &Panel,
    sums: &mut [f32],
    stride: usize,
) {
    check(panel);
    for output in (0..panel.width).step_by(W * V::LANES) {
        let mut row = 0;
        while row < panel.starts.len() {
            // SAFETY: the caller's.
            row += unsafe {
                match panel.starts.len() - row > HALF {
                    true => tile::<V, R, W>(panel, row, output, sums, stride),
                    false => tile::<V, HALF, W>(panel, row, output, sums, stride),
                }
            };
        }
    }
}

/// R rows from `row`, or those that are left, by W vectors of outputs: how many rows.
///
/// # Safety
/// The CPU has V's features.
#[inline(always)]
unsafe fn tile<V: Vector, const R: usize, const W: usize>(
    panel: &Panel,
    row: usize,
    output: usize,
    sums: &mut [f32],
    stride: usize,
) -> usize {
    let Panel { weights, step, width, rows, starts, .. } = *panel;
    let valid = R.min(starts.len() - row);
    assert!(output + W * V::LANES <= width && width <= step && width <= stride);
    assert!(sums.len() >= (row + valid - 1) * stride + width);
    let mut inputs = [rows.words.as_ptr(); R];
    for (r, input) in inputs.iter_mut().enumerate() {
        // Rows past the last are the last again, and their sums are left out.
        *input = input.wrapping_add(starts[row + r.min(valid - 1)]);
    }
    let mut weights = weights.as_ptr().wrapping_add(output);
    // SAFETY: the CPU has the features.
    let mut totals = [[unsafe { V::zero() }; W]; R];
    for (r, totals) in totals.iter_mut().enumerate().take(if panel.add { valid } else { 0 }) {
        let sums = sums[(row + r) * stride + output..].as_ptr();
        for (w, total) in totals.iter_mut().enumerate() {
            // SAFETY: the last row has `width` sums, by the assertion, and so has each before.
            *total = unsafe { V::load(sums.add(w * V::LANES)) };
        }
    }
    for piece in rows.pieces {
        for k in 0..rows.length {
            // SAFETY: each word of a row has weights, W vectors of them from `output`, as `check` has seen.
            let mut weight = [unsafe { V::load(weights) }; W];
            for (w, weight) in weight.iter_mut().enumerate().skip(1) {
                // SAFETY: as above.
                *weight = unsafe { V::load(weights.add(w * V::LANES)) };
            }
            for (totals, input) in totals.iter_mut().zip(inputs) {
                // SAFETY: all pieces of a row lie within the words, as `check` has seen.
                let x = unsafe { V::splat(input.add(piece + k)) };
                for (total, weight) in totals.iter_mut().zip(weight) {
                    // SAFETY: the CPU has the features.
                    *total = unsafe { V::dot(*total, weight, x) };
                }
            }
            weights = weights.wrapping_add(step);
        }
    }
    for (r, totals) in totals.iter().enumerate().take(valid) {
        let sums = sums[(row + r) * stride + output..].as_mut_ptr();
        for (w, total) in totals.iter().enumerate() {
            // SAFETY: the last row has `width` sums, by the assertion, and so has each before.
            unsafe { V::store(*total, sums.add(w * V::LANES)) };
        }
    }
    valid
}

/// Sums, and the words that are multiplied for them. All of it is for CPUs with the features of its instructions;
/// a pointer leads to as many words as there are lanes, or to the one of which all lanes are.
trait Vector: Copy {
    const LANES: usize;
    unsafe fn zero() -> Self;
    unsafe fn load(words: *const f32) -> Self;
    unsafe fn splat(word: *const f32) -> Self;
    unsafe fn dot(total: Self, weight: Self, x: Self) -> Self;
    unsafe fn store(total: Self, to: *mut f32);
}

/// A [`Vector`] of so many lanes of a register, by its instructions.
macro_rules! vector {
    ($name:ident, $register:ty, $lanes:literal, [$zero:expr, $load:ident, $splat:ident, $store:ident],
        ($total:ident, $weight:ident, $x:ident) $dot:expr) => {
        #[derive(Clone, Copy)]
        struct $name($register);

        // SAFETY: the CPU has the features, and the pointers lead to as many words, as the trait asks.
        impl Vector for $name {
            const LANES: usize = $lanes;
            #[inline(always)]
            unsafe fn zero() -> Self {
                Self(unsafe { $zero })
            }
            #[inline(always)]
            unsafe fn load(words: *const f32) -> Self {
                Self(unsafe { $load(words.cast()) })
            }
            #[inline(always)]
            unsafe fn splat(word: *const f32) -> Self {
                Self(unsafe { $splat(*word.cast()) })
            }
            #[inline(always)]
            unsafe fn dot(Self($total): Self, Self($weight): Self, Self($x): Self) -> Self {
                Self(unsafe { $dot })
            }
            #[inline(always)]
            unsafe fn store(total: Self, to: *mut f32) {
                unsafe { $store(to.cast(), total.0) }
            }
        }
    };
}
#[cfg(any(target_arch = "aarch64", target_arch = "x86_64"))]
use vector;
