//! Softmax.

/// e^(xᵢ / T) / Σ e^(xⱼ / T), with the largest x subtracted first.
pub fn softmax(row: &[f32], temperature: f32) -> Vec<f32> {
    let highest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let power = |x: &f32| ((f64::from(*x) - f64::from(highest)) / f64::from(temperature)).exp();
    let powers: Vec<f64> = row.iter().map(power).collect();
    let sum: f64 = powers.iter().sum();
    powers.iter().map(|p| (p / sum) as f32).collect()
}
