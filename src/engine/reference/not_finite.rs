//! Values that are no finite number.

/// How many values of each `chunk` in a row are infinite or NaN.
pub fn not_finite(values: &[f32], chunk: usize) -> Vec<u32> {
    let count = |part: &[f32]| part.iter().filter(|v| !v.is_finite()).count() as u32;
    values.chunks(chunk).map(count).collect()
}
