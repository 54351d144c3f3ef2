//! Products of words, in tiles as large as registers allow, by the instructions that a CPU has for them. No crate
//! has those of narrow numbers, nor products of rows that overlap, as those of a convolution do.

use std::ops::Range;

use super::words::Numbers;

/// A product of rows and the weights of some outputs. A word is a number, two in bf16 or four of 8 bits, the first in
/// its lowest bits.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code))]
pub(super) struct Panel<'a> {
    /// `[words of a row][step]`, of which the first `width` are multiplied; those of 8 bits have a sign.
    pub weights: &'a [f32],
    pub step: usize,
    /// Outputs: 16, 32, 48 or 64.
    pub width: usize,
    /// Those of 8 bits have no sign.
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
    #[cfg_attr(not(target_arch = "x86_64"), expect(dead_code))]
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

/// The ways in which this CPU multiplies such numbers, the fastest first; none if it cannot.
pub(super) fn ways(numbers: Numbers) -> &'static [Multiply] {
    #[cfg(target_arch = "x86_64")]
    return x86::ways(numbers);
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = numbers;
        &[]
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256, __m256i, __m512, __m512bh, __m512i, _mm256_dpbusd_avx_epi32, _mm256_fmadd_ps,
        _mm256_loadu_ps, _mm256_loadu_si256, _mm256_set1_epi32, _mm256_set1_ps, _mm256_setzero_ps,
        _mm256_setzero_si256, _mm256_storeu_ps, _mm256_storeu_si256, _mm512_dpbf16_ps,
        _mm512_dpbusd_epi32, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_loadu_si512,
        _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_ps, _mm512_setzero_si512,
        _mm512_storeu_ps, _mm512_storeu_si512,
    };
    use std::mem::transmute;
    use std::sync::OnceLock;

    use super::{Multiply, Numbers, Panel};

    pub fn ways(numbers: Numbers) -> &'static [Multiply] {
        static WAYS: OnceLock<[Vec<Multiply>; 3]> = OnceLock::new();
        let [f32, bf16, int8] = WAYS.get_or_init(|| {
            let wide = is_x86_feature_detected!("avx512f");
            let [mut f32, mut bf16, mut int8]: [Vec<Multiply>; 3] = Default::default();
            // SAFETY: each runs on a CPU that has its features.
            if wide {
                f32.push(|panel, sums, stride| unsafe { wide_f32(panel, sums, stride) });
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                f32.push(|panel, sums, stride| unsafe { f32_of_256(panel, sums, stride) });
            }
            if wide && is_x86_feature_detected!("avx512bf16") {
                bf16.push(|panel, sums, stride| unsafe { wide_bf16(panel, sums, stride) });
            }
            if wide && is_x86_feature_detected!("avx512vnni") {
                int8.push(|panel, sums, stride| unsafe { wide_int8(panel, sums, stride) });
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("avxvnni") {
                int8.push(|panel, sums, stride| unsafe { int8_of_256(panel, sums, stride) });
            }
            [f32, bf16, int8]
        });
        match numbers {
            Numbers::F32 => f32,
            Numbers::Bf16 => bf16,
            Numbers::Int8 => int8,
        }
    }

    #[target_feature(enable = "avx512f")]
    unsafe fn wide_f32(panel: &Panel, sums: &mut [f32], stride: usize) {
        // SAFETY: the features are here.
        unsafe { with_32_registers::<WideF32>(panel, sums, stride) }
    }

    #[target_feature(enable = "avx2,fma")]
    unsafe fn f32_of_256(panel: &Panel, sums: &mut [f32], stride: usize) {
        // SAFETY: the features are here.
        unsafe { with_16_registers::<F32Of256>(panel, sums, stride) }
    }

    #[target_feature(enable = "avx512f,avx512bf16")]
    unsafe fn wide_bf16(panel: &Panel, sums: &mut [f32], stride: usize) {
        // SAFETY: the features are here.
        unsafe { with_32_registers::<WideBf16>(panel, sums, stride) }
    }

    #[target_feature(enable = "avx512f,avx512vnni")]
    unsafe fn wide_int8(panel: &Panel, sums: &mut [f32], stride: usize) {
        // SAFETY: the features are here.
        unsafe { with_32_registers::<WideInt8>(panel, sums, stride) }
    }

    #[target_feature(enable = "avx2,avxvnni")]
    unsafe fn int8_of_256(panel: &Panel, sums: &mut [f32], stride: usize) {
        // SAFETY: the features are here.
        unsafe { with_16_registers::<Int8Of256>(panel, sums, stride) }
    }

    // What follows is inlined into those five, and with that compiled for their features.

    /// Whether the weights and the rows are as long as the panel says.
    fn check(panel: &Panel) {
        let Panel { weights, step, width, rows, starts, .. } = *panel;
        let words = rows.pieces.len() * rows.length;
        assert!(words == 0 || weights.len() >= (words - 1) * step + width, "too few weights");
        let last = starts.iter().max().map_or(0, |start| start + rows.reach());
        assert!(rows.words.len() >= last, "a row reaches past the last word");
    }

    /// As many sums as there are registers for, and enough of them that none waits for the last product.
    ///
    /// # Safety
    /// The CPU has V's features.
    #[inline(always)]
    unsafe fn with_32_registers<V: Vector>(panel: &Panel, sums: &mut [f32], stride: usize) {
        check(panel);
        let mut row = 0;
        while row < panel.starts.len() {
            // SAFETY: the caller's.
            row += unsafe {
                match (panel.width / V::LANES, panel.starts.len() - row) {
                    (1, 7..) => tile::<V, 12, 1>(panel, row, 0, sums, stride),
                    (1, _) => tile::<V, 6, 1>(panel, row, 0, sums, stride),
                    (2, 7..) => tile::<V, 12, 2>(panel, row, 0, sums, stride),
                    (2, _) => tile::<V, 6, 2>(panel, row, 0, sums, stride),
                    (3, 5..) => tile::<V, 8, 3>(panel, row, 0, sums, stride),
                    (3, _) => tile::<V, 4, 3>(panel, row, 0, sums, stride),
                    (_, 4..) => tile::<V, 6, 4>(panel, row, 0, sums, stride),
                    (_, _) => tile::<V, 3, 4>(panel, row, 0, sums, stride),
                }
            };
        }
    }

    /// The same of half as many.
    ///
    /// # Safety
    /// The CPU has V's features.
    #[inline(always)]
    unsafe fn with_16_registers<V: Vector>(panel: &Panel, sums: &mut [f32], stride: usize) {
        check(panel);
        for output in (0..panel.width).step_by(2 * V::LANES) {
            let mut row = 0;
            while row < panel.starts.len() {
                // SAFETY: the caller's.
                row += unsafe {
                    match panel.starts.len() - row {
                        4.. => tile::<V, 6, 2>(panel, row, output, sums, stride),
                        _ => tile::<V, 3, 2>(panel, row, output, sums, stride),
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
        ($name:ident, $register:ty, $lanes:literal, [$zero:ident, $load:ident, $splat:ident, $store:ident],
            ($total:ident, $weight:ident, $x:ident) $dot:expr) => {
            #[derive(Clone, Copy)]
            struct $name($register);

            // SAFETY: the CPU has the features, and the pointers lead to as many words, as the trait asks.
            impl Vector for $name {
                const LANES: usize = $lanes;
                #[inline(always)]
                unsafe fn zero() -> Self {
                    Self(unsafe { $zero() })
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

    vector!(WideF32, __m512, 16,
        [_mm512_setzero_ps, _mm512_loadu_ps, _mm512_set1_ps, _mm512_storeu_ps],
        (total, weight, x) _mm512_fmadd_ps(weight, x, total));
    vector!(F32Of256, __m256, 8,
        [_mm256_setzero_ps, _mm256_loadu_ps, _mm256_set1_ps, _mm256_storeu_ps],
        (total, weight, x) _mm256_fmadd_ps(weight, x, total));
    vector!(WideBf16, __m512, 16,
        [_mm512_setzero_ps, _mm512_loadu_ps, _mm512_set1_ps, _mm512_storeu_ps],
        (total, weight, x) _mm512_dpbf16_ps(total, pairs(weight), pairs(x)));
    vector!(WideInt8, __m512i, 16,
        [_mm512_setzero_si512, _mm512_loadu_si512, _mm512_set1_epi32, _mm512_storeu_si512],
        (total, weight, x) _mm512_dpbusd_epi32(total, x, weight));
    vector!(Int8Of256, __m256i, 8,
        [_mm256_setzero_si256, _mm256_loadu_si256, _mm256_set1_epi32, _mm256_storeu_si256],
        (total, weight, x) _mm256_dpbusd_avx_epi32(total, x, weight));

    /// The same bits.
    #[inline(always)]
    fn pairs(words: __m512) -> __m512bh {
        // SAFETY: both are 512 bits, of which any are numbers.
        unsafe { transmute(words) }
    }
}
