//! How well a detector does on labelled pictures: figures with their intervals, by condition, and
//! whether scores and stated deviations hold.
//!
//! [`figures`] are of any choice of pictures; [`by_condition`] has them of those that share something
//! that their labels state. Intervals hold 95 % of what the figures become on as many pictures, drawn
//! anew from those at hand with repetition (the bootstrap, Efron 1979): pictures, not snaps, since the
//! snaps of a picture share its conditions.

mod calibration;
pub mod coco;
mod condition;
pub mod metrics;
mod resample;
pub mod tradeoff;

use serde::Serialize;

use crate::detector::Detections;
use crate::evaluation::coco::{Attribute, Attributes};
use crate::evaluation::metrics::{
    Areas, PictureBoxes, Ranking, ScoredBox, Truth, average_precision_50_95, center,
};

pub use calibration::{
    Deviations, Reliability, ScoreBin, Third, deviations, reliability, share_within,
};
pub use condition::{Stratum, by_condition};
use resample::{Counts, Ordered};

/// Average precision and the scores' calibration look at detections down to this score, the
/// convention of Faster R-CNN.
pub const LEAST_SCORE: f64 = 0.05;
/// A box is right if it overlaps a snap of its class by this much.
pub const RIGHT_IOU: f64 = 0.5;

/// A snap that is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Snap {
    /// Its class.
    pub class: usize,
    /// Where it is, in pixels.
    pub truth: Truth,
    /// What its label states besides.
    pub attributes: Attributes,
}

impl Snap {
    fn number(&self, name: &str) -> Option<f64> {
        self.attributes.get(name).and_then(Attribute::number)
    }
}

/// A snap that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Its class.
    pub class: usize,
    /// Corners in pixels, and the score.
    pub scored: ScoredBox,
    /// Stated standard deviation of the centre in millimetres, along x and y.
    pub center_std_mm: Option<[f64; 2]>,
    /// Direction in degrees.
    pub yaw_deg: Option<f64>,
    /// Its stated standard deviation.
    pub yaw_std_deg: Option<f64>,
}

/// A picture, what it shows and what was found in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// What is there.
    pub snaps: Vec<Snap>,
    /// What was found, of all scores above [`LEAST_SCORE`].
    pub found: Vec<Found>,
    /// Millimetres on the gel for a pixel.
    pub mm_per_pixel: f64,
    /// Under which conditions it was taken.
    pub conditions: Attributes,
}

/// A found box that is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Right<'a> {
    /// The box.
    pub found: &'a Found,
    /// From the truth to the found centre, in millimetres.
    pub off_mm: [f64; 2],
    /// The truth's direction to the found one, in degrees from −180 to 180; of a whole snap alone,
    /// since half a hook may leave none to be seen.
    pub off_deg: Option<f64>,
}

impl Seen {
    /// A picture, its labels' categories the network's classes ([`coco::Dataset::of_classes`]), and what
    /// was found in it.
    pub fn new(labelled: &coco::Picture, found: &Detections) -> Self {
        let mut conditions = labelled.conditions.clone();
        if let Some(mm_per_pixel) = labelled.mm_per_pixel.map(f64::from) {
            let longer = f64::from(found.gel.width.max(found.gel.height));
            conditions.insert("pixels_per_mm".into(), Attribute::Number(1.0 / mm_per_pixel));
            conditions.insert("field_mm".into(), Attribute::Number(longer * mm_per_pixel));
        }
        let snaps = labelled.labels.iter().map(|label| Snap {
            class: label.category,
            truth: label.truth,
            attributes: label.attributes.clone(),
        });
        let boxes = found.detections.iter().map(|d| Found {
            class: d.class_index,
            scored: ScoredBox { bbox: d.bbox.map(f64::from), score: d.score.into() },
            center_std_mm: d.center_std_mm.map(|std| std.map(f64::from)),
            yaw_deg: d.yaw_deg.map(f64::from),
            yaw_std_deg: d.yaw_std_deg.map(f64::from),
        });
        Self {
            snaps: snaps.collect(),
            found: boxes.collect(),
            mm_per_pixel: found.scale.mm_per_pixel.into(),
            conditions,
        }
    }

    /// The picture's snaps and found boxes of one class.
    fn of_class(&self, class: usize) -> PictureBoxes {
        let truths = self.snaps.iter().filter(|s| s.class == class).map(|s| s.truth);
        let found = self.found.iter().filter(|f| f.class == class).map(|f| f.scored);
        PictureBoxes { truths: truths.collect(), found: found.collect() }
    }

