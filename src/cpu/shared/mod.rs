//! Definitions that several references share, as `wgsl/shared/` is for the shaders.

pub mod boxes;

/// ReLU that keeps a NaN, as PyTorch's does.
pub fn relu(x: f64) -> f64 {
    if x < 0.0 { 0.0 } else { x }
}
