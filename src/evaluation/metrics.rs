//! How good detections are: box overlap, average precision, best boxes.
//!
//! Boxes are corners (x1, y1, x2, y2) in any one unit.

/// Area of a box; 0 if it is inside out.
pub fn box_area(b: [f64; 4]) -> f64 {
    (b[2] - b[0]).max(0.0) * (b[3] - b[1]).max(0.0)
}

fn intersection(a: [f64; 4], b: [f64; 4]) -> f64 {
    box_area([a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])])
}

/// Intersection over union of two boxes; 0 if either has no area.
pub fn box_iou(a: [f64; 4], b: [f64; 4]) -> f64 {
    let common = intersection(a, b);
    if common > 0.0 { common / (box_area(a) + box_area(b) - common) } else { 0.0 }
}

/// Middle of a box.
pub fn center(b: [f64; 4]) -> [f64; 2] {
    [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0]
}

/// A box that is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Corners.
    pub bbox: [f64; 4],
    /// Area of what is in the box, by which [`Areas`] choose; at most the box's.
    pub area: f64,
    /// COCO's `iscrowd`: not one thing but a place with several. Whether one is found there counts
    /// neither way.
    pub crowd: bool,
    /// One thing that was not asked for: whether it is found counts neither way.
    pub ignored: bool,
}

impl Truth {
    /// One thing that fills its box.
    pub fn new(bbox: [f64; 4]) -> Self {
        Self { bbox, area: box_area(bbox), crowd: false, ignored: false }
    }

    /// Overlap with a found box: intersection over union, of which a crowd's is the found box's own
    /// area, as that may show any part of it.
    pub fn overlap(&self, found: [f64; 4]) -> f64 {
        match self.crowd {
            false => box_iou(self.bbox, found),
            true => {
                let intersection = intersection(self.bbox, found);
                if intersection > 0.0 { intersection / box_area(found) } else { 0.0 }
            }
        }
    }
}

/// A found box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredBox {
    /// Corners.
    pub bbox: [f64; 4],
    /// Confidence.
    pub score: f64,
}

/// The areas that count, both ends included; the COCO evaluation's, in square pixels. Other truths
/// are ignored as a crowd is, and so are found boxes of other areas that take no truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Areas {
    least: f64,
    most: f64,
}

impl Areas {
    /// All.
    pub const ALL: Self = Self { least: 0.0, most: 1e10 };
    /// Up to 32 × 32 pixels.
    pub const SMALL: Self = Self { least: 0.0, most: 32.0 * 32.0 };
    /// From 32 × 32 to 96 × 96 pixels.
    pub const MEDIUM: Self = Self { least: 32.0 * 32.0, most: 96.0 * 96.0 };
    /// From 96 × 96 pixels.
    pub const LARGE: Self = Self { least: 96.0 * 96.0, most: 1e10 };

    fn count(self, area: f64) -> bool {
        (self.least..=self.most).contains(&area)
    }
}

/// What a found box is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Hit {
    /// It takes a truth.
    Right,
    /// It takes none.
    Wrong,
    /// It counts neither way.
    Ignored,
}

/// What one picture holds of one class, and what was found of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PictureBoxes {
    /// The boxes that are there.
    pub truths: Vec<Truth>,
    /// The boxes that were found, in any order.
    pub found: Vec<ScoredBox>,
}

/// The COCO evaluation looks at so many found boxes of a class in a picture.
const MAX_FOUND: usize = 100;

impl PictureBoxes {
    /// For each truth that counts the found box that overlaps it most, among those with a score
    /// above `score`, and their intersection over union; `None` where none overlaps.
    pub fn best(&self, score: f64) -> Vec<(Truth, Option<(ScoredBox, f64)>)> {
        let best_of = |truth: &Truth| {
            let shown = self.found.iter().filter(|f| f.score > score);
            shown
                .map(|f| (*f, box_iou(truth.bbox, f.bbox)))
                .filter(|(_, iou)| *iou > 0.0)
                .max_by(|a, b| a.1.total_cmp(&b.1))
        };
        let asked = self.truths.iter().filter(|t| !t.crowd && !t.ignored);
        asked.map(|t| (*t, best_of(t))).collect()
    }

    /// The same with the found boxes that have a score above `score` alone.
    pub fn above(&self, score: f64) -> Self {
        let found = self.found.iter().filter(|f| f.score > score).copied().collect();
        Self { truths: self.truths.clone(), found }
    }

    /// Which truths are ignored.
    fn ignored(&self, areas: Areas) -> Vec<bool> {
        self.truths.iter().map(|t| t.crowd || t.ignored || !areas.count(t.area)).collect()
    }

