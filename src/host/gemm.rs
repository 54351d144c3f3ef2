//! Matrix products, and vector code for the widest registers that the CPU has.

pub(super) use crate::cpu::vectorised;
use crate::ops::bounds::{Joined, SumOrder};

/// Products that are added up before their sum joins the others, whatever order the library takes.
const PART: usize = 512;

/// The order of [`multiply`]'s sums of `k` products, at the worst.
pub(super) fn order(k: usize) -> SumOrder {
    let (terms, parts) = (k.min(PART), k.div_ceil(PART));
    SumOrder { terms, parts, joined: Joined::InOrder, more: 0 }
}

/// `dst[j · O + i] = Σ weights[k · stride + i] · rows[j · K + k]`: N rows of K values times K rows of
/// O weights, of which `weights` may be a part of `stride` columns. On the calling thread.
pub(super) fn multiply(
    dst: &mut [f32],
    weights: &[f32],
    stride: usize,
    rows: &[f32],
    [o, n, k]: [usize; 3],
) {
    if o == 0 || n == 0 {
        return;
    }
    if k == 0 {
        dst[..n * o].fill(0.0);
        return;
    }
    assert!(o <= stride && dst.len() >= n * o && rows.len() >= n * k);
    assert!(weights.len() >= (k - 1) * stride + o);
    for first in (0..k).step_by(PART) {
        let count = PART.min(k - first);
        let (weights, rows) = (&weights[first * stride..], &rows[first..]);
        // SAFETY: the product reads weights[k' · stride + i] and rows[j · K + k'] and writes
        // dst[j · O + i] for i < O, j < N, first + k' < K, which the assertions keep inside the
        // slices; `dst` is borrowed mutably, so it overlaps neither.
        unsafe {
            gemm::gemm(
                o,
                n,
                count,
                dst.as_mut_ptr(),
                o as isize,
                1,
                first > 0,
                weights.as_ptr(),
                stride as isize,
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
