//! A non-maximum suppression on two sides that differ by rounding: which differences that explains.

use std::collections::{HashMap, HashSet};

use crate::engine::graph::TensorId;
use crate::engine::ops::Nms;
use crate::engine::ops::op::EPS;
use crate::engine::reference;
use crate::engine::tensor::Value;
use crate::error::Result;
use crate::smr::Choice;

/// What a row is about, on either side: an anchor, and a class or 0.
pub(super) type Id = (u32, u32);

/// Two choices by non-maximum suppression, compared row by row.
#[derive(Clone, Debug, Default)]
pub struct ChoiceComparison {
    /// How many the device chose.
    pub found: usize,
    /// How many the reference chose.
    pub expected: usize,
    /// What one side alone chose, or both in another order, where a comparison was as close to its
    /// threshold as the two sides' values are to each other.
    pub excused: Vec<String>,
    /// Differences that nothing excuses.
    pub failures: Vec<String>,
}

/// How far what a choice compares may be from the other side's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moved {
    /// A score.
    pub score: f64,
    /// A score's logit, by which the boxes are ordered.
    pub order: f64,
    /// A box's sides, in pixels of the network's input.
    pub side: f64,
}

/// A candidate on one side.
#[derive(Clone, Copy, Debug)]
struct Row {
    id: Id,
    bbox: [f32; 4],
    score: f32,
    order: f32,
    class: u32,
    /// Its place in the order in which the suppression goes through the candidates.
    rank: usize,
    kept: bool,
}

/// One side of a comparison.
#[derive(Debug)]
pub(super) struct Side {
    rule: Nms,
    rows: Vec<Row>,
    place: HashMap<Id, usize>,
    /// What was chosen, best first.
    pub chosen: Vec<Id>,
}

impl Side {
    /// Reads `choice` in one run's values; `ids` says what each candidate is.
    ///
    /// # Errors
    /// What `value` returns.
    pub fn new<'a>(
        choice: &Choice,
        ids: &[Id],
        value: impl Fn(TensorId) -> Result<&'a Value>,
    ) -> Result<Self> {
        let rule = choice.rule;
        let n = ids.len();
        let [boxes, scores, order] = [choice.boxes, choice.scores, choice.order].map(&value);
        let (boxes, scores) = (boxes?.f32()?, scores?.f32()?);
        let order = &order?.f32()?.data()[..n];
        let classes = choice.classes.map(|id| value(id)?.u32()).transpose()?;
        let kept = kept(choice, &value)?;
        let mut rows: Vec<_> = (0..n)
            .map(|i| Row {
                id: ids[i],
                bbox: std::array::from_fn(|side| boxes.data()[i * 4 + side]),
                score: scores.data()[i],
                order: order[i],
                class: classes.map_or(0, |c| c.data()[i]),
                rank: i,
                kept: false,
            })
            .collect();
        if !rule.sorted {
            for (rank, i) in reference::top_k(order, n).into_iter().enumerate() {
                rows[i as usize].rank = rank;
            }
        }
        let kept: Vec<_> = kept.into_iter().filter(|i| *i < n).collect();
        kept.iter().for_each(|i| rows[*i].kept = true);
        let place = ids.iter().enumerate().map(|(i, id)| (*id, i)).collect();
        let chosen = kept.iter().map(|i| ids[*i]).collect();
        Ok(Self { rule, rows, place, chosen })
    }

    fn row(&self, id: Id) -> Option<&Row> {
        self.place.get(&id).map(|i| &self.rows[*i])
    }

    /// The chosen that suppress `row`.
    fn suppressors(&self, row: &Row) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(move |k| {
            k.kept
                && k.rank < row.rank
                && k.class == row.class
                && reference::iou_above(k.bbox, row.bbox, self.rule.iou_threshold)
        })
    }
}

/// The places that a choice kept.
///
/// # Errors
/// What `value` returns.
pub(super) fn kept<'a>(
    choice: &Choice,
    value: impl Fn(TensorId) -> Result<&'a Value>,
) -> Result<Vec<usize>> {
    let count = value(choice.kept)?.u32()?.data()[0] as usize;
    let keep = value(choice.keep)?.u32()?.data();
    Ok(keep.iter().take(count).map(|i| *i as usize).collect())
}

