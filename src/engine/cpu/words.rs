//! Inputs and weights in words, rounded to the numbers that are multiplied.

use std::ops::Deref;
use std::sync::atomic::{AtomicU32, Ordering};

use super::scratch::Scratch;
use super::tiles::{SIGNED, ways};
use crate::engine::cores::each;
use crate::engine::precision::Precision;
use crate::engine::reference::vectorised;
use crate::engine::tensor::Tensor;

/// What cores multiply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Numbers {
    /// As they are, one a word.
    F32,
    /// The upper halves of f32, rounded to the nearest, ties to even.
    Bf16,
    /// Integers of 8 bits, of which a [`Scale`] says what they stand for. Weights have one for each output, a
    /// layer's rows and a convolution's map one each, by what they hold: no value is out of it.
    Int8,
}

impl Numbers {
    /// Those of a precision, where this CPU multiplies them.
    pub fn of(precision: Precision) -> Option<Self> {
        let numbers = match precision {
            Precision::F16 => return None,
            Precision::F32 => Self::F32,
            Precision::Bf16 => Self::Bf16,
            Precision::Int8 => Self::Int8,
        };
        (!ways(numbers).is_empty()).then_some(numbers)
    }

    pub fn precision(self) -> Precision {
        match self {
            Self::F32 => Precision::F32,
            Self::Bf16 => Precision::Bf16,
            Self::Int8 => Precision::Int8,
        }
    }

    /// Numbers of a word.
    pub fn a_word(self) -> usize {
        match self {
            Self::F32 => 1,
            Self::Bf16 => 2,
            Self::Int8 => 4,
        }
    }
}

/// Whether this machine's cores multiply in this precision.
pub fn multiplies(precision: Precision) -> bool {
    Numbers::of(precision).is_some()
}

/// From here on to some more f32 has whole numbers alone, so that a sum with it is rounded to one, ties to even, which
/// its lowest bits are: those of this number are 0.
pub(super) const WHOLE: f32 = 12_582_912.0;

/// What is taken from an input of 8 bits to give it a sign.
const SIGN: i16 = if SIGNED { 128 } else { 0 };

/// What a number of 8 bits stands for: `step · (number − zero)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    pub step: f32,
    pub zero: i16,
}

impl Scale {
    /// Of numbers that stand for themselves.
    const NONE: Self = Self { step: 1.0, zero: 0 };

    /// Numbers for inputs: to both sides of the middle if any of them is negative, else from the least on. Of
    /// inputs of which one is not finite, NaN.
    fn of_inputs(range: Range) -> Self {
        match range.is_negative() {
            true => Self::new(range, 127.0, 128 - SIGN),
            false => Self::new(range, 255.0, -SIGN),
        }
    }

    /// Numbers with a sign, for weights.
    fn of_weights(range: Range) -> Self {
        Self::new(range, 127.0, 0)
    }

    fn new(range: Range, most: f32, zero: i16) -> Self {
        let step = range.largest() / most;
        // What is subnormal instructions may take for zero.
        let step = if step < f32::MIN_POSITIVE { 0.0 } else { step };
        Self { step, zero }
    }

    /// The lowest 8 bits of the nearest number, ties to even.
    #[inline(always)]
    fn number(self, x: f32) -> u8 {
        let steps = if self.step == 0.0 { 0.0 } else { 1.0 / self.step };
        (x * steps + (WHOLE + f32::from(self.zero))).to_bits() as u8
    }
}

/// The largest of some numbers, by their bits.
#[derive(Clone, Copy, Debug, Default)]
struct Range {
    absolute: u32,
    /// Above 2³¹ if one is below zero.
    signed: u32,
}

impl Range {
    fn of(numbers: &[f32]) -> Self {
        let mut range = Self::default();
        vectorised(
            #[inline(always)]
            || {
                for x in numbers {
                    range.absolute = range.absolute.max(x.to_bits() << 1);
                    range.signed = range.signed.max(x.to_bits());
                }
            },
        );
        range
    }