    /// Overlap of each snap that counts with the best box of its class that scores above `conf`, and
    /// the box where it is right.
    pub fn best(&self, conf: f64) -> Vec<(f64, Option<Right<'_>>)> {
        let counted = self.snaps.iter().filter(|s| !s.truth.crowd && !s.truth.ignored);
        let best_of = |snap: &Snap| {
            let rivals = self.found.iter().filter(|f| f.class == snap.class);
            let overlaps = rivals
                .filter(|f| f.scored.score > conf)
                .map(|f| (f, snap.truth.overlap(f.scored.bbox)));
            let Some((found, overlap)) = overlaps.max_by(|a, b| a.1.total_cmp(&b.1)) else {
                return (0.0, None);
            };
            let ([x, y], [u, v]) = (center(snap.truth.bbox), center(found.scored.bbox));
            let off_mm = [u - x, v - y].map(|pixels| pixels * self.mm_per_pixel);
            let cut = snap.attributes.get("whole") == Some(&Attribute::Flag(false));
            let yaws = snap.number("yaw_deg").zip(found.yaw_deg).filter(|_| !cut);
            let off_deg =
                yaws.map(|(truth, found)| (found - truth + 180.0).rem_euclid(360.0) - 180.0);
            let right = (overlap >= RIGHT_IOU).then_some(Right { found, off_mm, off_deg });
            (overlap, right)
        };
        counted.map(best_of).collect()
    }

    /// Boxes of any class with a score above `conf` that are on no snap of theirs.
    fn false_boxes(&self, classes: usize, conf: f64) -> usize {
        (0..classes).map(|class| self.of_class(class).false_alarms(conf, RIGHT_IOU)).sum()
    }

    /// How bad it is: what the snaps' overlaps lack of 1, and 1 for each false box; 0 where all is
    /// right to the pixel.
    pub fn badness(&self, classes: usize, conf: f64) -> f64 {
        let lack: f64 = self.best(conf).iter().map(|(overlap, _)| 1.0 - overlap).sum();
        lack + self.false_boxes(classes, conf) as f64
    }
}

/// A figure's middle and the end of its worst twentieth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Half are below.
    pub median: Option<f64>,
    /// Nineteen of twenty are below.
    pub percentile_95: Option<f64>,
}

/// Figures of some pictures. What needs a snap, or a right box, is `None` without one.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Pictures that were looked at.
    pub pictures: usize,
    /// Snaps that count.
    pub snaps: usize,
    /// Mean overlap of a snap with its best box; a miss counts 0.
    pub mean_best_iou: Option<f64>,
    /// Average precision at an overlap of one half, the mean over the classes that have snaps.
    pub ap50: Option<f64>,
    /// Its mean over the COCO evaluation's ten overlaps.
    pub ap50_95: Option<f64>,
    /// Distance of centres of right boxes, in millimetres.
    pub center_error_mm: Errors,
    /// How far centres of right boxes lie towards the light, in millimetres, the mean over the pictures
    /// whose labels state that light comes from one side; negative towards the shadow.
    pub bias_to_light_mm: Option<f64>,
    /// Angle between the directions of whole snaps and those of their right boxes, in degrees.
    pub yaw_error_deg: Errors,
    /// Snaps with a right box above the threshold.
    pub right: usize,
    /// Boxes above the threshold that are on no snap.
    pub false_alarms: usize,
    /// The same in pictures without any snap.
    pub without_snap: WithoutSnap,
    /// Where 95 % of the figures of resampled pictures lie.
    pub interval_95: Intervals,
}

/// What is seen where no snap is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct WithoutSnap {
    /// Pictures without a snap of any class.
    pub pictures: usize,
    /// Those with a box above the threshold.
    pub with_false: usize,
    /// Boxes above the threshold there.
    pub false_alarms: usize,
}

/// Lower and upper ends, of what has a figure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Intervals {
    /// Of [`Figures::mean_best_iou`].
    pub mean_best_iou: Option<[f64; 2]>,
    /// Of [`Figures::ap50`].
    pub ap50: Option<[f64; 2]>,
    /// Of [`Figures::center_error_mm`]'s median.
    pub center_median_mm: Option<[f64; 2]>,
    /// Of its 95th percentile.
    pub center_percentile_95_mm: Option<[f64; 2]>,
    /// Of [`Figures::yaw_error_deg`]'s median.
    pub yaw_median_deg: Option<[f64; 2]>,
    /// Of its 95th percentile.
    pub yaw_percentile_95_deg: Option<[f64; 2]>,
}

