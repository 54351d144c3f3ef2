//! What the operations on boxes share: the error bound of decoding, and row access.

use crate::engine::ops::op::EPS;
use crate::engine::reference::MAX_LOG_SCALE;

/// The box in row `i` of `[N, 4]` data.
pub(crate) fn row(boxes: &[f32], i: usize) -> [f32; 4] {
    [0, 1, 2, 3].map(|side| boxes[i * 4 + side])
}

/// How far `decode_box` in f32 may be from exact, by side, given the deltas after their weights.
///
/// With a = |low| + |high| of the anchor on an axis: its corners and so its size and centre are off
/// by at most 4εa and 6εa (a few sums of terms of that magnitude). dx is a quotient (WGSL: 2.5 ULP,
/// 5ε), so dx·size is off by |dx|·(4a + 7 size)ε. exp is off by (3 + 2|dw|) ULP, each at most 2ε,
/// and the quotient dw moves it by 5ε|dw|; with two products that makes (8 + 9|dw|)ε of the size.
/// The last sums round once or twice more. Clipping to the picture never makes an error larger.
pub(crate) fn decode_bound(anchor: [f32; 4], deltas: [f64; 4]) -> [f64; 4] {
    let mut bound = [0.0; 4];
    for axis in 0..2 {
        let [low, high] = [anchor[axis], anchor[axis + 2]].map(f64::from);
        let reach = low.abs() + high.abs();
        let size = (high - low).abs();
        let shift = deltas[axis].abs();
        let log = deltas[axis + 2].min(f64::from(MAX_LOG_SCALE));
        let grown = log.exp();
        let centre = 6.0 * reach + shift * (4.0 * reach + 7.0 * size);
        let half = grown * (4.0 * reach + size * (8.0 + 9.0 * log.abs()));
        let sums = 2.0 * (reach + shift * size + grown * size);
        bound[axis] = EPS * (centre + half + sums) + f64::from(f32::MIN_POSITIVE);
        bound[axis + 2] = bound[axis];
    }
    bound
}
