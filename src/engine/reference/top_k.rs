//! The k highest scores.

/// Indices of the `k` highest of `scores`, by descending score, ties by lower index; −0 equals +0,
/// and NaN is below every number.
pub fn top_k(scores: &[f32], k: usize) -> Vec<u32> {
    let mut places: Vec<u64> = scores.iter().zip(0..).map(|(score, i)| place(*score, i)).collect();
    // The first k before all others, so that few are sorted.
    if (1..places.len()).contains(&k) {
        places.select_nth_unstable(k - 1);
    }
    places.truncate(k);
    places.sort_unstable();
    places.into_iter().map(|place| place as u32).collect()
}

/// A number that is lower where the score is higher, and where scores are equal, the index, which is its low
/// half, is lower.
fn place(score: f32, index: u32) -> u64 {
    // Of two numbers below zero the higher has the lower bits. A sum makes +0 of −0.
    let bits = (score + 0.0).to_bits();
    let height = match score {
        score if score.is_nan() => 0,
        score if score < 0.0 => !bits,
        _ => bits | 1 << 31,
    };
    u64::from(!height) << 32 | u64::from(index)
}
