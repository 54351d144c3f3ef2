//! AVX-512, AVX2 and FMA; bf16 and 8 bits where those have them.

use std::arch::x86_64::{
    __m256, __m256i, __m512, __m512bh, __m512i, _mm256_dpbusd_avx_epi32, _mm256_fmadd_ps,
    _mm256_loadu_ps, _mm256_loadu_si256, _mm256_set1_epi32, _mm256_set1_ps, _mm256_setzero_ps,
    _mm256_setzero_si256, _mm256_storeu_ps, _mm256_storeu_si256, _mm512_dpbf16_ps,
    _mm512_dpbusd_epi32, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_loadu_si512, _mm512_set1_epi32,
    _mm512_set1_ps, _mm512_setzero_ps, _mm512_setzero_si512, _mm512_storeu_ps, _mm512_storeu_si512,
};
use std::mem::transmute;

use super::{Panel, Vector, Ways, check, tile, tiles, vector};

pub fn add(ways: &mut Ways) {
    let wide = is_x86_feature_detected!("avx512f");
    // SAFETY: each runs on a CPU that has its features.
    if wide {
        ways.f32.push(|panel, sums, stride| unsafe { wide_f32(panel, sums, stride) });
    }
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        ways.f32.push(|panel, sums, stride| unsafe { f32_of_256(panel, sums, stride) });
    }
    if wide && is_x86_feature_detected!("avx512bf16") {
        ways.bf16.push(|panel, sums, stride| unsafe { wide_bf16(panel, sums, stride) });
    }
    if wide && is_x86_feature_detected!("avx512vnni") {
        ways.int8.push(|panel, sums, stride| unsafe { wide_int8(panel, sums, stride) });
    }
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("avxvnni") {
        ways.int8.push(|panel, sums, stride| unsafe { int8_of_256(panel, sums, stride) });
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
    unsafe { tiles::<F32Of256, 6, 3, 2>(panel, sums, stride) }
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
    unsafe { tiles::<Int8Of256, 6, 3, 2>(panel, sums, stride) }
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

vector!(WideF32, __m512, 16,
    [_mm512_setzero_ps(), _mm512_loadu_ps, _mm512_set1_ps, _mm512_storeu_ps],
    (total, weight, x) _mm512_fmadd_ps(weight, x, total));
vector!(F32Of256, __m256, 8,
    [_mm256_setzero_ps(), _mm256_loadu_ps, _mm256_set1_ps, _mm256_storeu_ps],
    (total, weight, x) _mm256_fmadd_ps(weight, x, total));
vector!(WideBf16, __m512, 16,
    [_mm512_setzero_ps(), _mm512_loadu_ps, _mm512_set1_ps, _mm512_storeu_ps],
    (total, weight, x) _mm512_dpbf16_ps(total, pairs(weight), pairs(x)));
vector!(WideInt8, __m512i, 16,
    [_mm512_setzero_si512(), _mm512_loadu_si512, _mm512_set1_epi32, _mm512_storeu_si512],
    (total, weight, x) _mm512_dpbusd_epi32(total, x, weight));
vector!(Int8Of256, __m256i, 8,
    [_mm256_setzero_si256(), _mm256_loadu_si256, _mm256_set1_epi32, _mm256_storeu_si256],
    (total, weight, x) _mm256_dpbusd_avx_epi32(total, x, weight));

/// The same bits.
#[inline(always)]
fn pairs(words: __m512) -> __m512bh {
    // SAFETY: both are 512 bits, of which any are numbers.
    unsafe { transmute(words) }
}