    /// The same on all threads.
    fn of_many(numbers: &[f32]) -> Self {
        const PART: usize = 64 * 1024;
        let [absolute, signed] = [const { AtomicU32::new(0) }; 2];
        each(numbers.chunks(PART), |part| {
            let range = Self::of(part);
            absolute.fetch_max(range.absolute, Ordering::Relaxed);
            signed.fetch_max(range.signed, Ordering::Relaxed);
        });
        Self { absolute: absolute.into_inner(), signed: signed.into_inner() }
    }

    fn is_negative(self) -> bool {
        self.signed > 1 << 31
    }

    /// The largest absolute value; NaN if any number is not finite.
    fn largest(self) -> f32 {
        let largest = f32::from_bits(self.absolute >> 1);
        if largest.is_finite() { largest } else { f32::NAN }
    }
}

/// The upper half of a number, rounded.
#[inline(always)]
fn bf16(x: f32) -> u16 {
    let bits = x.to_bits();
    let rounded = bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16;
    (if x.is_nan() { bits >> 16 | 0x40 } else { rounded }) as u16
}

/// Rounds groups of so many numbers each into whole words, the last of each filled up with zeros.
#[inline(always)]
fn round(numbers: Numbers, scale: Scale, group: usize, from: &[f32], to: &mut [f32]) {
    match numbers {
        Numbers::F32 => to.copy_from_slice(from),
        Numbers::Bf16 => in_groups(2, group, (from, bytemuck::cast_slice_mut(to)), bf16),
        // A picture's, in a loop of its own.
        Numbers::Int8 if group == 3 => {
            in_groups(4, 3, (from, bytemuck::cast_slice_mut(to)), |x| scale.number(x));
        }
        Numbers::Int8 => {
            in_groups(4, group, (from, bytemuck::cast_slice_mut(to)), |x| scale.number(x));
        }
    }
}

/// [`round`] for words of so many numbers.
#[inline(always)]
fn in_groups<T: Copy>(
    a_word: usize,
    group: usize,
    (from, to): (&[f32], &mut [T]),
    rounded: impl Fn(f32) -> T,
) {
    let padded = group.next_multiple_of(a_word);
    if padded == group {
        for (to, x) in to.iter_mut().zip(from) {
            *to = rounded(*x);
        }
        return;
    }
    for (to, from) in to.chunks_exact_mut(padded).zip(from.chunks_exact(group)) {
        for (i, to) in to.iter_mut().enumerate() {
            *to = rounded(if i < group { from[i] } else { 0.0 });
        }
    }
}

/// Words that were given, or made.
pub(super) enum Words<'a> {
    Given(&'a [f32]),
    Made(Scratch),
}

impl Deref for Words<'_> {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        match self {
            Self::Given(words) => words,
            Self::Made(words) => words,
        }
    }
}

/// Inputs in words.
pub(super) struct Rounded<'a> {
    pub words: Words<'a>,
    /// One for each row, or one for all.
    pub scales: Vec<Scale>,
}

/// Rounds rows of so many inputs, each to a scale of its own, on all threads.
pub(super) fn rows(numbers: Numbers, inputs: &[f32], inner: usize) -> Rounded<'_> {
    if numbers == Numbers::F32 {
        return Rounded { words: Words::Given(inputs), scales: vec![Scale::NONE] };
    }
    let words_a_row = inner.div_ceil(numbers.a_word());
    let count = inputs.len() / inner;
    let mut words = Scratch::new(count * words_a_row);
    let mut scales = vec![Scale::NONE; count];
    let rows = words.chunks_exact_mut(words_a_row).zip(inputs.chunks_exact(inner));
    each(rows.zip(&mut scales), |((to, from), scale)| {
        if numbers == Numbers::Int8 {
            *scale = Scale::of_inputs(Range::of(from));
        }
        vectorised(
            #[inline(always)]
            || round(numbers, *scale, inner, from, to),
        );
    });
    Rounded { words: Words::Made(words), scales }
}