/// How far apart the two sides' candidates of the same name are.
pub(super) fn moved(a: &Side, b: &Side) -> Moved {
    let mut moved = Moved { score: 0.0, order: 0.0, side: 0.0 };
    for (a, b) in a.rows.iter().filter_map(|row| Some((row, b.row(row.id)?))) {
        moved.score = moved.score.max(distance(a.score, b.score));
        moved.order = moved.order.max(distance(a.order, b.order));
        for (a, b) in a.bbox.into_iter().zip(b.bbox) {
            moved.side = moved.side.max(distance(a, b));
        }
    }
    moved
}

fn distance(a: f32, b: f32) -> f64 {
    (f64::from(a) - f64::from(b)).abs()
}

/// Holds what the device chose to what the reference chose. A difference is excused only if the
/// comparison that made it came as close to its threshold as `moved` says that the two sides are to
/// each other. `upstream` are those that one side alone had to choose from, for a reason that has
/// been looked into.
pub(super) fn compare(
    device: &Side,
    reference: &Side,
    moved: Moved,
    upstream: &HashSet<Id>,
) -> ChoiceComparison {
    let mut comparison = ChoiceComparison {
        found: device.chosen.len(),
        expected: reference.chosen.len(),
        ..ChoiceComparison::default()
    };
    for (whose, side, other) in
        [("the device", device, reference), ("the reference", reference, device)]
    {
        for row in side.chosen.iter().filter_map(|id| side.row(*id)) {
            if other.row(row.id).is_some_and(|r| r.kept) {
                continue;
            }
            let what = format!("{} is {whose}'s alone", name(row.id));
            match explain(row, side, other, moved, upstream) {
                Ok(why) => comparison.excused.push(format!("{what}: {why}")),
                Err(why) => comparison.failures.push(format!("{what}: {why}")),
            }
        }
    }
    for (a, b) in swapped(device, reference) {
        let apart = distance(a.order, b.order);
        let what = format!("{} and {} have changed places", name(a.id), name(b.id));
        match apart <= 2.0 * moved.order {
            true => comparison.excused.push(format!("{what}: their logits are {apart:.1e} apart")),
            false => {
                comparison.failures.push(format!("{what}: their logits are {apart:.1e} apart"))
            }
        }
    }
    comparison
}

/// Pairs that both sides chose, in another order.
fn swapped<'a>(device: &'a Side, reference: &Side) -> Vec<(&'a Row, &'a Row)> {
    let both: Vec<_> = device
        .chosen
        .iter()
        .filter_map(|id| Some((device.row(*id)?, reference.row(*id).filter(|r| r.kept)?.rank)))
        .collect();
    let pairs =
        both.iter().enumerate().flat_map(|(i, a)| both[i + 1..].iter().map(move |b| (a, b)));
    pairs.filter(|(a, b)| a.1 > b.1).map(|(a, b)| (a.0, b.0)).collect()
}

fn name((anchor, class): Id) -> String {
    match class {
        0 => format!("anchor {anchor}"),
        _ => format!("anchor {anchor} as class {class}"),
    }
}

