//! Matrix products, and vector code for the widest registers that the CPU has.

use crate::engine::cores::each;
use crate::engine::ops::bounds::{Joined, SumOrder};
pub(super) use crate::engine::reference::vectorised;

/// Products that are added up before their sum joins the others, whatever order the library takes.
const PART: usize = 512;

/// The order of [`Panels::multiply`]'s sums of `k` products, at the worst.
pub(super) fn order(k: usize) -> SumOrder {
    let (terms, parts) = (k.min(PART), k.div_ceil(PART));
    SumOrder { terms, parts, joined: Joined::InOrder, more: 0 }
}

/// Outputs of a panel.
const PANEL: usize = 64;

/// Weights of O outputs of K inputs, `[⌈O / PANEL⌉][K][PANEL]`, the last panel narrower.
///
/// Few rows take as long as their weights take to come from memory, and in panels those come in their order:
/// 10 rows of 12 544 inputs take 2.6 ms for 512 outputs, and 7.2 where weights lie as `[K][O]`; 100 rows
/// 15.2 and 16.9 (one core of an AMD EPYC).
#[derive(Clone, Copy, Debug)]
pub(super) struct Panels<'a> {
    weights: &'a [f32],
    outputs: usize,
    inner: usize,
}

impl<'a> Panels<'a> {
    /// What [`Panels::fill`] packed.
    pub fn of(weights: &'a [f32], outputs: usize, inner: usize) -> Self {
        Self { weights: &weights[..outputs * inner], outputs, inner }
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
        let Self { weights, outputs: o, inner: k } = self;
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
                // SAFETY: the product reads weights[k' · width + i] and rows[j · K + k'] and writes
                // dst[j · O + i] for i < width, j < N, first + k' < K. Those are a panel's weights, and,
                // as panel · PANEL + width is at most O, parts of the slices that the assertion measures;
                // `dst` is borrowed mutably, so it overlaps neither.
                unsafe {
                    gemm::gemm(
                        width,
                        n,
                        PART.min(k - first),
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

    /// The same on all threads, a panel at a time, so that each weight is read once: the first output
    /// of each panel, and its sums `[N][outputs of the panel]`.
    pub fn shared(self, rows: &[f32], n: usize) -> Vec<(usize, Vec<f32>)> {
        let sums = |first: usize| vec![0.0; n * PANEL.min(self.outputs - first)];
        let firsts = (0..self.outputs).step_by(PANEL);
        let mut parts: Vec<_> = firsts.map(|first| (first, sums(first))).collect();
        each(parts.iter_mut(), |(first, sums)| {
            let count = PANEL.min(self.outputs - *first);
            let weights = &self.weights[*first * self.inner..];
            Panels::of(weights, count, self.inner).multiply(sums, rows, n);
        });
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        for (first, sums) in panels.shared(&rows, 2) {
            let count = sums.len() / 2;
            assert!((0..2 * count).all(|i| sums[i] == want(i / count, first + i % count)));
        }
    }
}