/// Rounds a map `[H, W, C]` to one scale, on all threads, with zeros round it: `[H + 2p, W + 2p, ⌈C / a word⌉]`.
pub(super) fn map(
    numbers: Numbers,
    map: &[f32],
    [height, width, channels]: [usize; 3],
    padding: usize,
) -> Rounded<'_> {
    if numbers == Numbers::F32 && padding == 0 {
        return Rounded { words: Words::Given(map), scales: vec![Scale::NONE] };
    }
    let scale = match numbers {
        Numbers::F32 | Numbers::Bf16 => Scale::NONE,
        Numbers::Int8 => Scale::of_inputs(Range::of_many(map)),
    };
    let zeros = match numbers {
        Numbers::F32 | Numbers::Bf16 => 0.0,
        Numbers::Int8 => f32::from_bits(u32::from(scale.zero as u8) * 0x0101_0101),
    };
    let words_a_pixel = channels.div_ceil(numbers.a_word());
    let line = (width + 2 * padding) * words_a_pixel;
    let mut words = Scratch::new((height + 2 * padding) * line);
    each(words.chunks_exact_mut(line).enumerate(), |(y, to)| {
        // Wraps below zero to a large number.
        let y = y.wrapping_sub(padding);
        if y >= height {
            to.fill(zeros);
            return;
        }
        let (left, to) = to.split_at_mut(padding * words_a_pixel);
        let (to, right) = to.split_at_mut(width * words_a_pixel);
        left.fill(zeros);
        right.fill(zeros);
        let from = &map[y * width * channels..][..width * channels];
        vectorised(
            #[inline(always)]
            || round(numbers, scale, channels, from, to),
        );
    });
    Rounded { words: Words::Made(words), scales: vec![scale] }
}

/// An output's weights, of whole words, rounded into words, and their [`Scale`].
pub(super) fn weights(numbers: Numbers, weights: &[f32], words: &mut [f32]) -> Scale {
    let scale = match numbers {
        Numbers::F32 | Numbers::Bf16 => Scale::NONE,
        Numbers::Int8 => Scale::of_weights(Range::of(weights)),
    };
    round(numbers, scale, numbers.a_word(), weights, words);
    scale
}

/// The sum of the weights in words of four.
pub(super) fn sum(words: &[f32]) -> i32 {
    bytemuck::cast_slice::<f32, i8>(words).iter().map(|weight| i32::from(*weight)).sum()
}

