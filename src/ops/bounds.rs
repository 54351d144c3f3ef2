//! Error bounds that several operations share, in terms of f32's unit roundoff [`EPS`].

use crate::error::Result;
use crate::ops::op::EPS;
use crate::tensor::{Tensor, Value};

/// Bound for a value that went through at most `roundings` sums and products in a row, where
/// `magnitude` is the sum of the terms' absolute values (Higham, Accuracy and Stability, §3.1). The
/// rest is for drivers that flush subnormal numbers to zero.
pub fn sum_error(roundings: usize, magnitude: f64) -> f64 {
    roundings as f64 * (EPS * magnitude + f64::from(f32::MIN_POSITIVE))
}

/// Bound for the logistic function of a logit that is `logit_error` off: its slope is at most 1/4.
/// WGSL lets exp(x) be 3 + 2|x| ULP off, which the slope turns into at most 2.5 EPS, and the
/// division 2.5 ULP, which is 5 EPS; the sum in the denominator and the rounding add 2.
pub fn sigmoid_error(logit_error: f64) -> f64 {
    logit_error / 4.0 + 10.0 * EPS
}

/// The absolute values of a tensor, to compute magnitudes with the operation's own reference.
///
/// # Errors
/// As [`Value::f32`].
pub fn magnitude(value: &Value) -> Result<Tensor> {
    let tensor = value.f32()?;
    Ok(Tensor::from_fn(tensor.shape().clone(), |i| tensor.data()[i].abs()))
}

/// Bound for the mean of `count` values whose mean absolute value is `magnitude`. A sum in order
/// would lose count·EPS, 1.5e-3 of their size at 160 × 160. So shaders sum in at least
/// [`PARTIAL_SUMS`] parts that a tree adds up, and are held to it; the division adds 2.5 ULP.
pub fn mean_error(count: usize, magnitude: f64) -> f64 {
    let depth = PARTIAL_SUMS.ilog2() as usize;
    sum_error(count.div_ceil(PARTIAL_SUMS) + depth + 5, magnitude)
}

/// Parts of a sum over space that a workgroup keeps.
pub const PARTIAL_SUMS: usize = 64;