/// Why `row`, which `side` chose, was not chosen on the `other` side: an excuse, or what is not one.
fn explain(
    row: &Row,
    side: &Side,
    other: &Side,
    moved: Moved,
    upstream: &HashSet<Id>,
) -> std::result::Result<String, String> {
    let rule = side.rule;
    let Some(there) = other.row(row.id) else {
        if upstream.contains(&row.id) {
            return Ok("its proposal was".into());
        }
        // The best candidates are as many on both sides; who is the last of them may differ.
        let last = side.rows.iter().map(|r| r.order).fold(f32::INFINITY, f32::min);
        let apart = distance(row.order, last);
        let why = format!("its logit is {apart:.1e} from the last candidate's");
        return if apart <= 2.0 * moved.order { Ok(why) } else { Err(why) };
    };
    let to_score = distance(there.score, rule.min_score);
    if there.score <= rule.min_score {
        let why = format!("its score is {to_score:.1e} from the threshold");
        return if to_score <= moved.score { Ok(why) } else { Err(why) };
    }
    let smallest = |b: [f32; 4]| (b[2] - b[0]).min(b[3] - b[1]);
    if smallest(there.bbox) < rule.min_size {
        let to_size = distance(smallest(there.bbox), rule.min_size);
        let why = format!("its size is {to_size:.1e} px from the smallest");
        return if to_size <= 2.0 * moved.side { Ok(why) } else { Err(why) };
    }
    let mut excuse = None;
    for k in other.suppressors(there) {
        let here = side.row(k.id);
        if let Some(here) = here.filter(|here| here.rank > row.rank) {
            // Who comes first suppresses the other.
            let apart = distance(here.order, row.order);
            let why = format!("its logit is {apart:.1e} from that of {}", name(k.id));
            if apart > 2.0 * moved.order {
                return Err(why);
            }
            excuse = Some(why);
        } else if let Some(here) = here.filter(|here| here.kept) {
            let threshold = f64::from(rule.iou_threshold);
            let overlaps = [iou(here.bbox, row.bbox), iou(k.bbox, there.bbox)];
            let bound = iou_bound(k.bbox, there.bbox, moved.side);
            let why =
                format!("its overlap with {} is {} and {}", name(k.id), overlaps[0], overlaps[1]);
            if overlaps.iter().any(|o| (o - threshold).abs() > bound) {
                return Err(why);
            }
            excuse = Some(why);
        } else {
            // It ranks before this one and is the other side's alone, which has a reason of its own.
            excuse = Some(format!("{} is the other's alone", name(k.id)));
        }
    }
    if let Some(excuse) = excuse {
        return Ok(excuse);
    }
    // Not suppressed: so there was no room for it.
    let last = other.chosen.last().and_then(|id| other.row(*id));
    if let Some(last) = last.filter(|_| other.chosen.len() == rule.max_out) {
        let apart = distance(there.order, last.order);
        if apart <= 2.0 * moved.order {
            return Ok(format!("its logit is {apart:.1e} from that of the last chosen"));
        }
        // A better one that is the other's alone took its place.
        let taken = other.chosen.iter().filter_map(|id| other.row(*id)).find(|k| {
            let here = side.row(k.id);
            !here.is_some_and(|here| here.kept) && here.is_none_or(|here| here.rank < row.rank)
        });
        if let Some(taken) = taken {
            return Ok(format!("{} took the last place", name(taken.id)));
        }
    }
    Err("nothing kept it from being chosen".into())
}

/// Intersection over union, in f64.
fn iou(a: [f32; 4], b: [f32; 4]) -> f64 {
    let (common, union, _) = areas(a, b);
    if union > 0.0 { common / union } else { 0.0 }
}

/// Intersection, union, and the sum of width and height of both boxes.
fn areas(a: [f32; 4], b: [f32; 4]) -> (f64, f64, f64) {
    let [a, b] = [a, b].map(|b| b.map(f64::from));
    let size = |b: [f64; 4]| [b[2] - b[0], b[3] - b[1]];
    let common: f64 = (0..2).map(|i| (a[i + 2].min(b[i + 2]) - a[i].max(b[i])).max(0.0)).product();
    let area = |b| size(b).iter().product::<f64>();
    let sides = size(a).iter().chain(&size(b)).sum();
    (common, area(a) + area(b) - common, sides)
}

