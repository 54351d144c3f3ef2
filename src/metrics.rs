//! How good detections are: box overlap, average precision, best boxes.
//!
//! Boxes are corners (x1, y1, x2, y2) in any one unit.

/// Intersection over union of two boxes; 0 if either has no area.
pub fn box_iou(a: [f64; 4], b: [f64; 4]) -> f64 {
    let area = |r: [f64; 4]| (r[2] - r[0]).max(0.0) * (r[3] - r[1]).max(0.0);
    let common = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
    let intersection = area(common);
    if intersection > 0.0 { intersection / (area(a) + area(b) - intersection) } else { 0.0 }
}

/// Middle of a box.
pub fn center(b: [f64; 4]) -> [f64; 2] {
    [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0]
}

/// A found box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredBox {
    /// Corners.
    pub bbox: [f64; 4],
    /// Confidence.
    pub score: f64,
}

/// What one picture holds of one class, and what was found of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PictureBoxes {
    /// The boxes that are there.
    pub truths: Vec<[f64; 4]>,
    /// The boxes that were found, in any order.
    pub found: Vec<ScoredBox>,
}

impl PictureBoxes {
    /// For each truth the found box that overlaps it most, among those with a score above
    /// `score`, and their intersection over union; `None` where none overlaps.
    pub fn best(&self, score: f64) -> Vec<Option<(ScoredBox, f64)>> {
        let best_of = |truth: &[f64; 4]| {
            let shown = self.found.iter().filter(|f| f.score > score);
            shown
                .map(|f| (*f, box_iou(*truth, f.bbox)))
                .filter(|(_, iou)| *iou > 0.0)
                .max_by(|a, b| a.1.total_cmp(&b.1))
        };
        self.truths.iter().map(best_of).collect()
    }

    /// The same with the found boxes that have a score above `score` alone.
    pub fn above(&self, score: f64) -> Self {
        let found = self.found.iter().filter(|f| f.score > score).copied().collect();
        Self { truths: self.truths.clone(), found }
    }

    /// The found boxes' scores, best first, each with whether it takes a truth: as in the COCO
    /// evaluation, each takes the free truth that it overlaps most, by at least `iou`.
    fn hits(&self, iou: f64) -> Vec<(f64, bool)> {
        let mut found = self.found.clone();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut free = vec![true; self.truths.len()];
        let take = |f: &ScoredBox| {
            let overlaps = self.truths.iter().map(|t| box_iou(*t, f.bbox)).enumerate();
            let best = overlaps
                .filter(|(i, overlap)| free[*i] && *overlap >= iou)
                .max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((i, _)) = best {
                free[i] = false;
            }
            (f.score, best.is_some())
        };
        found.iter().map(take).collect()
    }

    /// How many found boxes with a score above `score` take no truth at `iou`.
    pub fn false_alarms(&self, score: f64, iou: f64) -> usize {
        self.hits(iou).iter().filter(|(s, hit)| *s > score && !hit).count()
    }
}

/// Average precision of one class at one threshold of overlap, as the COCO evaluation defines it:
/// the mean of the highest precision at or beyond each of 101 recalls. `None` without truths.
pub fn average_precision(pictures: &[PictureBoxes], iou: f64) -> Option<f64> {
    let truths: usize = pictures.iter().map(|p| p.truths.len()).sum();
    if truths == 0 {
        return None;
    }
    let mut hits: Vec<(f64, bool)> = pictures.iter().flat_map(|p| p.hits(iou)).collect();
    hits.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut right = 0;
    let mut curve: Vec<(f64, f64)> = Vec::with_capacity(hits.len());
    for (shown, (_, hit)) in (1..).zip(&hits) {
        right += usize::from(*hit);
        curve.push((right as f64 / truths as f64, right as f64 / f64::from(shown)));
    }
    for i in (1..curve.len()).rev() {
        curve[i - 1].1 = curve[i - 1].1.max(curve[i].1);
    }
    let precision_at = |recall: f64| {
        let first = curve.partition_point(|(r, _)| *r < recall);
        curve.get(first).map_or(0.0, |(_, precision)| *precision)
    };
    // The recalls as numpy's linspace rounds them.
    Some((0..=100).map(|i| precision_at(f64::from(i) * 0.01)).sum::<f64>() / 101.0)
}

/// The mean of [`average_precision`] over the overlaps 0.50, 0.55, … 0.95. `None` without truths.
pub fn average_precision_50_95(pictures: &[PictureBoxes]) -> Option<f64> {
    let at = |i: i32| average_precision(pictures, 0.5 + 0.05 * f64::from(i));
    let sum: Option<f64> = (0..10).map(at).sum();
    sum.map(|s| s / 10.0)
}

