//! Matrix products, and vector code for the widest registers that the CPU has.

use std::ops::Range;

use super::avx512;
use super::scratch::Scratch;
use crate::engine::cores::{each, threads};
use crate::engine::ops::bounds::{Joined, SumOrder};
pub(super) use crate::engine::reference::vectorised;

/// Products that are added up before their sum joins the others, whatever order the library takes.
const PART: usize = 512;

/// The order of [`Panels::multiply`]'s sums of `k` products, at the worst.
pub(super) fn order(k: usize) -> SumOrder {
    let (terms, parts) = (k.min(PART), k.div_ceil(PART));
    SumOrder { terms, parts, joined: Joined::InOrder, more: 0 }
}

/// The order of the sums of `k` products of [`pairs`], of which a part has as many words.
pub(super) fn order_of_pairs(k: usize) -> SumOrder {
    let words = order(k / 2);
    SumOrder { terms: 2 * words.terms, ..words }
}

/// Outputs of a panel.
const PANEL: usize = 64;
/// Fewest rows of a part where rows are shared: fewer take longer to fetch their weights than to multiply.
const LEAST_ROWS: usize = 16;

/// Weights of O outputs of K inputs, `[⌈O / PANEL⌉][K][PANEL]`, the last panel narrower.
///
/// Few rows take as long as their weights take to come from memory, and in panels those come in their order:
/// 10 rows of 12 544 inputs take 2.6 ms for 512 outputs, and 7.2 where weights lie as `[K][O]`; 100 rows
/// 15.2 and 16.9 (one core of an AMD EPYC).
#[derive(Clone, Copy, Debug)]
pub(super) struct Panels<'a> {
    weights: &'a [f32],
    outputs: usize,
    /// Inputs, or pairs of them.
    inner: usize,
    pairs: bool,
}

impl<'a> Panels<'a> {
    /// What [`Panels::fill`] packed.
    pub fn of(weights: &'a [f32], outputs: usize, inner: usize) -> Self {
        Self { weights: &weights[..outputs * inner], outputs, inner, pairs: false }
    }

    /// Of what [`Panels::fill_pairs`] packed, for rows of `inner` [`pairs`].
    pub fn of_pairs(weights: &'a [f32], outputs: usize, inner: usize) -> Self {
        Self { pairs: true, ..Self::of(weights, outputs, inner) }
    }

    /// `weight(o, k)` packed for `inner` inputs, which are even in number where they are taken in [`pairs`].
    pub fn packed(
        (outputs, inner): (usize, usize),
        pairs: bool,
        weight: impl Fn(usize, usize) -> f32,
    ) -> Vec<f32> {
        let words = if pairs { inner / 2 } else { inner };
        let mut packed = vec![0.0; outputs * words];
        match pairs {
            false => Self::fill(&mut packed, words, weight),
            true => Self::fill_pairs(&mut packed, words, weight),
        }
        packed
    }

    /// Packs `weight(o, k)` for twice `inner` inputs, in bf16.
    pub fn fill_pairs(packed: &mut [f32], inner: usize, weight: impl Fn(usize, usize) -> f32) {
        Self::fill(packed, inner, |o, k| pair(weight(o, 2 * k), weight(o, 2 * k + 1)));
    }

    /// Packs `weight(o, k)` for K = `inner` inputs.
    pub fn fill(packed: &mut [f32], inner: usize, weight: impl Fn(usize, usize) -> f32) {
        for (panel, packed) in packed.chunks_mut((PANEL * inner).max(1)).enumerate() {
            let width = packed.len() / inner;
            for (k, packed) in packed.chunks_exact_mut(width).enumerate() {
                for (i, to) in packed.iter_mut().enumerate() {
                    *to = weight(panel * PANEL + i, k);
                }
            }
        }
    }

    /// The weight of an output for an input.
    pub fn at(self, output: usize, input: usize) -> f32 {
        let first = output / PANEL * PANEL;
        let width = PANEL.min(self.outputs - first);
        self.weights[first * self.inner + input * width + output - first]
    }