/// Figures of `classes` over some pictures; `conf` is the score that a box must exceed in all but the
/// average precision, which looks at all above [`LEAST_SCORE`]. The same pictures give the same
/// intervals.
pub fn figures(seen: &[Seen], classes: &[usize], conf: f64) -> Figures {
    let mut figures = Figures { pictures: seen.len(), ..Figures::default() };
    let (mut overlaps, mut distances, mut angles) = (Vec::new(), Vec::new(), Vec::new());
    let mut to_light = Vec::new();
    for (i, picture) in seen.iter().enumerate() {
        let mine: Vec<Snap> =
            picture.snaps.iter().filter(|s| classes.contains(&s.class)).cloned().collect();
        let view = Seen { snaps: mine, ..picture.clone() };
        let light = picture.conditions.get("light_deg").and_then(Attribute::number);
        for (overlap, right) in view.best(conf) {
            overlaps.push((i, overlap));
            if let Some(Right { off_mm: [x, y], off_deg, .. }) = right {
                distances.push((i, x.hypot(y)));
                let light = light.map(f64::to_radians);
                to_light.extend(light.map(|light| x * light.cos() + y * light.sin()));
                angles.extend(off_deg.map(|angle| (i, angle.abs())));
            }
        }
        let alarms: usize =
            classes.iter().map(|c| picture.of_class(*c).false_alarms(conf, RIGHT_IOU)).sum();
        figures.false_alarms += alarms;
        if picture.snaps.is_empty() {
            figures.without_snap.pictures += 1;
            figures.without_snap.with_false += usize::from(alarms > 0);
            figures.without_snap.false_alarms += alarms;
        }
    }
    // Whatever `conf` is.
    let boxes = |class: &usize| -> Vec<PictureBoxes> {
        seen.iter().map(|picture| picture.of_class(*class).above(LEAST_SCORE)).collect()
    };
    let boxes: Vec<Vec<PictureBoxes>> = classes.iter().map(boxes).collect();
    let rankings: Vec<Ranking> =
        boxes.iter().map(|b| Ranking::new(b, RIGHT_IOU, Areas::ALL)).collect();

    let (distances, angles) = (Ordered::new(distances), Ordered::new(angles));
    let iou = |counts: &Counts| counts.mean(&overlaps);
    let ap50 = |counts: &Counts| {
        mean(rankings.iter().filter_map(|r| r.average_precision(|i| counts.of(i))))
    };
    let once = Counts::once(seen.len());
    let errors = |of: &Ordered| Errors {
        median: of.quantile(&once, 0.5),
        percentile_95: of.quantile(&once, 0.95),
    };
    figures.snaps = overlaps.len();
    figures.right = distances.len();
    figures.mean_best_iou = iou(&once);
    figures.ap50 = ap50(&once);
    figures.ap50_95 = mean(boxes.iter().filter_map(|b| average_precision_50_95(b, Areas::ALL)));
    figures.center_error_mm = errors(&distances);
    figures.yaw_error_deg = errors(&angles);
    figures.bias_to_light_mm = mean(to_light.into_iter());
    let [
        mean_best_iou,
        ap50,
        center_median_mm,
        center_percentile_95_mm,
        yaw_median_deg,
        yaw_percentile_95_deg,
    ] = resample::intervals(seen.len(), |counts| {
        [
            iou(counts),
            ap50(counts),
            distances.quantile(counts, 0.5),
            distances.quantile(counts, 0.95),
            angles.quantile(counts, 0.5),
            angles.quantile(counts, 0.95),
        ]
    });
    figures.interval_95 = Intervals {
        mean_best_iou,
        ap50,
        center_median_mm,
        center_percentile_95_mm,
        yaw_median_deg,
        yaw_percentile_95_deg,
    };
    figures
}

/// Recall and precision of a class at an overlap of [`RIGHT_IOU`], box by box from the best
/// ([`Ranking::curve`]); nothing without a snap of that class.
pub fn precision_recall(seen: &[Seen], class: usize) -> Vec<(f64, f64)> {
    let boxes: Vec<_> = seen.iter().map(|p| p.of_class(class).above(LEAST_SCORE)).collect();
    Ranking::new(&boxes, RIGHT_IOU, Areas::ALL).curve(|_| 1).unwrap_or_default()
}