    /// The found boxes' scores, best first, each with what it is: as in the COCO evaluation, each
    /// takes the free truth that it overlaps most, by at least `iou`, and the last of equal ones. An
    /// ignored truth is taken only by what can take no other, a crowd by any number.
    fn hits(&self, iou: f64, areas: Areas) -> Vec<(f64, Hit)> {
        let mut found = self.found.clone();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        found.truncate(MAX_FOUND);
        let ignored = self.ignored(areas);
        let mut free = vec![true; self.truths.len()];
        let take = |f: &ScoredBox| {
            let best_where = |ignore: bool| {
                let fits = |i: &usize| ignored[*i] == ignore && (free[*i] || self.truths[*i].crowd);
                let overlaps = (0..free.len()).filter(fits);
                let overlaps = overlaps.map(|i| (i, self.truths[i].overlap(f.bbox)));
                let best = overlaps.filter(|(_, overlap)| *overlap >= iou);
                best.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
            };
            let best = best_where(false).or_else(|| best_where(true));
            let hit = match best {
                Some(i) if ignored[i] => Hit::Ignored,
                Some(_) => Hit::Right,
                None if areas.count(box_area(f.bbox)) => Hit::Wrong,
                None => Hit::Ignored,
            };
            if let Some(i) = best {
                free[i] = false;
            }
            (f.score, hit)
        };
        found.iter().map(take).collect()
    }

    /// How many found boxes with a score above `score` take no truth at `iou`.
    pub fn false_alarms(&self, score: f64, iou: f64) -> usize {
        let hits = self.hits(iou, Areas::ALL);
        hits.iter().filter(|(s, hit)| *s > score && *hit == Hit::Wrong).count()
    }

    /// The found boxes that count, best first: score, and whether it takes a truth at `iou`.
    pub fn judged(&self, iou: f64) -> Vec<(f64, bool)> {
        let hits = self.hits(iou, Areas::ALL).into_iter();
        let counted = hits.filter(|(_, hit)| *hit != Hit::Ignored);
        counted.map(|(score, hit)| (score, hit == Hit::Right)).collect()
    }
}

/// The found boxes of many pictures that count, best first: all that average precision asks of them.
#[derive(Clone, Debug, Default)]
pub struct Ranking {
    /// Truths that count, by picture.
    truths: Vec<usize>,
    /// Picture, score, whether it takes a truth.
    hits: Vec<(usize, f64, bool)>,
}

impl Ranking {
    /// Of one class at one threshold of overlap. Equal scores stay in the order of `pictures`.
    pub fn new(pictures: &[PictureBoxes], iou: f64, areas: Areas) -> Self {
        let wanted =
            |p: &PictureBoxes| p.ignored(areas).iter().filter(|ignored| !**ignored).count();
        let truths = pictures.iter().map(wanted).collect();
        let hits = pictures.iter().enumerate().flat_map(|(i, p)| {
            let counted = p.hits(iou, areas).into_iter().filter(|(_, hit)| *hit != Hit::Ignored);
            counted.map(move |(score, hit)| (i, score, hit == Hit::Right))
        });
        let mut hits: Vec<_> = hits.collect();
        hits.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self { truths, hits }
    }

    /// Recall and the highest precision at or beyond it, box by box from the best. Picture `i` counts `copies(i)`
    /// times, as if it were there so often. `None` without truths.
    pub fn curve(&self, copies: impl Fn(usize) -> usize) -> Option<Vec<(f64, f64)>> {
        let truths: usize = self.truths.iter().enumerate().map(|(i, n)| n * copies(i)).sum();
        if truths == 0 {
            return None;
        }
        let (mut right, mut shown) = (0, 0);
        let mut curve: Vec<(f64, f64)> = Vec::with_capacity(self.hits.len());
        for (picture, _, is_right) in &self.hits {
            // Of equal ones in a row the last decides: right ones raise the precision, and wrong ones'
            // is hidden behind the higher one before.
            let n = copies(*picture);
            if n > 0 {
                shown += n;
                right += if *is_right { n } else { 0 };
                curve.push((right as f64 / truths as f64, right as f64 / shown as f64));
            }
        }
        for i in (1..curve.len()).rev() {
            curve[i - 1].1 = curve[i - 1].1.max(curve[i].1);
        }
        Some(curve)
    }

    /// Average precision as the COCO evaluation defines it: the mean of the highest precision at or
    /// beyond each of 101 recalls. `copies` and `None` as of [`curve`](Self::curve).
    pub fn average_precision(&self, copies: impl Fn(usize) -> usize) -> Option<f64> {
        let curve = self.curve(copies)?;
        let precision_at = |recall: f64| {
            let first = curve.partition_point(|(r, _)| *r < recall);
            curve.get(first).map_or(0.0, |(_, precision)| *precision)
        };
        // The recalls as numpy's linspace rounds them.
        Some((0..=100).map(|i| precision_at(f64::from(i) * 0.01)).sum::<f64>() / 101.0)
    }
}

/// Average precision of one class at one threshold of overlap, [`Ranking::average_precision`]. Equal
/// scores count in the order of `pictures`, which pycocotools takes in the order of their ids. `None`
/// without truths.
pub fn average_precision(pictures: &[PictureBoxes], iou: f64, areas: Areas) -> Option<f64> {
    Ranking::new(pictures, iou, areas).average_precision(|_| 1)
}

