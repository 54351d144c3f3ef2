//! Box voting.

/// The candidates among which the kept boxes were chosen, a score and a class each.
#[derive(Clone, Copy, Debug)]
pub struct Voters<'a> {
    /// `(x1, y1, x2, y2)`.
    pub boxes: &'a [[f32; 4]],
    /// Scores; those of 0 or less have no vote.
    pub scores: &'a [f32],
    /// Classes; candidates vote within their own.
    pub classes: &'a [u32],
}

impl Voters<'_> {
    /// What candidate j's vote for the box `kept` weighs: score · (IoU − t) / (1 − t); only what is
    /// above 0 counts. 0 for its own and for one of another class or without a score.
    pub fn vote(&self, kept: usize, j: usize, threshold: f32) -> f64 {
        let score = f64::from(self.scores[j]);
        if j == kept || self.classes[j] != self.classes[kept] || score.is_nan() || score <= 0.0 {
            return 0.0;
        }
        let threshold = f64::from(threshold);
        score * (iou(self.boxes[kept], self.boxes[j]) - threshold) / (1.0 - threshold)
    }
}

/// The row of the box `kept` after the vote, where `row(j)` is that of candidate j: its own, moved by
/// the mean of how far the others' are from it, in which its own vote weighs as its score.
pub fn box_voting<'a>(
    voters: Voters<'_>,
    row: impl Fn(usize) -> &'a [f32],
    kept: usize,
    threshold: f32,
) -> Vec<f64> {
    let votes = (0..voters.boxes.len()).map(|j| (j, voters.vote(kept, j, threshold)));
    let votes: Vec<_> = votes.filter(|(_, weight)| *weight > 0.0).collect();
    let own = f64::from(voters.scores[kept].max(0.0));
    let total = own + votes.iter().map(|(_, weight)| weight).sum::<f64>();
    let voted = |(column, from): (usize, &f32)| {
        let from = f64::from(*from);
        let far = |j: usize| f64::from(row(j)[column]) - from;
        let shift: f64 = votes.iter().map(|(j, weight)| weight * far(*j)).sum();
        if votes.is_empty() { from } else { from + shift / total }
    };
    row(kept).iter().enumerate().map(voted).collect()
}

/// Intersection over union; 0 for boxes of no area, and for what is no number.
fn iou(a: [f32; 4], b: [f32; 4]) -> f64 {
    let [a, b] = [a, b].map(|b| b.map(f64::from));
    let area = |b: [f64; 4]| (b[2] - b[0]) * (b[3] - b[1]);
    let side = |axis: usize| (a[axis + 2].min(b[axis + 2]) - a[axis].max(b[axis])).max(0.0);
    let common = side(0) * side(1);
    let union = area(a) + area(b) - common;
    if common > 0.0 && union > 0.0 { common / union } else { 0.0 }
}
