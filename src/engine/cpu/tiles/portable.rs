//! f32 on any CPU.

use super::{Panel, Vector, tiles};

pub fn multiply(panel: &Panel, sums: &mut [f32], stride: usize) {
    // SAFETY: it asks for no features.
    unsafe { tiles::<Lanes, 6, 3, 2>(panel, sums, stride) }
}

/// As many as the smallest vector registers have.
#[derive(Clone, Copy)]
struct Lanes([f32; 4]);

// SAFETY: the pointers lead to as many words as the trait asks.
impl Vector for Lanes {
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn zero() -> Self {
        Self([0.0; 4])
    }

    #[inline(always)]
    unsafe fn load(words: *const f32) -> Self {
        Self(unsafe { *words.cast() })
    }

    #[inline(always)]
    unsafe fn splat(word: *const f32) -> Self {
        Self([unsafe { *word }; 4])
    }

    #[inline(always)]
    unsafe fn dot(Self(mut total): Self, Self(weight): Self, Self(x): Self) -> Self {
        for lane in 0..Self::LANES {
            total[lane] += weight[lane] * x[lane];
        }
        Self(total)
    }

    #[inline(always)]
    unsafe fn store(Self(total): Self, to: *mut f32) {
        unsafe { *to.cast() = total }
    }
}
