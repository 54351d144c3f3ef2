//! Products of pairs of bf16 on CPUs with AVX-512 BF16, which no crate has.

#[cfg(target_arch = "x86_64")]
pub use x86::multiplies_bf16;
#[cfg(target_arch = "x86_64")]
pub(super) use x86::multiply;

/// No other kind of CPU has it.
#[cfg(not(target_arch = "x86_64"))]
pub fn multiplies_bf16() -> bool {
    false
}

#[cfg(not(target_arch = "x86_64"))]
pub(super) fn multiply(_panel: &Panel, _sums: &mut [f32], _stride: usize, _add: bool) {
    unreachable!("`multiplies_bf16` says no");
}

/// A product of rows and the weights of at most 64 outputs. A word is two numbers in bf16, the first in its low
/// half.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code))]
pub(super) struct Panel<'a> {
    /// `[length][width]`.
    pub weights: &'a [f32],
    /// Outputs.
    pub width: usize,
    /// Row r begins at word r · `pitch`.
    pub rows: &'a [f32],
    /// Words from row to row.
    pub pitch: usize,
    /// Rows.
    pub count: usize,
    /// Words of each row.
    pub length: usize,
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m512, __m512bh, __mmask16, _mm512_add_ps, _mm512_dpbf16_ps, _mm512_mask_storeu_ps,
        _mm512_maskz_loadu_ps, _mm512_set1_ps, _mm512_setzero_ps,
    };
    use std::mem::transmute;
    use std::sync::OnceLock;

    use super::Panel;

    /// Numbers of a vector.
    const LANES: usize = 16;

    /// Whether this CPU multiplies pairs of bf16: it has AVX-512 BF16.
    pub fn multiplies_bf16() -> bool {
        static AVAILABLE: OnceLock<bool> = OnceLock::new();
        let available =
            || is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bf16");
        *AVAILABLE.get_or_init(available)
    }

    /// `sums[row · stride + o] = Σ weights[k · width + o] · rows[row · pitch + k]`, or that added to what is
    /// there.
    ///
    /// # Panics
    /// Without [`multiplies_bf16`], and for slices that are too short.
    pub fn multiply(panel: &Panel, sums: &mut [f32], stride: usize, add: bool) {
        let Panel { weights, width, rows, pitch, count, length } = *panel;
        assert!(multiplies_bf16() && (1..=4 * LANES).contains(&width));
        assert!(weights.len() >= length * width);
        assert!(count == 0 || rows.len() >= (count - 1) * pitch + length);
        let mut row = 0;
        while row < count {
            let left = count - row;
            // As many sums as there are registers for, and enough of them that none waits for the last
            // product.
            //
            // SAFETY: the CPU has both features, and the slices are as long as `tile` asks, by the assertions.
            row += unsafe {
                match (width.div_ceil(LANES), left) {
                    (1, 7..) => tile::<12, 1>(panel, row, sums, stride, add),
                    (1, _) => tile::<6, 1>(panel, row, sums, stride, add),
                    (2, 7..) => tile::<12, 2>(panel, row, sums, stride, add),
                    (2, _) => tile::<6, 2>(panel, row, sums, stride, add),
                    (3, 5..) => tile::<8, 3>(panel, row, sums, stride, add),
                    (3, _) => tile::<4, 3>(panel, row, sums, stride, add),
                    (_, 4..) => tile::<6, 4>(panel, row, sums, stride, add),
                    (_, _) => tile::<3, 4>(panel, row, sums, stride, add),
                }
            };
        }
    }

    /// R rows from `row`, or those that are left, by W vectors of outputs: how many rows.
    ///
    /// # Safety
    /// `weights` and `rows` are as long as the panel's sizes say, `row` is below `count`, and `width` is W
    /// vectors, the last in part.
    #[target_feature(enable = "avx512f,avx512bf16")]
    unsafe fn tile<const R: usize, const W: usize>(
        panel: &Panel,
        row: usize,
        sums: &mut [f32],
        stride: usize,
        add: bool,
    ) -> usize {
        let Panel { width, pitch, count, length, .. } = *panel;
        let valid = R.min(count - row);
        let last = mask(width - (W - 1) * LANES);
        let mut inputs = [panel.rows.as_ptr(); R];
        for (r, input) in inputs.iter_mut().enumerate() {
            // Rows past the last are the last again, and their sums are left out.
            *input = input.wrapping_add((row + r.min(valid - 1)) * pitch);
        }
        let mut weights = panel.weights.as_ptr();
        let mut totals = [[_mm512_setzero_ps(); W]; R];
        for k in 0..length {
            let mut weight = [_mm512_setzero_ps(); W];
            for (w, weight) in weight.iter_mut().enumerate() {
                let mask = if w + 1 == W { last } else { mask(LANES) };
                // SAFETY: `k` is below `length`, and the last vector is masked to what is left of `width`.
                *weight = unsafe { _mm512_maskz_loadu_ps(mask, weights.add(w * LANES)) };
            }
            for (totals, input) in totals.iter_mut().zip(inputs) {
                // SAFETY: as above, of a row below `count`.
                let x = _mm512_set1_ps(unsafe { *input.add(k) });
                for (total, weight) in totals.iter_mut().zip(weight) {
                    *total = dot(*total, weight, x);
                }
            }
            weights = weights.wrapping_add(width);
        }
        for (r, totals) in totals.iter().enumerate().take(valid) {
            let sums = &mut sums[(row + r) * stride..][..width];
            for (w, total) in totals.iter().enumerate() {
                let mask = if w + 1 == W { last } else { mask(LANES) };
                // SAFETY: `sums` has `width` numbers, to which the last vector is masked.
                unsafe {
                    let to = sums.as_mut_ptr().add(w * LANES);
                    let before =
                        if add { _mm512_maskz_loadu_ps(mask, to) } else { _mm512_setzero_ps() };
                    _mm512_mask_storeu_ps(to, mask, _mm512_add_ps(before, *total));
                }
            }
        }
        valid
    }

    /// `sum` and the products of both halves of each lane.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bf16")]
    fn dot(sum: __m512, a: __m512, b: __m512) -> __m512 {
        // SAFETY: all are 512 bits, of which any are numbers.
        let [a, b] = unsafe { transmute::<[__m512; 2], [__m512bh; 2]>([a, b]) };
        _mm512_dpbf16_ps(sum, a, b)
    }

    /// The first lanes of a vector, one at least.
    fn mask(lanes: usize) -> __mmask16 {
        u16::MAX >> (LANES - lanes)
    }
}