/// The value below which the share `q` of `values` lies, linear between neighbours; `None` if there
/// are none.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = q.clamp(0.0, 1.0) * sorted.len().checked_sub(1)? as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    Some(low + (high - low) * at.fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scored(bbox: [f64; 4], score: f64) -> ScoredBox {
        ScoredBox { bbox, score }
    }

    #[test]
    fn iou_by_hand() {
        let unit = [0.0, 0.0, 2.0, 2.0];
        // Half of each is shared: 2 of 6.
        assert_eq!(box_iou(unit, [1.0, 0.0, 3.0, 2.0]), 1.0 / 3.0);
        // One corner: 1 of 7.
        assert_eq!(box_iou(unit, [1.0, 1.0, 3.0, 3.0]), 1.0 / 7.0);
        assert_eq!(box_iou(unit, unit), 1.0);
        // Touching, apart, empty, inside out.
        for other in [[2.0, 0.0, 4.0, 2.0], [9.0, 9.0, 10.0, 10.0], [1.0; 4], [2.0, 2.0, 0.0, 0.0]]
        {
            assert_eq!(box_iou(unit, other), 0.0);
        }
        assert_eq!(box_iou([1.0; 4], [1.0; 4]), 0.0);
    }

    #[test]
    fn best_box_ignores_low_scores_and_may_serve_two_truths() {
        let picture = PictureBoxes {
            truths: vec![[0.0, 0.0, 2.0, 2.0], [1.0, 0.0, 3.0, 2.0], [50.0, 50.0, 60.0, 60.0]],
            found: vec![
                scored([0.0, 0.0, 2.0, 2.0], 0.9),
                // Right on the second truth, but not above the threshold.
                scored([1.0, 0.0, 3.0, 2.0], 0.5),
            ],
        };
        let best: Vec<_> = picture.best(0.5).iter().map(|b| b.map(|(_, iou)| iou)).collect();
        assert_eq!(best, [Some(1.0), Some(1.0 / 3.0), None]);
        assert_eq!(picture.false_alarms(0.5, 0.5), 0);
        assert_eq!(picture.false_alarms(0.5, 1.1), 1);
    }

    #[test]
    fn average_precision_by_hand() {
        let a = [0.0, 0.0, 10.0, 10.0];
        let b = [20.0, 0.0, 30.0, 10.0];
        let nowhere = [90.0, 90.0, 99.0, 99.0];
        // Right, wrong, right: precision 1, 1/2, 2/3 at recall 1/2, 1/2, 1. So 1 at the 51 recalls
        // up to 0.50 and 2/3 at the other 50.
        let picture = PictureBoxes {
            truths: vec![a, b],
            found: vec![scored(b, 0.3), scored(a, 0.9), scored(nowhere, 0.6)],
        };
        let ap = average_precision(std::slice::from_ref(&picture), 0.5).expect("truths");
        assert!((ap - (51.0 + 50.0 * 2.0 / 3.0) / 101.0).abs() < 1e-12, "{ap}");
        // The same box twice: the second is wrong.
        let twice = PictureBoxes { truths: vec![a], found: vec![scored(a, 0.8), scored(a, 0.9)] };
        assert_eq!(twice.false_alarms(0.0, 0.5), 1);
        assert_eq!(average_precision(&[twice], 0.5), Some(1.0));
        // A picture without truths lowers precision where its box scores higher.
        let empty = PictureBoxes { truths: vec![], found: vec![scored(a, 0.95)] };
        let ap = average_precision(&[picture, empty.clone()], 0.5).expect("truths");
        assert!((ap - (51.0 * 0.5 + 50.0 * 0.5) / 101.0).abs() < 1e-12, "{ap}");
        assert_eq!(average_precision(&[empty], 0.5), None);
        assert_eq!(
            average_precision(&[PictureBoxes { truths: vec![a], found: vec![] }], 0.5),
            Some(0.0)
        );
    }

    /// Boxes from a linear congruential generator, which any language repeats in a line.
    fn generated() -> Vec<PictureBoxes> {
        let mut state = 1_u64;
        let mut next = || {
            state = (state * 1_103_515_245 + 12345) % (1 << 31);
            (state >> 16) as f64 / 32768.0
        };
        (0..40)
            .map(|_| {
                let truths: Vec<[f64; 4]> = (0..3)
                    .map(|_| {
                        let (x, y, w, h) = (next() * 80.0, next() * 80.0, next(), next());
                        [x, y, x + 5.0 + w * 20.0, y + 5.0 + h * 20.0]
                    })
                    .collect();
                let mut found: Vec<ScoredBox> = truths
                    .iter()
                    .map(|t| {
                        let bbox = t.map(|v| v + next() * 6.0 - 3.0);
                        ScoredBox { bbox, score: 0.3 + 0.7 * next() }
                    })
                    .collect();
                let (x, y, score) = (next() * 80.0, next() * 80.0, next());
                found.push(ScoredBox { bbox: [x, y, x + 15.0, y + 15.0], score });
                PictureBoxes { truths, found }
            })
            .collect()
    }

    #[test]
    fn average_precision_agrees_with_pycocotools() {
        // pycocotools 2.0, COCOeval "bbox" on the same boxes: the means of precision[0] and of
        // precision, for area `all` and 100 detections.
        const AP50: f64 = 0.544_701_405_566_439_4;
        const AP: f64 = 0.171_149_901_681_339_17;
        let pictures = generated();
        let ap50 = average_precision(&pictures, 0.5).expect("truths");
        let ap = average_precision_50_95(&pictures).expect("truths");
        assert!((ap50 - AP50).abs() < 1e-9, "{ap50}");
        assert!((ap - AP).abs() < 1e-9, "{ap}");
    }

    #[test]
    fn quantiles_are_linear() {
        assert_eq!(quantile(&[4.0, 1.0, 3.0, 2.0], 0.5), Some(2.5));
        assert_eq!(quantile(&[10.0, 0.0], 0.95), Some(9.5));
        assert_eq!(quantile(&[7.0], 0.95), Some(7.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
