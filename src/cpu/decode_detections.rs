//! Detections from the RoI head.

use crate::cpu::decode_box;

/// How [`decode_detections`] reads the RoI head.
#[derive(Clone, Copy, Debug)]
pub struct DetectionRule {
    /// Width and height of the picture.
    pub extent: [f32; 2],
    /// What the deltas (dx, dy, dw, dh) are divided by.
    pub weights: [f32; 4],
    /// Bit c: class c is wanted.
    pub class_mask: u32,
    /// Classes with the background, which is class 0.
    pub classes: usize,
}

impl DetectionRule {
    /// The deltas of `class` in a region's row, divided by their weights.
    pub fn deltas(&self, row: &[f32], class: usize) -> [f64; 4] {
        [0, 1, 2, 3].map(|d| f64::from(row[class * 4 + d]) / f64::from(self.weights[d]))
    }
}

/// Box, score and class of each class but the background for one region; the score is −1 where the
/// class is not wanted.
pub fn decode_detections(
    roi: [f32; 4],
    deltas: &[f32],
    probabilities: &[f32],
    rule: DetectionRule,
) -> Vec<([f32; 4], f32, u32)> {
    (1..rule.classes)
        .map(|class| {
            let wanted = rule.class_mask >> class & 1 == 1;
            let score = if wanted { probabilities[class] } else { -1.0 };
            (decode_box(roi, rule.deltas(deltas, class), rule.extent), score, class as u32)
        })
        .collect()
}
