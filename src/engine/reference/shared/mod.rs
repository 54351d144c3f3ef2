//! Definitions that several references share, as `wgsl/shared/` is for the shaders.

pub mod boxes;

/// 1 / (1 + e⁻ˣ).
pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// ReLU that keeps a NaN, as PyTorch's does.
pub fn relu(x: f64) -> f64 {
    if x < 0.0 { 0.0 } else { x }
}

/// `Σ a[k] · b[k]` in [`LANES`] partial sums, which vector registers hold.
#[inline(always)]
pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [0.0; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += f64::from(a[lane]) * f64::from(b[lane]);
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| f64::from(*a) * f64::from(*b));
    sums.into_iter().sum::<f64>() + rest.sum::<f64>()
}

const LANES: usize = 16;

/// Runs `work` compiled for the widest registers that this CPU has, or without the feature `cpu` for
/// those that all its kind have. Every operation rounds as it does elsewhere. A closure needs
/// `#[inline(always)]`: one that stays a function of its own is compiled for what all have.
#[inline]
pub fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(feature = "cpu")]
    return pulp::Arch::new().dispatch(work);
    #[cfg(not(feature = "cpu"))]
    work()
}
