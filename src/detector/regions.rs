//! Which parts of the network's input are computed, and what several parts saw of one snap.

use crate::detector::contact_map::TileMap;
use crate::detector::geometry::{Geometry, Region};
use crate::detector::output::RegionDetection;
use crate::detector::{Detection, Savings};

/// Sides of parts in pixels of the network's input: few, as each size has an engine of its own.
const SIDES: [usize; 9] = [64, 96, 128, 160, 192, 256, 320, 384, 512];
/// Corners are multiples of this: the cells in which the network proposes boxes are then those of the
/// whole.
const GRID: usize = 8;
/// What a part costs beside its area, as a share of the whole: the network's last stages read all their weights
/// for maps however small.
const EACH: f64 = 0.06;
/// Tiles that may lie between two contacts of one snap: a slot, or the flat of a face.
const BETWEEN: usize = 3;
/// Share of a box that another one covers if both are of one snap.
const COVERED: f32 = 0.7;

/// A box in pixels: its first and last column and row.
#[derive(Clone, Copy, Debug)]
struct Extent {
    from: [f64; 2],
    to: [f64; 2],
}

impl Extent {
    fn with(&self, other: &Self) -> Self {
        Self {
            from: [0, 1].map(|axis| self.from[axis].min(other.from[axis])),
            to: [0, 1].map(|axis| self.to[axis].max(other.to[axis])),
        }
    }

    /// The region that holds it, with `margin` on all sides as far as the input reaches.
    fn region(&self, margin: [f64; 2], [height, width]: [usize; 2]) -> Region {
        let side = |axis: usize, full: usize| {
            let from = (self.from[axis] - margin[axis]).max(0.0) as usize / GRID * GRID;
            let to = ((self.to[axis] + margin[axis]).ceil() as usize).min(full);
            let from = from.min(full - 1) / GRID * GRID;
            let needed = to.saturating_sub(from);
            let fitting = SIDES.into_iter().find(|side| *side >= needed && *side < full);
            let length = fitting.unwrap_or(full);
            let at = from.saturating_sub((length - needed.min(length)) / 2 / GRID * GRID);
            (at.min(full - length), length)
        };
        let ((x, width), (y, height)) = (side(0, width), side(1, height));
        Region { x, y, width, height }
    }
}

/// The parts that show all contact with its margin; `None` where they would cost more than the whole, or
/// nearly.
pub(super) fn regions(
    map: &TileMap,
    geometry: &Geometry,
    savings: &Savings,
) -> Option<Vec<Region>> {
    let [rows, columns] = map.cells;
    let scale =
        [geometry.resized[0] as f64 / columns as f64, geometry.resized[1] as f64 / rows as f64];
    // A cell has half a millimetre.
    let margin = scale.map(|pixels| 2.0 * f64::from(savings.margin_mm) * pixels);
    let all = [columns, rows];
    let extent = |tiles: &[[usize; 2]]| {
        let one = |[x, y]: &[usize; 2]| Extent {
            from: [0, 1].map(|axis| (2 * [x, y][axis]) as f64 * scale[axis]),
            to: [0, 1].map(|axis| (2 * [x, y][axis] + 2).min(all[axis]) as f64 * scale[axis]),
        };
        tiles.iter().map(one).reduce(|a, b| a.with(&b))
    };
    let near = (savings.margin_mm.ceil() as usize).max(BETWEEN);
    let groups = groups(map, near);
    let mut parts: Vec<Extent> = groups.iter().filter_map(|tiles| extent(tiles)).collect();
    let region = |part: &Extent| part.region(margin, geometry.size);
    let full = (geometry.size[0] * geometry.size[1]) as f64;
    let cost = |part: &Extent| region(part).area() as f64 / full + EACH;
    while let Some((i, j)) = pair(&parts, |a, b| cost(&a.with(b)) <= cost(a) + cost(b)) {
        let other = parts.swap_remove(j);
        parts[i] = parts[i].with(&other);
    }
    let total: f64 = parts.iter().map(cost).sum();
    (total <= f64::from(savings.most_of_input)).then(|| parts.iter().map(region).collect())
}

/// The first pair that `fits`.
fn pair(parts: &[Extent], fits: impl Fn(&Extent, &Extent) -> bool) -> Option<(usize, usize)> {
    let pairs = (0..parts.len()).flat_map(|i| (i + 1..parts.len()).map(move |j| (i, j)));
    pairs.into_iter().find(|(i, j)| fits(&parts[*i], &parts[*j]))
}

