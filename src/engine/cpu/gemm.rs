//! Matrix products, and vector code for the widest registers that the CPU has.

use std::ops::Range;

use super::tiles::{Panel, Rows, ways};
use super::words::{self, Numbers, Scale};
use crate::engine::cores::{each, threads};
use crate::engine::ops::bounds::SumOrder;
pub(super) use crate::engine::reference::vectorised;

/// The order of [`Panels::multiply`]'s sums of `k` products, and of `more` values added to them.
pub(super) fn order(numbers: Numbers, k: usize, more: usize) -> SumOrder {
    match numbers {
        // NEON rounds to odd, which errs twice as far, two products and then their sum.
        Numbers::Bf16 if cfg!(target_arch = "aarch64") => SumOrder::serial(k).and(2 + more),
        Numbers::F32 | Numbers::Bf16 => SumOrder::serial(k).and(more),
        // Sums are exact. What is rounded is each input and weight, as the numbers that they stand for, both
        // scales, of what was rounded before, the sum as f32, and that by both scales.
        Numbers::Int8 => SumOrder::serial(1).and(10 + more),
    }
}

/// Outputs of a panel.
const PANEL: usize = 64;
/// Fewest rows of a part where rows are shared: fewer take longer to fetch their weights than to multiply.
const LEAST_ROWS: usize = 16;

/// Outputs that are multiplied together.
const LANES: usize = 16;
/// Weights, in words, by which all rows are multiplied before the next: 32 KiB, which stay in the first-level cache.
const MOST_WEIGHTS: usize = 8 * 1024;

/// Weights of O outputs of rows of K words, `[⌈O / PANEL⌉][K][PANEL]`, the last panel narrower. A word is a number, or
/// several narrow ones. The last panel's outputs are filled up to sixteens, and behind weights of 8 bits lie each output's
/// step and its weights' sum.
///
/// Few rows take as long as their weights take to come from memory, and in panels those come in their order:
/// 10 rows of 12 544 inputs take 2.6 ms for 512 outputs, and 7.2 where weights lie as `[K][O]`; 100 rows
/// 15.2 and 16.9 (one core of an AMD EPYC).
#[derive(Clone, Copy, Debug)]
pub(super) struct Panels<'a> {
    packed: &'a [f32],
    outputs: usize,
    /// Words of a row.
    inner: usize,
    numbers: Numbers,
}

impl<'a> Panels<'a> {
    /// What [`Panels::packed`] packed for rows of `inner` numbers, or [`Panels::fill`].
    pub fn of(packed: &'a [f32], (outputs, inner): (usize, usize), numbers: Numbers) -> Self {
        Self { packed, outputs, inner: inner.div_ceil(numbers.a_word()), numbers }
    }

    /// `weight(o, k)` packed for `inner` inputs, whole words of them.
    pub fn packed(
        (outputs, inner): (usize, usize),
        numbers: Numbers,
        weight: impl Fn(usize, usize) -> f32,
    ) -> Vec<f32> {
        let stride = outputs.next_multiple_of(LANES);
        if numbers == Numbers::F32 {
            let mut packed = vec![0.0; stride * inner];
            let padded = |o, k| if o < outputs { weight(o, k) } else { 0.0 };
            Self::fill(&mut packed, inner, padded);
            return packed;
        }
        let words = inner / numbers.a_word();
        let mut rounded = vec![0.0; stride * words];
        let mut ends = vec![0.0; if numbers == Numbers::Int8 { 2 * stride } else { 0 }];
        for (o, rounded) in rounded.chunks_exact_mut(words).enumerate().take(outputs) {
            let of_output: Vec<f32> = (0..inner).map(|k| weight(o, k)).collect();
            let scale = words::weights(numbers, &of_output, rounded);
            if numbers == Numbers::Int8 {
                ends[o] = scale.step;
                ends[stride + o] = f32::from_bits(words::sum(rounded).cast_unsigned());
            }
        }
        let mut packed = vec![0.0; stride * words];
        Self::fill(&mut packed, words, |o, k| rounded[o * words + k]);
        packed.extend(ends);
        packed
    }

    /// Packs `weight(o, k)` for K = `inner` words.
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

    /// The weight of an output for an input, in f32.
    pub fn at(self, output: usize, input: usize) -> f32 {
        let first = output / PANEL * PANEL;
        let width = PANEL.min(self.stride() - first);
        self.packed[first * self.inner + input * width + output - first]
    }

    /// Sums of a row, with those of outputs that only fill up.
    pub fn stride(self) -> usize {
        self.outputs.next_multiple_of(LANES)
    }

    /// `sums[j · stride + i] = Σ weight(i, k) · rows[range.start + j][k]`, on the calling thread.
    pub fn multiply(self, sums: &mut [f32], rows: &Inputs, range: Range<usize>) {
        let stride = self.stride();
        self.multiply_panels(0..self.outputs, (sums, stride), rows, range);
    }

