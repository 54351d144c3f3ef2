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