/// The touched tiles, together where at most `near` tiles lie between them.
fn groups(map: &TileMap, near: usize) -> Vec<Vec<[usize; 2]>> {
    let [rows, columns] = map.tiles;
    let mut left = vec![false; rows * columns];
    map.touched().for_each(|[x, y]| left[y * columns + x] = true);
    let mut groups = Vec::new();
    for first in map.touched() {
        let mut group = Vec::new();
        let mut open = Vec::new();
        if std::mem::take(&mut left[first[1] * columns + first[0]]) {
            open.push(first);
        }
        while let Some([x, y]) = open.pop() {
            group.push([x, y]);
            let around =
                |at: usize, all: usize| at.saturating_sub(near + 1)..(at + near + 2).min(all);
            for y in around(y, rows) {
                for x in around(x, columns) {
                    if std::mem::take(&mut left[y * columns + x]) {
                        open.push([x, y]);
                    }
                }
            }
        }
        if !group.is_empty() {
            groups.push(group);
        }
    }
    groups
}

/// Leaves one detection of each snap that several parts saw: a whole one before one that its part cuts, then
/// the better. Best first, at most `most`.
pub(super) fn merged(mut found: Vec<RegionDetection>, iou: f32, most: usize) -> Vec<Detection> {
    found.sort_by(|a, b| a.cut.cmp(&b.cut).then(b.margin.total_cmp(&a.margin)));
    let mut kept: Vec<RegionDetection> = Vec::new();
    for one in found {
        let same = |other: &RegionDetection| {
            other.part != one.part
                && other.detection.class_index == one.detection.class_index
                && overlap(other.detection.bbox, one.detection.bbox, iou)
        };
        if !kept.iter().any(same) {
            kept.push(one);
        }
    }
    kept.sort_by(|a, b| b.margin.total_cmp(&a.margin));
    kept.into_iter().take(most).map(|found| found.detection).collect()
}