    /// The same of some panels' outputs alone.
    fn multiply_panels(
        self,
        outputs: Range<usize>,
        (sums, stride): (&mut [f32], usize),
        rows: &Inputs,
        range: Range<usize>,
    ) {
        if range.is_empty() || self.inner == 0 {
            sums[..range.len() * stride].fill(0.0);
            return;
        }
        let end = outputs.end.next_multiple_of(LANES);
        let starts = rows.rows.starts(range.clone());
        let mut words = 0;
        // The inputs of a part are read by all panels while they are near.
        for part in rows.rows.parts(MOST_WEIGHTS / outputs.len().clamp(1, PANEL)) {
            let mut output = outputs.start;
            while output < end {
                let (step, width, weights) = self.weights(output, end);
                let (weights, add) = (&weights[words * step..], words > 0);
                let panel = Panel { weights, step, width, rows: part, starts: &starts, add };
                ways(self.numbers)[0](&panel, &mut sums[output - outputs.start..], stride);
                output += width;
            }
            words += part.length * part.pieces.len();
        }
        if self.numbers == Numbers::Int8 {
            self.scale(outputs.start..end, (sums, stride), rows, range);
        }
    }

    /// The weights of an output and of those behind it in its panel up to an end, where they lie: from word to word,
    /// how many, and from the first on.
    fn weights(self, output: usize, end: usize) -> (usize, usize, &'a [f32]) {
        let panel = output / PANEL * PANEL;
        let step = PANEL.min(self.stride() - panel);
        let weights = &self.packed[panel * self.inner..][..step * self.inner];
        (step, (panel + step).min(end) - output, &weights[output - panel..])
    }

    /// What a panel's sums of 8 bits stand for: each has its row's zero for each of its weights too much.
    fn scale(
        self,
        outputs: Range<usize>,
        (sums, stride): (&mut [f32], usize),
        rows: &Inputs,
        range: Range<usize>,
    ) {
        let (steps, totals) = self.packed[self.stride() * self.inner..].split_at(self.stride());
        let (steps, totals) = (&steps[outputs.clone()], &totals[outputs.clone()]);
        vectorised(
            #[inline(always)]
            || {
                for (row, sums) in range.zip(sums.chunks_mut(stride)) {
                    let scale = rows.scales[row.min(rows.scales.len() - 1)];
                    for ((sum, step), total) in sums.iter_mut().zip(steps).zip(totals) {
                        let [sum_of, total] = [*sum, *total].map(|x| x.to_bits().cast_signed());
                        let zeros = total.wrapping_mul(i32::from(scale.zero));
                        // One step after the other, so that zero stays zero whatever they are.
                        *sum = sum_of.wrapping_sub(zeros) as f32 * step * scale.step;
                    }
                }
            },
        );
    }

    /// The same on all threads, in parts of some outputs and all rows, so that each weight is read once; where outputs
    /// are too few for that, of some of the rows.
    pub fn shared(self, rows: &Inputs, n: usize) -> Vec<Part> {
        let threads = threads();
        // Of whole panels where there are many, else one for each thread.
        let width = match self.outputs < 2 * threads * PANEL {
            true => self.outputs.div_ceil(threads).next_multiple_of(LANES),
            false => PANEL * self.outputs.div_ceil(2 * threads * PANEL),
        };
        let cuts = threads.div_ceil(self.outputs.div_ceil(width).max(1)).min(n / LEAST_ROWS).max(1);
        let each_has = n.div_ceil(cuts).max(1);
        let mut parts: Vec<Part> = (0..self.outputs)
            .step_by(width)
            .flat_map(|first| (0..n).step_by(each_has).map(move |row| (first, row)))
            .map(|(first, row)| {
                let (rows, outputs) = (row..n.min(row + each_has), width.min(self.outputs - first));
                let stride = width.min(self.stride() - first);
                let sums = vec![0.0; rows.len() * stride];
                Part { first, outputs, stride, rows, sums }
            })
            .collect();
        each(parts.iter_mut(), |part| {
            let outputs = part.first..part.first + part.outputs;
            let sums = (&mut part.sums[..], part.stride);
            self.multiply_panels(outputs, sums, rows, part.rows.clone());
        });
        parts
    }
}

/// Rows to multiply, and what their words stand for if those are narrow numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs<'a> {
    pub rows: Rows<'a>,
    /// One for each row, or one for all.
    pub scales: &'a [Scale],
}

impl<'a> Inputs<'a> {
    /// Rows of so many floats.
    pub fn floats(rows: &'a [f32], inner: usize) -> Self {
        Self { rows: Rows::contiguous(rows, inner), scales: &[] }
    }
}

