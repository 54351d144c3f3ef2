//! Whether scores and stated deviations hold.

use serde::Serialize;

use super::{LEAST_SCORE, RIGHT_IOU, Right, Seen};
use crate::evaluation::metrics::PictureBoxes;

/// Bins of equal width between the scores 0 and 1.
const BINS: usize = 10;
/// Parts of the right boxes, by stated deviation.
const PARTS: usize = 3;

/// How often boxes with some score are right: of the right class, on a snap that no better box has
/// taken.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reliability {
    /// Mean distance of a bin's mean score from its share of right boxes, weighted by boxes (Naeini
    /// et al. 2015); `None` without boxes.
    pub expected_error: Option<f64>,
    /// By score, those that hold boxes.
    pub bins: Vec<ScoreBin>,
}

/// Boxes with scores in a range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScoreBin {
    /// Scores from here.
    pub from: f64,
    /// Up to here.
    pub to: f64,
    /// Boxes.
    pub boxes: usize,
    /// Their mean score.
    pub mean_score: f64,
    /// Share of them that is right.
    pub right: f64,
}

/// Of all boxes that score above [`LEAST_SCORE`].
pub fn reliability(seen: &[Seen], classes: usize) -> Reliability {
    let mut bins = [(0_usize, 0.0, 0_usize); BINS];
    let judged = |picture: &Seen| {
        let of = |class| PictureBoxes::judged(&picture.of_class(class), RIGHT_IOU);
        (0..classes).flat_map(of).collect::<Vec<_>>()
    };
    for (score, right) in seen.iter().flat_map(judged).filter(|(s, _)| *s > LEAST_SCORE) {
        let bin = &mut bins[((score * BINS as f64) as usize).min(BINS - 1)];
        *bin = (bin.0 + 1, bin.1 + score, bin.2 + usize::from(right));
    }
    let all: usize = bins.iter().map(|bin| bin.0).sum();
    let off: f64 = bins.iter().map(|(_, scores, right)| (scores - *right as f64).abs()).sum();
    let shown = bins.iter().enumerate().filter(|(_, (boxes, ..))| *boxes > 0);
    let bins = shown.map(|(i, (boxes, scores, right))| ScoreBin {
        from: i as f64 / BINS as f64,
        to: (i + 1) as f64 / BINS as f64,
        boxes: *boxes,
        mean_score: scores / *boxes as f64,
        right: *right as f64 / *boxes as f64,
    });
    Reliability { expected_error: (all > 0).then(|| off / all as f64), bins: bins.collect() }
}

/// How many errors are within one stated standard deviation: of a normal distribution 68.3 %.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Deviations {
    /// Along x, of centres.
    pub x_mm: Vec<Third>,
    /// Along y, of centres.
    pub y_mm: Vec<Third>,
    /// Of directions of whole snaps.
    pub yaw_deg: Vec<Third>,
}

/// A third of the right boxes, by stated deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Third {
    /// Right boxes.
    pub boxes: usize,
    /// Least and greatest stated deviation.
    pub stated: [f64; 2],
    /// Share of the errors that are within their own.
    pub within: f64,
}

/// Of the right boxes with a score above `conf`, in thirds from the least stated deviation to the
/// greatest, for each axis and the direction by themselves. Empty where the weights state none.
pub fn deviations(seen: &[Seen], conf: f64) -> Deviations {
    let right = |picture: &'_ Seen| -> Vec<[Option<(f64, f64)>; 3]> {
        let three = |Right { found, off_mm, off_deg }: Right<'_>| {
            let on = |axis: usize| found.center_std_mm.map(|std| (std[axis], off_mm[axis].abs()));
            [on(0), on(1), found.yaw_std_deg.zip(off_deg.map(f64::abs))]
        };
        picture.best(conf).into_iter().filter_map(|(_, right)| right.map(three)).collect()
    };
    let all: Vec<[Option<(f64, f64)>; 3]> = seen.iter().flat_map(right).collect();
    let of = |kind: usize| thirds(all.iter().filter_map(|three| three[kind]).collect());
    Deviations { x_mm: of(0), y_mm: of(1), yaw_deg: of(2) }
}