    /// `dst[j · O + i] = Σ weight(i, k) · rows[j · K + k]` for N rows, on the calling thread.
    pub fn multiply(self, dst: &mut [f32], rows: &[f32], n: usize) {
        let Self { weights, outputs: o, inner: k, pairs } = self;
        assert!(dst.len() >= n * o && rows.len() >= n * k);
        if n == 0 || k == 0 {
            dst[..n * o].fill(0.0);
            return;
        }
        for (panel, weights) in weights.chunks(PANEL * k).enumerate() {
            let width = weights.len() / k;
            for first in (0..k).step_by(PART) {
                let (weights, rows) = (&weights[first * width..], &rows[first..]);
                let dst = &mut dst[panel * PANEL..];
                let length = PART.min(k - first);
                if pairs {
                    let panel = avx512::Panel { weights, width, rows, pitch: k, count: n, length };
                    avx512::multiply(&panel, dst, o, first > 0);
                    continue;
                }
                // SAFETY: the product reads weights[k' · width + i] and rows[j · K + k'] and writes
                // dst[j · O + i] for i < width, j < N, first + k' < K. Those are a panel's weights, and,
                // as panel · PANEL + width is at most O, parts of the slices that the assertion measures;
                // `dst` is borrowed mutably, so it overlaps neither.
                unsafe {
                    gemm::gemm(
                        width,
                        n,
                        length,
                        dst.as_mut_ptr(),
                        o as isize,
                        1,
                        first > 0,
                        weights.as_ptr(),
                        width as isize,
                        1,
                        rows.as_ptr(),
                        k as isize,
                        1,
                        1.0f32,
                        1.0f32,
                        false,
                        false,
                        false,
                        gemm::Parallelism::None,
                    );
                }
            }
        }
    }

    /// The same on all threads, in parts: a panel and all rows, so that each weight is read once, or where
    /// panels are too few for threads to end together, some of the rows.
    pub fn shared(self, rows: &[f32], n: usize) -> Vec<Part> {
        let panels = self.outputs.div_ceil(PANEL).max(1);
        let cuts = (4 * threads()).div_ceil(panels).min(n / LEAST_ROWS).max(1);
        let each_has = n.div_ceil(cuts).max(1);
        let mut parts: Vec<Part> = (0..self.outputs)
            .step_by(PANEL)
            .flat_map(|first| (0..n).step_by(each_has).map(move |row| (first, row)))
            .map(|(first, row)| {
                let (rows, outputs) = (row..n.min(row + each_has), PANEL.min(self.outputs - first));
                let sums = vec![0.0; rows.len() * outputs];
                Part { first, outputs, rows, sums }
            })
            .collect();
        each(parts.iter_mut(), |part| {
            let weights = &self.weights[part.first * self.inner..];
            let panel = Self::of(weights, part.outputs, self.inner);
            let rows = &rows[part.rows.start * self.inner..];
            Self { pairs: self.pairs, ..panel }.multiply(&mut part.sums, rows, part.rows.len());
        });
        parts
    }
}

/// A part of a product.
#[derive(Debug)]
pub(super) struct Part {
    /// The first output.
    pub first: usize,
    pub outputs: usize,
    pub rows: Range<usize>,
    /// `[rows][outputs]`.
    pub sums: Vec<f32>,
}

/// Two numbers in bf16, to the nearest, ties to even, as a word: the first in its low half.
#[inline(always)]
fn pair(low: f32, high: f32) -> f32 {
    let rounded = |x: f32| {
        let bits = x.to_bits();
        let number = bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16;
        if x.is_nan() { bits >> 16 | 0x40 } else { number }
    };
    f32::from_bits(rounded(low) | rounded(high) << 16)
}