/// A part of a product.
#[derive(Debug)]
pub(super) struct Part {
    /// The first output.
    pub first: usize,
    pub outputs: usize,
    /// Sums of a row.
    pub stride: usize,
    pub rows: Range<usize>,
    /// `[rows][stride]`.
    pub sums: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All numbers of rows and of outputs that a tile may have, and sums of several parts, of whole numbers, so that
    /// each order of adding is exact. Each way of multiplying narrow numbers that this CPU has is tried.
    #[test]
    fn products_of_all_sizes() {
        for n in 1..=26 {
            for (o, k) in [1, 15, 17, 33, 48, 64, 70].map(|o| (o, 4 + 4 * ((37 * n * o) % 350))) {
                // The largest of each output and of each row are 127 and 255, so that a step of 8 bits is 1.
                let weight = |o: usize, k: usize| match k {
                    0 => 127.0,
                    _ => ((o * 7 + k * 13) % 11) as f32 - 5.0,
                };
                let row = |row: usize, k: usize| match k {
                    0 => 255.0,
                    _ => ((row * k + k) % 9) as f32,
                };
                let inputs: Vec<f32> = (0..n * k).map(|i| row(i / k, i % k)).collect();
                let want: Vec<f32> = (0..n * o)
                    .map(|i| (0..k).map(|k| weight(i % o, k) * row(i / o, k)).sum())
                    .collect();
                for numbers in [Numbers::F32, Numbers::Bf16, Numbers::Int8] {
                    let [first, others @ ..] = ways(numbers) else { continue };
                    let packed = Panels::packed((o, k), numbers, weight);
                    let panels = Panels::of(&packed, (o, k), numbers);
                    let mut sums = vec![f32::NAN; n * panels.stride()];
                    let rounded = words::rows(numbers, &inputs, k);
                    let rows = Rows::contiguous(&rounded.words, panels.inner);
                    let rows = Inputs { rows, scales: &rounded.scales };
                    panels.multiply(&mut sums, &rows, 0..n);
                    for (sums, want) in sums.chunks(panels.stride()).zip(want.chunks(o)) {
                        assert_eq!(sums[..o], *want, "{n} rows, {o} outputs of {k}: {numbers:?}");
                    }
                    // The other ways give the same bits.
                    for way in others {
                        let width = PANEL.min(panels.stride());
                        let starts = rows.rows.starts(0..n);
                        let (weights, rows) = (&packed[..], rows.rows);
                        let panel = Panel {
                            weights,
                            step: width,
                            width,
                            rows,
                            starts: &starts,
                            add: false,
                        };
                        let [mut one, mut other] = [(); 2].map(|()| vec![f32::NAN; n * width]);
                        way(&panel, &mut one, width);
                        first(&panel, &mut other, width);
                        assert!(
                            one.iter().map(|x| x.to_bits()).eq(other.iter().map(|x| x.to_bits()))
                        );
                    }
                }
            }
        }
    }

    /// 80 outputs of three inputs, output o of input k being 10 o + k: 64 in a panel, and 16.
    #[test]
    fn weights_lie_in_panels() {
        let mut packed = vec![f32::NAN; 80 * 3];
        Panels::fill(&mut packed, 3, |o, k| (10 * o + k) as f32);
        assert_eq!(packed[..2], [0.0, 10.0]);
        assert_eq!(packed[64..66], [1.0, 11.0]);
        assert_eq!([&packed[192..194], &packed[208..210]], [[640.0, 650.0], [641.0, 651.0]]);
        let panels = Panels::of(&packed, (80, 3), Numbers::F32);
        assert_eq!([panels.at(63, 2), panels.at(64, 0), panels.at(65, 1)], [632.0, 640.0, 651.0]);

        // Two rows: the sum of an output's weights, and its first.
        let rows = [1.0, 1.0, 1.0, 1.0, 0.0, 0.0];
        let want = |row: usize, o: usize| if row == 0 { 30 * o + 3 } else { 10 * o } as f32;
        let mut sums = vec![f32::NAN; 2 * 80];
        let rows = Inputs::floats(&rows, 3);
        panels.multiply(&mut sums, &rows, 0..2);
        assert!((0..2 * 80).all(|i| sums[i] == want(i / 80, i % 80)), "{sums:?}");
        for Part { first, outputs, rows, sums, .. } in panels.shared(&rows, 2) {
            assert_eq!(rows, 0..2);
            assert!((0..2 * outputs).all(|i| sums[i] == want(i / outputs, first + i % outputs)));
        }
    }

    /// Whatever the number of threads, each sum is in one part.
    #[test]
    fn parts_cover_each_sum_once() {
        for (n, o) in [(0, 5), (1, 3), (23, 70), (100, 192), (400, 96), (100, 512)] {
            let packed = Panels::packed((o, 3), Numbers::F32, |o, k| (10 * o + k) as f32);
            let rows: Vec<f32> = (0..n * 3).map(|i| (i % 7) as f32).collect();
            let panels = Panels::of(&packed, (o, 3), Numbers::F32);
            let stride = panels.stride();
            let mut all = vec![f32::NAN; n * stride];
            let rows = Inputs::floats(&rows, 3);
            panels.multiply(&mut all, &rows, 0..n);
            let mut seen = 0;
            for Part { first, outputs, stride: own, rows, sums } in panels.shared(&rows, n) {
                seen += rows.len() * outputs;
                for (row, sums) in rows.zip(sums.chunks_exact(own)) {
                    assert_eq!(
                        sums[..outputs],
                        all[row * stride + first..][..outputs],
                        "{n} × {o}"
                    );
                }
            }
            assert_eq!(seen, n * o);
        }
    }
}
