//! Weighted sum of maps.

use crate::engine::tensor::Tensor;

/// `Σ weights[k] · maps[k]`, element by element; all maps have the first one's shape.
pub fn weighted_sum(weights: &Tensor, maps: &[&Tensor]) -> Tensor {
    Tensor::from_fn(maps[0].shape().clone(), |i| {
        let terms = weights.data().iter().zip(maps);
        terms.map(|(w, map)| f64::from(*w) * f64::from(map.data()[i])).sum::<f64>() as f32
    })
}