/// What snaps are taken for: of each of `classes` how many snaps that count are best overlapped, by at least
/// [`RIGHT_IOU`], by a box above `conf` of each class, and by none.
pub fn confusion(seen: &[Seen], classes: usize, conf: f64) -> Vec<Vec<usize>> {
    let mut counts = vec![vec![0; classes + 1]; classes];
    for picture in seen {
        for snap in picture.snaps.iter().filter(|s| !s.truth.crowd && !s.truth.ignored) {
            let over = picture.found.iter().filter(|f| f.scored.score > conf);
            let over = over.map(|f| (f.class, snap.truth.overlap(f.scored.bbox)));
            let best = over.filter(|(_, iou)| *iou >= RIGHT_IOU).max_by(|a, b| a.1.total_cmp(&b.1));
            counts[snap.class][best.map_or(classes, |(class, _)| class)] += 1;
        }
    }
    counts
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0), |(sum, n), value| (sum + value, n + 1));
    (n > 0).then(|| sum / f64::from(n))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub const SIDE: f64 = 10.0;

    /// A snap of 10 × 10 pixels at x, with attributes.
    pub fn snap(class: usize, x: f64, attributes: &[(&str, Attribute)]) -> Snap {
        let attributes = attributes.iter().map(|(n, a)| ((*n).to_owned(), a.clone())).collect();
        Snap { class, truth: Truth::new([x, 0.0, x + SIDE, SIDE]), attributes }
    }

    /// A box of that size at x.
    pub fn found(class: usize, x: f64, score: f64) -> Found {
        let scored = ScoredBox { bbox: [x, 0.0, x + SIDE, SIDE], score };
        Found { class, scored, center_std_mm: None, yaw_deg: None, yaw_std_deg: None }
    }

    pub fn seen(snaps: Vec<Snap>, found: Vec<Found>) -> Seen {
        Seen { snaps, found, mm_per_pixel: 0.5, conditions: Attributes::new() }
    }

    fn yaw(degrees: f64) -> (&'static str, Attribute) {
        ("yaw_deg", Attribute::Number(degrees))
    }

    #[test]
    fn figures_by_hand() {
        // Off by 2 of 10 pixels: 8 of 12, 1 mm at half a millimetre a pixel; 20° across the cut.
        let turned = Found { yaw_deg: Some(-170.0), ..found(0, 2.0, 0.9) };
        let first = seen(vec![snap(0, 0.0, &[yaw(170.0)])], vec![turned, found(1, 50.0, 0.8)]);
        // The best box is of another class, or does not score enough.
        let second =
            seen(vec![snap(0, 0.0, &[yaw(0.0)])], vec![found(1, 0.0, 0.9), found(0, 0.0, 0.5)]);
        // Nothing there: one false box, one below the threshold.
        let empty = seen(vec![], vec![found(0, 0.0, 0.6), found(0, 30.0, 0.3)]);
        let got = figures(&[first, second, empty.clone(), seen(vec![], vec![])], &[0, 1], 0.5);
        assert_eq!((got.pictures, got.snaps, got.right, got.false_alarms), (4, 2, 1, 3));
        let expected = WithoutSnap { pictures: 2, with_false: 1, false_alarms: 1 };
        assert_eq!(got.without_snap, expected);
        let iou = got.mean_best_iou.expect("snaps");
        assert!((iou - 8.0 / 12.0 / 2.0).abs() < 1e-12, "{iou}");
        assert_eq!(got.center_error_mm.median, Some(1.0));
        assert_eq!(got.yaw_error_deg.percentile_95, Some(20.0));
        // By score: right 0.9, wrong 0.6, right 0.5: precision 1 up to half, then 2/3. Class 1 has no
        // snap and no average precision.
        let ap = got.ap50.expect("snaps");
        assert!((ap - (51.0 + 50.0 * 2.0 / 3.0) / 101.0).abs() < 1e-12, "{ap}");

        let nothing = figures(&[empty], &[0, 1], 0.5);
        assert_eq!((nothing.mean_best_iou, nothing.ap50), (None, None));
        assert_eq!(nothing.interval_95, Intervals::default());
        assert_eq!(figures(&[], &[0, 1], 0.5), Figures::default());
    }

    #[test]
    fn precision_falls_with_recall_and_snaps_are_taken_for_others() {
        // By score: right, wrong, right; one snap of three is not found.
        let first = seen(
            vec![snap(0, 0.0, &[]), snap(0, 30.0, &[]), snap(0, 60.0, &[])],
            vec![found(0, 0.0, 0.9), found(0, 90.0, 0.8), found(0, 31.0, 0.7), found(1, 60.0, 0.6)],
        );
        let pictures = [first, seen(vec![snap(1, 0.0, &[])], vec![found(1, 0.0, 0.4)])];
        // The precision of 1/2 at the second box is hidden behind the 2/3 of the third.
        let expected = [(1.0 / 3.0, 1.0), (1.0 / 3.0, 2.0 / 3.0), (2.0 / 3.0, 2.0 / 3.0)];
        assert_eq!(precision_recall(&pictures, 0), expected);
        assert_eq!(precision_recall(&pictures[..1], 1), []);
        assert_eq!(confusion(&pictures, 2, 0.5), [[2, 1, 0], [0, 0, 1]]);
    }

    #[test]
    fn a_cut_hook_has_no_yaw_error_but_a_place() {
        let cut = ("whole", Attribute::Flag(false));
        let turned = Found { yaw_deg: Some(90.0), ..found(0, 0.0, 0.9) };
        let got = figures(&[seen(vec![snap(0, 0.0, &[yaw(0.0), cut])], vec![turned])], &[0], 0.5);
        assert_eq!((got.center_error_mm.median, got.yaw_error_deg.median), (Some(0.0), None));
    }

    /// 1 mm to the right under light from the lower right, 45°: 0.71 mm towards it; under light from above
    /// none; and where nobody says it does not count.
    #[test]
    fn a_box_off_to_the_light_is_biased() {
        let under = |light: Option<f64>, x: f64| {
            let mut picture = seen(vec![snap(0, 0.0, &[])], vec![found(0, x, 0.9)]);
            let light = light.map(|deg| ("light_deg".to_owned(), Attribute::Number(deg)));
            picture.conditions.extend(light);
            picture
        };
        let pictures = [under(Some(45.0), 2.0), under(Some(-90.0), 2.0), under(None, 2.0)];
        let bias = figures(&pictures, &[0], 0.5).bias_to_light_mm.expect("light");
        assert!((bias - 0.5f64.sqrt() / 2.0).abs() < 1e-12, "{bias}");
        assert_eq!(figures(&pictures[2..], &[0], 0.5).bias_to_light_mm, None);
    }

    #[test]
    fn intervals_are_of_pictures() {
        // Overlaps of 1 and 0 half and half: the mean of n draws is binomial, with a deviation of
        // 0.5 / √n, so 95 % lie within 1.96 of these, up to the steps of 1/n and the draws' own scatter.
        let n = 100;
        let picture = |i: usize| {
            let hit = if i.is_multiple_of(2) { vec![found(0, 0.0, 0.9)] } else { vec![] };
            seen(vec![snap(0, 0.0, &[])], hit)
        };
        let pictures: Vec<Seen> = (0..n).map(picture).collect();
        let got = figures(&pictures, &[0], 0.5);
        let [low, high] = got.interval_95.mean_best_iou.expect("snaps");
        let half = 1.96 * 0.5 / (n as f64).sqrt();
        assert!((low - (0.5 - half)).abs() < 0.02 && (high - (0.5 + half)).abs() < 0.02);
        // Found at all scores alike: precision 1 up to the recall of the draw.
        assert_eq!(got.ap50, Some(51.0 / 101.0));
        // Without scatter there is no width.
        assert_eq!(got.interval_95.center_median_mm, Some([0.0, 0.0]));
        // A picture with two snaps counts as one draw: the interval is as wide as before.
        let doubled: Vec<Seen> = pictures
            .iter()
            .map(|p| {
                let mut p = p.clone();
                p.snaps.push(snap(0, 0.0, &[]));
                p
            })
            .collect();
        let twice = figures(&doubled, &[0], 0.5).interval_95.mean_best_iou;
        assert_eq!(twice, Some([low, high]));
        assert_eq!(figures(&pictures, &[0], 0.5), got, "the same pictures, the same intervals");
    }

    /// Three pixels of half a millimetre further right and four further down.
    #[test]
    fn a_box_off_to_below_is_off() {
        let scored = ScoredBox { bbox: [3.0, 4.0, 43.0, 44.0], score: 0.9 };
        let truth = Truth::new([0.0, 0.0, 40.0, 40.0]);
        let snap = Snap { truth, ..snap(0, 0.0, &[]) };
        let got =
            figures(&[seen(vec![snap], vec![Found { scored, ..found(0, 0.0, 0.9) }])], &[0], 0.5);
        assert_eq!(got.center_error_mm.median, Some(2.5));
    }
}