/// Pairs of stated deviation and error, in parts of as equal numbers as can be.
fn thirds(mut pairs: Vec<(f64, f64)>) -> Vec<Third> {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let end = |part: usize| part * pairs.len() / PARTS;
    let parts = (0..PARTS).map(|part| &pairs[end(part)..end(part + 1)]);
    let of = |part: &[(f64, f64)]| {
        let (first, last) = (part.first()?, part.last()?);
        let within = part.iter().filter(|(stated, error)| error <= stated).count();
        let boxes = part.len();
        Some(Third { boxes, stated: [first.0, last.0], within: within as f64 / boxes as f64 })
    };
    parts.filter_map(of).collect()
}

/// The share of all errors within their stated deviation; `None` without any.
pub fn share_within(thirds: &[Third]) -> Option<f64> {
    let boxes: usize = thirds.iter().map(|third| third.boxes).sum();
    let within: f64 = thirds.iter().map(|third| third.within * third.boxes as f64).sum();
    (boxes > 0).then(|| within / boxes as f64)
}

#[cfg(test)]
mod tests {
    use super::super::Found;
    use super::super::tests::{found, seen, snap};
    use super::*;
    use crate::evaluation::coco::Attribute;

    #[test]
    fn expected_calibration_error_by_hand() {
        let one = |found: Vec<Found>| seen(vec![snap(0, 0.0, &[])], found);
        let pictures = [
            // Right with 0.9, and the same again: wrong with 0.8, since the snap is taken.
            one(vec![found(0, 0.0, 0.875), found(0, 1.0, 0.8125)]),
            // The right place in another class is wrong; 1 belongs to the last bin.
            one(vec![found(1, 0.0, 0.25), found(0, 0.0, 1.0)]),
            // An overlap of 5 / 15 is not enough; 0.05 is not looked at.
            one(vec![found(0, 5.0, 0.125), found(0, 0.0, 0.05)]),
        ];
        let got = reliability(&pictures, 2);
        // Bins 0.1: 0.125 and 0 of 1; 0.2: 0.25 and 0 of 1; 0.8: 0.84375 and 1 of 2; 0.9: 1 and 1 of 1.
        let shares: Vec<_> = got.bins.iter().map(|b| (b.boxes, b.mean_score, b.right)).collect();
        assert_eq!(shares, [(1, 0.125, 0.0), (1, 0.25, 0.0), (2, 0.84375, 0.5), (1, 1.0, 1.0)]);
        let error = (0.125 + 0.25 + 2.0 * 0.34375) / 5.0;
        assert_eq!(got.expected_error, Some(error));
        assert_eq!(reliability(&[], 2), Reliability { expected_error: None, bins: vec![] });
    }

    #[test]
    fn shares_within_stated_deviations_by_hand() {
        // Boxes that are off by 1 pixel in x, half a millimetre, and not in y; stated 0.1 to 0.7 mm.
        let picture = |i: u32| {
            let stated = f64::from(i + 1) / 10.0;
            let yaw = ("yaw_deg", Attribute::Number(10.0));
            let box_of = Found {
                center_std_mm: Some([stated, stated]),
                yaw_deg: Some(4.0),
                yaw_std_deg: (i < 2).then_some(5.0 + 2.0 * f64::from(i)),
                ..found(0, 1.0, 0.9)
            };
            seen(vec![snap(0, 0.0, &[yaw])], vec![box_of])
        };
        let pictures: Vec<Seen> = (0..7).map(picture).collect();
        let got = deviations(&pictures, 0.5);
        // Seven in parts of 2, 2 and 3: 0.1, 0.2; 0.3, 0.4; 0.5, 0.6, 0.7. Equality is within.
        let within =
            |thirds: &[Third]| thirds.iter().map(|t| (t.boxes, t.within)).collect::<Vec<_>>();
        assert_eq!(within(&got.x_mm), [(2, 0.0), (2, 0.0), (3, 1.0)]);
        assert_eq!(got.x_mm[2].stated, [0.5, 0.7]);
        assert_eq!(within(&got.y_mm), [(2, 1.0), (2, 1.0), (3, 1.0)]);
        // Off by 6°: within 7, not within 5. Two boxes fill no three parts.
        assert_eq!(within(&got.yaw_deg), [(1, 0.0), (1, 1.0)]);
        assert_eq!(share_within(&got.x_mm), Some(3.0 / 7.0));
        // A box below the threshold says nothing.
        assert_eq!(deviations(&pictures, 0.9).x_mm, []);
        assert_eq!(share_within(&[]), None);
    }
}
