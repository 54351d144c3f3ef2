//! The k highest scores.

use std::cmp::Ordering;

/// Indices of the `k` highest of `scores`, by descending score, ties by lower index; −0 equals +0,
/// and NaN is below every number.
pub fn top_k(scores: &[f32], k: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..scores.len() as u32).collect();
    // Stable, so that ties stay in the order of their indices.
    order.sort_by(|a, b| descending(scores[*a as usize], scores[*b as usize]));
    order.truncate(k);
    order
}

fn descending(a: f32, b: f32) -> Ordering {
    b.partial_cmp(&a).unwrap_or_else(|| a.is_nan().cmp(&b.is_nan()))
}