/// Whether two boxes overlap by more than `iou`, or one covers most of the other.
fn overlap(a: [f32; 4], b: [f32; 4], iou: f32) -> bool {
    let area = |b: [f32; 4]| (b[2] - b[0]).max(0.0) * (b[3] - b[1]).max(0.0);
    let both = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
    let (both, a, b) = (area(both), area(a), area(b));
    both > iou * (a + b - both) || both > COVERED * a.min(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 × 40 mm at 8 pixels a millimetre.
    const SQUARE: Geometry = Geometry { resized: [320; 2], size: [320; 2] };
    const SAVINGS: Savings = Savings { margin_mm: 4.0, most_of_input: 0.5, ..Savings::ALL };

    fn seen(touched: &[[usize; 2]]) -> Option<Vec<Region>> {
        regions(&TileMap::of([40, 40], touched), &SQUARE, &SAVINGS)
    }

    /// Tiles of 8 pixels and a margin of 32: tiles 10 to 17 are pixels 80 to 144, with margin 48 to 176,
    /// which is 128 long.
    #[test]
    fn a_contact_in_the_middle() {
        let got = seen(&[[10, 20], [17, 20]]).expect("a part");
        // One row, 160 to 168: with margin 128 to 200 are 72 pixels, in 96 that begin 8 earlier.
        assert_eq!(got, [Region { x: 48, y: 120, width: 128, height: 96 }]);
    }

    #[test]
    fn contacts_at_the_edges() {
        // Pixels 0 to 8, with margin to 40.
        assert_eq!(seen(&[[0, 0]]), Some(vec![Region { x: 0, y: 0, width: 64, height: 64 }]));
        let corner = Region { x: 256, y: 256, width: 64, height: 64 };
        assert_eq!(seen(&[[39, 39]]), Some(vec![corner]));
    }

    #[test]
    fn far_contacts_have_parts_of_their_own_and_near_ones_share() {
        assert_eq!(seen(&[[2, 2], [35, 35]]).map(|w| w.len()), Some(2));
        // Four tiles lie between them, as far as the margin.
        assert_eq!(seen(&[[2, 2], [7, 2]]).map(|w| w.len()), Some(1));
        // Five do; but a part for both is cheaper than two.
        assert_eq!(seen(&[[2, 2], [8, 2]]).map(|w| w.len()), Some(1));
    }

    #[test]
    fn much_contact_is_the_whole() {
        // 64 × 64 of 320 × 320 are 0.04, 96 × 96 in the middle 0.09, and each costs 0.06 more: four are 0.4,
        // five 0.55.
        let corners = [[2, 2], [37, 37], [2, 37], [37, 2], [20, 20]];
        assert_eq!(seen(&corners[..4]).map(|w| w.len()), Some(4));
        assert_eq!(seen(&corners), None);
        let diagonal: Vec<_> = (0..40).map(|i| [i, i]).collect();
        assert_eq!(seen(&diagonal), None);
        assert_eq!(
            regions(
                &TileMap::of([40, 40], &[[2, 2]]),
                &SQUARE,
                &Savings { most_of_input: 0.09, ..SAVINGS }
            ),
            None
        );
    }

    /// Parts that leave doubt are paid for beside the whole.
    #[test]
    fn parts_that_save_little_are_not_tried() {
        let parts = |touched: &[[usize; 2]]| {
            regions(
                &TileMap::of([40, 40], touched),
                &SQUARE,
                &Savings { margin_mm: 4.0, ..Savings::default() },
            )
        };
        let corners = [[2, 2], [37, 37], [2, 37], [37, 2], [20, 20], [20, 30]];
        // 0.1 each; the two in the middle share one of 0.21.
        assert_eq!(parts(&corners[..4]).map(|w| w.len()), Some(4));
        assert_eq!(parts(&corners), None);
    }

    /// A field that is no multiple of 32 pixels: 25 mm are 200, and the input has 224.
    #[test]
    fn an_input_that_repeats_its_edge() {
        let geometry = Geometry { resized: [200, 160], size: [160, 224] };
        let map = TileMap::of([20, 25], &[[24, 19]]);
        let got = regions(&map, &geometry, &SAVINGS).expect("a part");
        // Pixels 192 to 200 and margin up to 224: from 160, 64 long; 120 up to 160 in 64.
        assert_eq!(got, [Region { x: 160, y: 96, width: 64, height: 64 }]);
    }

    /// Its logit is to be the score's, as far as order goes.
    fn found(part: usize, score: f32, bbox: [f32; 4], cut: bool) -> RegionDetection {
        let detection = Detection {
            class: "A".into(),
            class_index: 0,
            score,
            bbox,
            center_mm: [0.0; 2],
            center_std_mm: None,
            yaw_deg: None,
            yaw_std_deg: None,
            whole: None,
        };
        RegionDetection { detection, margin: score, part, cut }
    }

    #[test]
    fn of_two_boxes_of_one_snap_the_whole_one_stays() {
        let whole = found(0, 0.8, [10.0, 10.0, 50.0, 30.0], false);
        let cut = found(1, 0.9, [30.0, 10.0, 50.0, 30.0], true);
        let other = found(1, 0.7, [100.0, 10.0, 140.0, 30.0], false);
        let kept = merged(vec![cut, whole, other], 0.5, 100);
        assert_eq!(kept.iter().map(|d| d.score).collect::<Vec<_>>(), [0.8, 0.7]);
        // Within a part the network has decided.
        let twins = || [0.9, 0.8].map(|s| found(0, s, [10.0, 10.0, 50.0, 30.0], false)).into();
        assert_eq!(merged(twins(), 0.5, 100).len(), 2);
        assert_eq!(merged(twins(), 0.5, 1).len(), 1);
    }

    /// Two parts see the same place, one an A there and one a B: nothing says that they are one snap.
    #[test]
    fn boxes_of_two_classes_are_two_snaps() {
        let bbox = [10.0, 10.0, 50.0, 30.0];
        let of_class = |class_index: usize, part: usize, score: f32| {
            let found = found(part, score, bbox, false);
            RegionDetection { detection: Detection { class_index, ..found.detection }, ..found }
        };
        let three = [of_class(0, 0, 0.9), of_class(1, 1, 0.8), of_class(0, 2, 0.7)];
        let kept = merged(three.into(), 0.5, 100);
        let kept: Vec<_> = kept.iter().map(|d| (d.class_index, d.score)).collect();
        assert_eq!(kept, [(0, 0.9), (1, 0.8)]);
    }

    /// 10 × 20 of the first are 1/4 of both together, and half of the second: too little of either for one
    /// snap, unless less overlap is enough.
    #[test]
    fn boxes_that_overlap_less_are_two_snaps() {
        let two = || -> Vec<RegionDetection> {
            let first = found(0, 0.9, [10.0, 10.0, 40.0, 30.0], false);
            vec![first, found(1, 0.8, [30.0, 10.0, 50.0, 30.0], false)]
        };
        assert_eq!(merged(two(), 0.26, 100).len(), 2);
        assert_eq!(merged(two(), 0.24, 100).len(), 1);
    }

    #[test]
    fn of_equal_scores_the_logit_decides() {
        let sure = |part: usize, margin: f32, bbox: [f32; 4]| RegionDetection {
            margin,
            ..found(part, 1.0, bbox, false)
        };
        let (near, far) = ([10.0, 10.0, 50.0, 30.0], [100.0, 10.0, 140.0, 30.0]);
        let nearer = near.map(|side| side + 1.0);
        let three = vec![sure(0, 19.0, far), sure(0, 20.0, near), sure(1, 21.0, nearer)];
        let kept: Vec<_> = merged(three, 0.5, 100).into_iter().map(|d| d.bbox).collect();
        assert_eq!(kept, [nearer, far]);
    }

    /// Two inputs long and one high for the same number of millimetres: cells of 4 × 8 pixels. Tile (10, 5) is
    /// columns 80 to 88 and rows 80 to 96, and a millimetre 8 × 16 pixels. Parts are 64 long: of the 40 and 16
    /// pixels that are over half lies before, in whole eights.
    #[test]
    fn each_axis_has_a_scale_of_its_own() {
        let geometry = Geometry { resized: [320, 160], size: [160, 320] };
        let savings = Savings { margin_mm: 1.0, ..SAVINGS };
        let got = regions(&TileMap::of([10, 40], &[[10, 5]]), &geometry, &savings).expect("a part");
        assert_eq!(got, [Region { x: 56, y: 56, width: 64, height: 64 }]);
    }
}