/// Pairs of numbers in bf16 as words, made on all threads.
pub(super) fn pairs(numbers: &[f32]) -> Scratch {
    const PART: usize = 16 * 1024;
    let mut words = Scratch::new(numbers.len() / 2);
    each(words.chunks_mut(PART).zip(numbers.chunks(2 * PART)), |(words, numbers)| {
        vectorised(
            #[inline(always)]
            || {
                for (word, [low, high]) in words.iter_mut().zip(numbers.as_chunks::<2>().0) {
                    *word = pair(*low, *high);
                }
            },
        );
    });
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words of two numbers, each rounded as the crate `half` does.
    #[test]
    fn pairs_are_rounded_to_the_nearest() {
        let ties = [1.0 + 1.0 / 256.0, 1.0 + 3.0 / 256.0, -1.0 - 1.0 / 256.0 - 1e-6, f32::MAX];
        let odd = [f32::NAN, f32::from_bits(0x7f80_0001), f32::NEG_INFINITY, -0.0, 1e-40, 3.0];
        let some = (0..4000u32).map(|i| f32::from_bits(i.wrapping_mul(0x9e37_79b9)));
        let numbers: Vec<f32> = some.chain(ties).chain(odd).collect();
        let want = |x: f32| u32::from(half::bf16::from_f32(x).to_bits());
        for (word, [low, high]) in pairs(&numbers).iter().zip(numbers.as_chunks::<2>().0) {
            assert_eq!(word.to_bits(), want(*low) | want(*high) << 16, "{low:e} {high:e}");
        }
        // Of two as near the even one: 1, and 1 + 4/256.
        assert_eq!(pairs(&ties[..2])[0].to_bits(), 0x3f82_3f80);
    }

    /// All numbers of rows and of outputs that a tile may have, and sums of several parts, of whole numbers, so that
    /// each order of adding is exact.
    #[test]
    fn products_of_all_sizes() {
        for n in 1..=26 {
            for (o, k) in [1, 15, 17, 33, 48, 64, 70].map(|o| (o, 2 + 2 * ((37 * n * o) % 700))) {
                let weight = |o: usize, k: usize| ((o * 7 + k * 13) % 11) as f32 - 5.0;
                let mut packed = vec![f32::NAN; o * k];
                Panels::fill(&mut packed, k, weight);
                let mut in_pairs = vec![f32::NAN; o * k / 2];
                Panels::fill_pairs(&mut in_pairs, k / 2, weight);
                let rows: Vec<f32> = (0..n * k).map(|i| (i % 9) as f32 - 4.0).collect();
                let mut sums = vec![vec![f32::NAN; n * o]];
                Panels::of(&packed, o, k).multiply(&mut sums[0], &rows, n);
                if avx512::multiplies_bf16() {
                    sums.push(vec![f32::NAN; n * o]);
                    Panels::of_pairs(&in_pairs, o, k / 2).multiply(&mut sums[1], &pairs(&rows), n);
                }
                for i in 0..n * o {
                    let want: f32 = (0..k).map(|k2| weight(i % o, k2) * rows[i / o * k + k2]).sum();
                    for sums in &sums {
                        assert_eq!(sums[i], want, "{n} rows, {o} outputs of {k}: {i}");
                    }
                }
            }
        }
    }

    /// 66 outputs of three inputs, output o of input k being 10 o + k: 64 in a panel, and two.
    #[test]
    fn weights_lie_in_panels() {
        let mut packed = vec![f32::NAN; 66 * 3];
        Panels::fill(&mut packed, 3, |o, k| (10 * o + k) as f32);
        assert_eq!(packed[..2], [0.0, 10.0]);
        assert_eq!(packed[64..66], [1.0, 11.0]);
        assert_eq!(packed[192..], [640.0, 650.0, 641.0, 651.0, 642.0, 652.0]);
        let panels = Panels::of(&packed, 66, 3);
        assert_eq!([panels.at(63, 2), panels.at(64, 0), panels.at(65, 1)], [632.0, 640.0, 651.0]);

        // Two rows: the sum of an output's weights, and its first.
        let rows = [1.0, 1.0, 1.0, 1.0, 0.0, 0.0];
        let want = |row: usize, o: usize| if row == 0 { 30 * o + 3 } else { 10 * o } as f32;
        let mut sums = vec![f32::NAN; 2 * 66];
        panels.multiply(&mut sums, &rows, 2);
        assert!((0..2 * 66).all(|i| sums[i] == want(i / 66, i % 66)), "{sums:?}");
        for Part { first, outputs, rows, sums } in panels.shared(&rows, 2) {
            assert_eq!(rows, 0..2);
            assert!((0..2 * outputs).all(|i| sums[i] == want(i / outputs, first + i % outputs)));
        }
    }

    /// Whatever the number of threads, each sum is in one part.
    #[test]
    fn parts_cover_each_sum_once() {
        for (n, o) in [(0, 5), (1, 3), (23, 70), (100, 192), (400, 96), (100, 512)] {
            let mut packed = vec![0.0; o * 3];
            Panels::fill(&mut packed, 3, |o, k| (10 * o + k) as f32);
            let rows: Vec<f32> = (0..n * 3).map(|i| (i % 7) as f32).collect();
            let panels = Panels::of(&packed, o, 3);
            let mut all = vec![f32::NAN; n * o];
            panels.multiply(&mut all, &rows, n);
            let mut seen = 0;
            for Part { first, outputs, rows, sums } in panels.shared(&rows, n) {
                seen += sums.len();
                for (row, sums) in rows.zip(sums.chunks_exact(outputs)) {
                    assert_eq!(sums, &all[row * o + first..][..outputs], "{n} × {o}");
                }
            }
            assert_eq!(seen, n * o);
        }
    }
}