/// How far the intersection over union may move if each side of both boxes moves by `side`: a length
/// then changes by up to 2·side, and so the areas w·h of both together by D = 2·side·Σ(w + h) +
/// 8·side². The intersection, in both boxes, changes by D/2, the union by 3D/2, and their quotient by
/// (D/2 + 3D/2) / (union − 3D/2). The comparison itself rounds six times.
fn iou_bound(a: [f32; 4], b: [f32; 4], side: f64) -> f64 {
    let (_, union, sides) = areas(a, b);
    let change = 2.0 * side * sides + 8.0 * side * side;
    2.0 * change / (union - 1.5 * change).max(f64::MIN_POSITIVE) + 6.0 * EPS
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: Nms = Nms {
        iou_threshold: 0.5,
        max_out: 3,
        min_score: 0.05,
        min_size: 1.0,
        sorted: false,
        order: false,
        classes: false,
        count: false,
    };
    /// What rounding may do in these tests.
    const MOVED: Moved = Moved { score: 1e-6, order: 1e-6, side: 1e-4 };

    /// A side that chose by `RULE` from boxes with scores; the place is the anchor.
    fn side(rows: &[([f32; 4], f32)]) -> Side {
        let named: Vec<_> = rows.iter().enumerate().map(|(i, row)| (i as u32, *row)).collect();
        named_side(&named)
    }

    fn named_side(rows: &[(u32, ([f32; 4], f32))]) -> Side {
        let (boxes, order): (Vec<_>, Vec<_>) = rows.iter().map(|row| row.1).unzip();
        let rule = reference::NmsRule {
            iou_threshold: RULE.iou_threshold,
            min_score: RULE.min_score,
            min_size: RULE.min_size,
        };
        let best = reference::top_k(&order, order.len());
        side_of(rows, &reference::nms(&boxes, &order, None, rule, &best, RULE.max_out))
    }

    fn side_of(rows: &[(u32, ([f32; 4], f32))], keep: &[u32]) -> Side {
        let order: Vec<_> = rows.iter().map(|row| row.1.1).collect();
        let ranks = reference::top_k(&order, order.len());
        let rank = |i: usize| ranks.iter().position(|r| *r as usize == i).unwrap_or(0);
        let row = |(i, (anchor, (bbox, order))): (usize, &(u32, ([f32; 4], f32)))| Row {
            id: (*anchor, 0),
            bbox: *bbox,
            score: *order,
            order: *order,
            class: 0,
            rank: rank(i),
            kept: keep.contains(&(i as u32)),
        };
        let rows: Vec<_> = rows.iter().enumerate().map(row).collect();
        let place = rows.iter().enumerate().map(|(i, r)| (r.id, i)).collect();
        let chosen = keep.iter().map(|i| rows[*i as usize].id).collect();
        Side { rule: RULE, rows, place, chosen }
    }

    /// Excuses and failures of two sides.
    fn counts(device: &Side, reference: &Side) -> (usize, usize) {
        let comparison = compare(device, reference, MOVED, &HashSet::new());
        println!("{comparison:?}");
        (comparison.excused.len(), comparison.failures.len())
    }

    /// A box of height 10 from `low` to `high`.
    fn span(low: f32, high: f32) -> [f32; 4] {
        [low, 0.0, high, 10.0]
    }

    #[test]
    fn equal_sides_have_nothing_to_excuse() {
        let rows = [(span(0.0, 10.0), 0.9), (span(20.0, 30.0), 0.8), (span(21.0, 30.0), 0.7)];
        assert_eq!(side(&rows).chosen, [(0, 0), (1, 0)]);
        assert_eq!(counts(&side(&rows), &side(&rows)), (0, 0));
        assert_eq!(moved(&side(&rows), &side(&rows)), Moved { score: 0.0, order: 0.0, side: 0.0 });
    }

    #[test]
    fn an_overlap_at_the_threshold_is_excused() {
        // 5 of 10 is not above one half; a hair more is.
        let at = |high: f32| side(&[(span(0.0, 10.0), 0.9), (span(0.0, high), 0.8)]);
        assert_eq!(counts(&at(5.0), &at(5.00001)), (1, 0));
        assert_eq!(counts(&at(5.00001), &at(5.0)), (1, 0));
        // A tenth of a pixel is more than the sides move: (0.1 · 10) / 100 against a bound of
        // 2 · 2e-4 · 35 / 100.
        assert_eq!(counts(&at(5.0), &at(5.1)), (0, 1));
    }

    #[test]
    fn what_follows_from_an_excused_difference_is_excused_too() {
        // The second suppresses the third, where the first lets it.
        let at = |high: f32| {
            side(&[(span(0.0, 10.0), 0.9), (span(0.0, high), 0.8), (span(0.0, 4.0), 0.7)])
        };
        assert_eq!(at(5.0).chosen, [(0, 0), (1, 0)]);
        assert_eq!(at(5.00001).chosen, [(0, 0), (2, 0)]);
        assert_eq!(counts(&at(5.0), &at(5.00001)), (2, 0));
        assert_eq!(counts(&at(5.0), &at(5.1)), (1, 1));
    }

    #[test]
    fn a_choice_without_a_reason_fails() {
        let rows = [(0, (span(0.0, 10.0), 0.9)), (1, (span(20.0, 30.0), 0.8))];
        let (whole, dropped) = (side_of(&rows, &[0, 1]), side_of(&rows, &[0]));
        assert_eq!(counts(&dropped, &whole), (0, 1));
        assert_eq!(counts(&whole, &dropped), (0, 1));
        // One that should have been suppressed.
        let rows = [(0, (span(0.0, 10.0), 0.9)), (1, (span(0.0, 9.0), 0.8))];
        assert_eq!(counts(&side_of(&rows, &[0, 1]), &side_of(&rows, &[0])), (0, 1));
    }

    #[test]
    fn a_score_at_the_threshold_is_excused() {
        let at = |score: f32| side(&[(span(0.0, 10.0), 0.9), (span(20.0, 30.0), score)]);
        assert_eq!(counts(&at(0.050_000_4), &at(0.049_999_8)), (1, 0));
        assert_eq!(counts(&at(0.051), &at(0.049)), (0, 1));
    }

    #[test]
    fn a_size_at_the_smallest_is_excused() {
        let at = |high: f32| side(&[(span(0.0, 10.0), 0.9), (span(20.0, high), 0.8)]);
        assert_eq!(counts(&at(21.00001), &at(20.99999)), (1, 0));
        assert_eq!(counts(&at(21.1), &at(20.9)), (0, 1));
    }

    #[test]
    fn two_change_places_only_if_their_scores_are_close() {
        let at = |a: f32, b: f32| side(&[(span(0.0, 10.0), a), (span(20.0, 30.0), b)]);
        assert_eq!(counts(&at(0.8, 0.800_000_2), &at(0.800_000_2, 0.8)), (1, 0));
        assert_eq!(counts(&at(0.8, 0.81), &at(0.81, 0.8)), (0, 1));
        // Two that overlap: the other one is chosen.
        let at = |a: f32, b: f32| side(&[(span(0.0, 10.0), a), (span(0.0, 9.0), b)]);
        assert_eq!(counts(&at(0.8, 0.800_000_2), &at(0.800_000_2, 0.8)), (2, 0));
        assert_eq!(counts(&at(0.8, 0.81), &at(0.81, 0.8)), (0, 2));
    }

    #[test]
    fn the_last_place_goes_to_the_better() {
        let apart = |i: usize| span(20.0 * i as f32, 20.0 * i as f32 + 10.0);
        let at = |c: f32, d: f32| {
            side(&[(apart(0), 0.9), (apart(1), 0.8), (apart(2), c), (apart(3), d)])
        };
        assert_eq!(counts(&at(0.5, 0.500_000_2), &at(0.500_000_2, 0.5)), (2, 0));
        assert_eq!(counts(&at(0.5, 0.51), &at(0.51, 0.5)), (0, 2));
        // One more before it leaves no room for the last.
        let at = |high: f32| {
            let first = [(span(0.0, 10.0), 0.9), (span(0.0, high), 0.8)];
            let others = [(apart(1), 0.7), (apart(2), 0.6)];
            side(&[first, others].concat())
        };
        assert_eq!(counts(&at(5.0), &at(5.00001)), (2, 0));
    }

    #[test]
    fn a_candidate_at_the_cut_is_excused() {
        let with = |anchor: u32, score: f32| {
            named_side(&[(0, (span(0.0, 10.0), 0.9)), (anchor, (span(20.0, 30.0), score))])
        };
        assert_eq!(counts(&with(1, 0.5), &with(2, 0.5)), (2, 0));
        let far = named_side(&[(3, (span(40.0, 50.0), 0.6)), (0, (span(0.0, 10.0), 0.5))]);
        let near = named_side(&[(0, (span(0.0, 10.0), 0.5))]);
        assert_eq!(counts(&far, &near), (0, 1));
        // Unless it was not there to be chosen, for a reason of its own.
        let upstream = HashSet::from([(3, 0)]);
        assert_eq!(compare(&far, &near, MOVED, &upstream).failures, [""; 0]);
    }

    #[test]
    fn overlap_moves_within_its_bound() {
        let (a, b) = ([0.0, 0.0, 10.0, 10.0], [0.0, 0.0, 5.0, 10.0]);
        assert_eq!(iou(a, b), 0.5);
        let side = 1e-3;
        // The larger box grows outwards, the smaller one inwards.
        let s = side as f32;
        let worst = iou([-s, -s, 10.0 + s, 10.0 + s], [s, s, 5.0 - s, 10.0 - s]);
        let bound = iou_bound(a, b, side);
        assert!(0.5 - worst < bound && bound < 5.0 * (0.5 - worst), "{worst} {bound}");
    }
}