/// The overlaps 0.50, 0.55, … 0.95, as numpy's `linspace(0.5, 0.95, 10)` rounds them: a box whose
/// overlap is exactly 3/5 is right at the third or wrong by the last bit.
pub fn coco_overlaps() -> [f64; 10] {
    let step = (0.95 - 0.5) / 9.0;
    std::array::from_fn(|i| if i == 9 { 0.95 } else { i as f64 * step + 0.5 })
}

/// The mean of [`average_precision`] over [`coco_overlaps`]. `None` without truths.
pub fn average_precision_50_95(pictures: &[PictureBoxes], areas: Areas) -> Option<f64> {
    let at = |iou| average_precision(pictures, iou, areas);
    let sum: Option<f64> = coco_overlaps().into_iter().map(at).sum();
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
        let [a, b] = [[0.0, 0.0, 2.0, 2.0], [1.0, 0.0, 3.0, 2.0]];
        let crowd = Truth { crowd: true, ..Truth::new(a) };
        let picture = PictureBoxes {
            // Nobody is asked for the crowd.
            truths: vec![Truth::new(a), crowd, Truth::new(b), Truth::new([50.0, 50.0, 60.0, 60.0])],
            found: vec![
                scored(a, 0.9),
                // Right on the second truth, but not above the threshold.
                scored(b, 0.5),
            ],
        };
        let best: Vec<_> = picture.best(0.5).iter().map(|(_, b)| b.map(|(_, iou)| iou)).collect();
        assert_eq!(best, [Some(1.0), Some(1.0 / 3.0), None]);
        assert_eq!(picture.false_alarms(0.5, 0.5), 0);
        assert_eq!(picture.false_alarms(0.5, 1.1), 1);
    }

    #[test]
    fn what_falls_on_a_crowd_is_neither_right_nor_wrong() {
        let snap = [0.0, 0.0, 10.0, 10.0];
        let crowd = Truth { crowd: true, ..Truth::new([20.0, 0.0, 60.0, 40.0]) };
        // A quarter of the first lies outside: overlap 3/4 of its own area, 75 of 1700 by union.
        let on_crowd = [scored([20.0, 0.0, 30.0, 10.0], 0.9), scored([15.0, 0.0, 35.0, 9.0], 0.8)];
        assert_eq!(crowd.overlap(on_crowd[1].bbox), 0.75);
        let found = [&on_crowd[..], &[scored(snap, 0.7)]].concat();
        let picture = PictureBoxes { truths: vec![crowd, Truth::new(snap)], found };
        assert_eq!(picture.false_alarms(0.5, 0.5), 0);
        // At 0.8 the second is wrong: precision 1/2 at each recall.
        assert_eq!(picture.false_alarms(0.5, 0.8), 1);
        let pictures = [picture];
        assert_eq!(average_precision(&pictures, 0.5, Areas::ALL), Some(1.0));
        assert_eq!(average_precision(&pictures, 0.8, Areas::ALL), Some(0.5));
        // The snap is of 100 square pixels: among the large there is none.
        assert_eq!(average_precision(&pictures, 0.5, Areas::LARGE), None);
    }

    #[test]
    fn average_precision_by_hand() {
        let a = [0.0, 0.0, 10.0, 10.0];
        let b = [20.0, 0.0, 30.0, 10.0];
        let all = Areas::ALL;
        let nowhere = [90.0, 90.0, 99.0, 99.0];
        // Right, wrong, right: precision 1, 1/2, 2/3 at recall 1/2, 1/2, 1. So 1 at the 51 recalls
        // up to 0.50 and 2/3 at the other 50.
        let picture = PictureBoxes {
            truths: vec![Truth::new(a), Truth::new(b)],
            found: vec![scored(b, 0.3), scored(a, 0.9), scored(nowhere, 0.6)],
        };
        let ap = average_precision(std::slice::from_ref(&picture), 0.5, all).expect("truths");
        assert!((ap - (51.0 + 50.0 * 2.0 / 3.0) / 101.0).abs() < 1e-12, "{ap}");
        // The same box twice: the second is wrong.
        let found = vec![scored(a, 0.8), scored(a, 0.9)];
        let twice = PictureBoxes { truths: vec![Truth::new(a)], found };
        assert_eq!(twice.false_alarms(0.0, 0.5), 1);
        assert_eq!(average_precision(&[twice], 0.5, all), Some(1.0));
        // A picture without truths lowers precision where its box scores higher.
        let empty = PictureBoxes { truths: vec![], found: vec![scored(a, 0.95)] };
        let ap = average_precision(&[picture, empty.clone()], 0.5, all).expect("truths");
        assert!((ap - (51.0 * 0.5 + 50.0 * 0.5) / 101.0).abs() < 1e-12, "{ap}");
        assert_eq!(average_precision(&[empty], 0.5, all), None);
        let missed = PictureBoxes { truths: vec![Truth::new(a)], found: vec![] };
        assert_eq!(average_precision(&[missed], 0.5, all), Some(0.0));
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
                PictureBoxes { truths: truths.into_iter().map(Truth::new).collect(), found }
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
        let ap50 = average_precision(&pictures, 0.5, Areas::ALL).expect("truths");
        let ap = average_precision_50_95(&pictures, Areas::ALL).expect("truths");
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