/// A tensor of which each group, so many numbers side by side, is rounded to 8 bits: as weights, or as inputs.
/// `None` if one is not finite.
pub(crate) fn in_8_bits(tensor: &Tensor, group: usize, is_weight: bool) -> Option<Tensor> {
    let mut data = Vec::with_capacity(tensor.data().len());
    for group in tensor.data().chunks(group.max(1)) {
        let range = Range::of(group);
        let scale = match is_weight {
            true => Scale::of_weights(range),
            false => Scale::of_inputs(range),
        };
        if scale.step.is_nan() {
            return None;
        }
        data.extend(group.iter().map(|x| {
            let number = scale.number(*x);
            let signed = is_weight || SIGNED;
            let number = if signed { i16::from(number as i8) } else { i16::from(number) };
            scale.step * f32::from(number - scale.zero)
        }));
    }
    Tensor::new(tensor.shape().clone(), data).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As they are where they have no sign.
    fn bytes(rounded: &Rounded) -> Vec<u8> {
        let words = bytemuck::cast_slice::<f32, u8>(&rounded.words);
        words.iter().map(|number| number.wrapping_add(SIGN as u8)).collect()
    }

    /// Each as the crate `half` rounds it.
    #[test]
    fn bf16_is_rounded_to_the_nearest() {
        let ties = [1.0 + 1.0 / 256.0, 1.0 + 3.0 / 256.0, -1.0 - 1.0 / 256.0 - 1e-6, f32::MAX];
        let odd = [f32::NAN, f32::from_bits(0x7f80_0001), f32::NEG_INFINITY, -0.0, 1e-40, 3.0];
        let some = (0..4000u32).map(|i| f32::from_bits(i.wrapping_mul(0x9e37_79b9)));
        let numbers: Vec<f32> = some.chain(ties).chain(odd).collect();
        let rounded = rows(Numbers::Bf16, &numbers, 5);
        let words = bytemuck::cast_slice::<f32, u16>(&rounded.words);
        for (to, from) in words.chunks_exact(6).zip(numbers.chunks_exact(5)) {
            let want = from.iter().map(|x| half::bf16::from_f32(*x).to_bits());
            assert!(to[..5].iter().copied().eq(want), "{from:?}");
            assert_eq!(to[5], 0);
        }
        // Of two as near the even one: 1, and 1 + 4/256.
        let words = rows(Numbers::Bf16, &ties[..2], 2).words;
        assert_eq!(words[0].to_bits(), 0x3f82_3f80);
    }

    /// 255 steps up to the largest, or 127 to each side; ties go to the even one.
    #[test]
    fn eight_bits_reach_to_the_largest() {
        let positive = rows(Numbers::Int8, &[0.0, 255.0, 0.5, 1.5, 2.4, -0.0], 6);
        assert_eq!(bytes(&positive), [0, 255, 0, 2, 2, 0, 0, 0]);
        assert_eq!(positive.scales, [Scale { step: 1.0, zero: -SIGN }]);
        // Two rows, each by its own largest.
        let signed = rows(Numbers::Int8, &[-254.0, 2.0, 1.0, 0.0, 0.0, 0.0], 3);
        assert_eq!(bytes(&signed), [1, 129, 128, 128, 0, 0, 0, 0]);
        assert_eq!(signed.scales[0], Scale { step: 2.0, zero: 128 - SIGN });
        assert_eq!(signed.scales[1], Scale { step: 0.0, zero: -SIGN });
        // A map of two pixels and three channels has its zeros round it.
        let map = map(Numbers::Int8, &[-127.0, 1.0, 2.0, 3.0, 4.0, 127.0], [1, 2, 3], 1);
        let zeros = [128; 4];
        let inner = [zeros, [1, 129, 130, 128], [131, 132, 255, 128], zeros];
        assert_eq!(bytes(&map), [[zeros; 4], inner, [zeros; 4]].as_flattened().as_flattened());
    }

    #[test]
    fn weights_have_a_sign() {
        let mut words = [0.0; 2];
        let scale =
            weights(Numbers::Int8, &[-1.0, 0.5, 0.25, 0.0, 1.0, 1.0, 0.0, -1.0], &mut words);
        assert_eq!(scale, Scale { step: 1.0 / 127.0, zero: 0 });
        let bytes = bytemuck::cast_slice::<f32, i8>(&words);
        assert_eq!(bytes, [-127, 64, 32, 0, 127, 127, 0, -127]);
        assert_eq!(sum(&words), 64 + 32);
    }

    /// One that is not finite spoils all of its scale, so that it shows; one too small is zero.
    #[test]
    fn odd_numbers_have_a_scale() {
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -f32::NAN] {
            let inputs = [1.0, odd, 2.0, 2.0];
            let rounded = rows(Numbers::Int8, &inputs, 2);
            assert!(rounded.scales[0].step.is_nan() && rounded.scales[1].step > 0.0, "{odd}");
        }
        let tiny = rows(Numbers::Int8, &[1e-40, -1e-38], 2);
        assert_eq!(tiny.scales[0].step, 0.0);
        assert_eq!(bytes(&tiny), [128; 4]);
        let huge = rows(Numbers::Int8, &[f32::MAX, 0.0], 2);
        assert_eq!(bytes(&huge)[0], 255);
    }
}
