//! Detections from the RoI head.

use crate::engine::reference::{decode_box, sigmoid};

/// How [`decode_detections`] reads the RoI head.
#[derive(Clone, Copy, Debug)]
pub struct DetectionRule {
    /// Width and height of the picture.
    pub extent: [f32; 2],
    /// What the deltas (dx, dy, dw, dh) are divided by.
    pub weights: [f32; 4],
    /// What the logits are divided by.
    pub temperature: f32,
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

/// What one region is taken for.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// `(x1, y1, x2, y2)`, clipped to the picture.
    pub bbox: [f32; 4],
    /// The class's share of the softmax; −1 where the class is not wanted.
    pub score: f32,
    /// The score's logit.
    pub margin: f32,
    /// 1 for the first behind the background.
    pub class: u32,
}

/// A candidate for each class but the background of one region.
pub fn decode_detections(
    roi: [f32; 4],
    deltas: &[f32],
    logits: &[f32],
    rule: DetectionRule,
) -> Vec<Candidate> {
    (1..rule.classes)
        .map(|class| {
            let margin = margin(logits, class, rule.temperature);
            let wanted = rule.class_mask >> class & 1 == 1;
            Candidate {
                bbox: decode_box(roi, rule.deltas(deltas, class), rule.extent),
                score: if wanted { sigmoid(margin) as f32 } else { -1.0 },
                margin: margin as f32,
                class: class as u32,
            }
        })
        .collect()
}

/// By how much a class's logit is above those of all others together: x − ln Σ e^(xⱼ), each divided by
/// the temperature. The softmax is its sigmoid: e^x / (e^x + Σ e^(xⱼ)) = 1 / (1 + e^−margin).
pub fn margin(logits: &[f32], class: usize, temperature: f32) -> f64 {
    let scaled = |x: f32| f64::from(x) / f64::from(temperature);
    let others = || logits.iter().enumerate().filter(|(c, _)| *c != class).map(|(_, x)| scaled(*x));
    let highest = others().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = others().map(|x| (x - highest).exp()).sum();
    scaled(logits[class]) - highest - sum.ln()
}
