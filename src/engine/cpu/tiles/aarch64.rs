//! NEON; bf16 and 8 bits where a CPU has dot products of them.

use std::arch::aarch64::{
    float32x4_t, int32x4_t, vdupq_n_f32, vdupq_n_s32, vfmaq_f32, vld1q_f32, vld1q_s32, vst1q_f32,
    vst1q_s32,
};
use std::arch::{asm, is_aarch64_feature_detected};

use super::{Panel, Vector, Ways, tiles, vector};

pub fn add(ways: &mut Ways) {
    // SAFETY: each runs on a CPU that has its features.
    ways.f32.push(|panel, sums, stride| unsafe { f32(panel, sums, stride) });
    if is_aarch64_feature_detected!("bf16") {
        ways.bf16.push(|panel, sums, stride| unsafe { bf16(panel, sums, stride) });
    }
    if is_aarch64_feature_detected!("dotprod") {
        ways.int8.push(|panel, sums, stride| unsafe { int8(panel, sums, stride) });
    }
}

#[target_feature(enable = "neon")]
unsafe fn f32(panel: &Panel, sums: &mut [f32], stride: usize) {
    // SAFETY: the features are here.
    unsafe { tiles::<F32, 6, 3, 4>(panel, sums, stride) }
}

#[target_feature(enable = "neon,bf16")]
unsafe fn bf16(panel: &Panel, sums: &mut [f32], stride: usize) {
    // SAFETY: the features are here.
    unsafe { tiles::<Bf16, 6, 3, 4>(panel, sums, stride) }
}

#[target_feature(enable = "neon,dotprod")]
unsafe fn int8(panel: &Panel, sums: &mut [f32], stride: usize) {
    // SAFETY: the features are here.
    unsafe { tiles::<Int8, 6, 3, 4>(panel, sums, stride) }
}

vector!(F32, float32x4_t, 4, [vdupq_n_f32(0.0), vld1q_f32, vdupq_n_f32, vst1q_f32],
    (total, weight, x) vfmaq_f32(total, weight, x));
vector!(Bf16, float32x4_t, 4, [vdupq_n_f32(0.0), vld1q_f32, vdupq_n_f32, vst1q_f32],
    (total, weight, x) bfdot(total, weight, x));
vector!(Int8, int32x4_t, 4, [vdupq_n_s32(0), vld1q_s32, vdupq_n_s32, vst1q_s32],
    (total, weight, x) sdot(total, weight, x));

// The standard library has these for nightly compilers alone.

/// # Safety
/// The CPU has bf16.
#[inline(always)]
unsafe fn bfdot(mut total: float32x4_t, weight: float32x4_t, x: float32x4_t) -> float32x4_t {
    // SAFETY: it reads and writes the three registers, and the CPU has it.
    unsafe {
        asm!("bfdot {0:v}.4s, {1:v}.8h, {2:v}.8h", inout(vreg) total, in(vreg) weight, in(vreg) x,
            options(pure, nomem, nostack, preserves_flags));
    }
    total
}

/// # Safety
/// The CPU has dotprod.
#[inline(always)]
unsafe fn sdot(mut total: int32x4_t, weight: int32x4_t, x: int32x4_t) -> int32x4_t {
    // SAFETY: it reads and writes the three registers, and the CPU has it.
    unsafe {
        asm!("sdot {0:v}.4s, {1:v}.16b, {2:v}.16b", inout(vreg) total, in(vreg) weight, in(vreg) x,
            options(pure, nomem, nostack, preserves_flags));
    }
    total
}
