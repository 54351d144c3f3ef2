//! Where something touches the gel, before the network runs.

use std::sync::Arc;

use crate::detector::Config;
use crate::detector::input::Input;
use crate::detector::pool::Pool;
use crate::detector::runner::{Given, On, Runner};
use crate::engine::gpu::Deadline;
use crate::engine::graph::{Graph, StageTime, TensorId};
use crate::engine::lower::KernelChoice;
use crate::engine::ops::{ContactMap, CropResize};
use crate::engine::precision::Precision;
use crate::engine::reference::{ContactRule, Crop, contact_map, crop_resize};
use crate::engine::shape::MAX_PIXELS;
use crate::engine::shape::{Extent, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;
use crate::sensor::frame::Frame;
use crate::sensor::rect::Rect;
use crate::sensor::view::View;

/// Side of a cell in millimetres.
const CELL_MM: f64 = 0.5;
/// By what share of the brightness a tile differs from the gel half a millimetre round it where something
/// touches: more than `factor` times what the calmest quarter of the tiles does, and than `least`, or than
/// `most` in any case. Edges of an imprint are sharp, the shade and the bulge of gel that is pressed
/// elsewhere are not. Set by the even ones of the 48 presses of tests/data/gelsight_ball_presses, judged by
/// the odd ones (`tests/savings.rs`); `factor` by the faintest of 2003 simulated snaps, which one a twentieth
/// higher shows too.
const OWN: ContactMap = ContactMap {
    least: 0.008,
    most: 0.06,
    factor: 3.1,
    reach: 1,
    clipped: CLIPPED,
    reference: false,
};
/// The same against a reference frame: what a press moves elsewhere, a crease or the coating, shows more.
const AGAINST: ContactMap =
    ContactMap { least: 0.015, most: 0.08, factor: 6.0, reference: true, ..OWN };
/// Share of the brightness by which a tile of a stream changes through noise alone, compared over a
/// millimetre. What is overexposed stays so: that alone is no change.
const CHANGED: ContactMap = ContactMap {
    least: 0.0234,
    most: 0.0234,
    factor: 1.0,
    reach: 2,
    clipped: f32::MAX,
    reference: true,
};
/// Level from which a cell is overexposed.
const CLIPPED: f32 = 250.0;
/// Touched tiles in a square of 3 × 3, past the edge the edge's, that make its middle a part of a contact;
/// scratches, dust and hairs have fewer.
const CORE: usize = 6;
/// How many of these must be tiles of the gel: a mark in its corner repeats past both edges.
const CORE_SEEN: usize = 3;
/// Touched tiles in a square of 7 × 7 that do so too: a ring with a thin wall fills no smaller one.
const RING: usize = 10;
/// Tiles from that square's middle to its sides.
const RING_REACH: usize = 3;
/// Tiles from there to touched ones that belong to the same contact, along x and y.
const SKIRT: usize = 2;

/// Where something touches: whether it does for each tile, a square millimetre of gel, row by row.
#[derive(Debug)]
pub(crate) struct TileMap {
    touched: Vec<bool>,
    /// Rows and columns of tiles.
    pub tiles: [usize; 2],
    /// Rows and columns of cells, half a tile each; the last tile may hold one of them alone.
    pub cells: [usize; 2],
}

impl TileMap {
    /// The map of words with a bit for each tile, without scratches and the like.
    fn new(words: &[u32], tiles: [usize; 2], cells: [usize; 2]) -> Self {
        let [rows, columns] = tiles;
        let bit = |x: usize, y: usize| {
            let at = y * columns + x;
            words.get(at / 32).is_some_and(|word| word >> (at % 32) & 1 == 1)
        };
        // The place at an offset, or the nearest one at the edge.
        let near = |at: usize, by: usize, all: usize| (at + by).saturating_sub(1).min(all - 1);
        let places = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        // The square of tiles within `reach` of a place, as far as there are any.
        let around = |(x, y): (usize, usize), reach: usize| {
            let side = |at: usize, all: usize| at.saturating_sub(reach)..(at + reach + 1).min(all);
            let across = side(x, columns);
            side(y, rows).flat_map(move |y| across.clone().map(move |x| (x, y)))
        };
        let is_core = |(x, y): (usize, usize)| {
            let square = (0..9).filter(|i| bit(near(x, i % 3, columns), near(y, i / 3, rows)));
            let seen = |reach: usize| around((x, y), reach).filter(|(x, y)| bit(*x, *y)).count();
            let is_core = square.count() >= CORE && seen(1) >= CORE_SEEN;
            bit(x, y) && (is_core || seen(RING_REACH) >= RING)
        };
        let core: Vec<bool> = places.clone().map(is_core).collect();
        let belongs = |(x, y): (usize, usize)| {
            bit(x, y) && around((x, y), SKIRT).any(|(x, y)| core[y * columns + x])
        };
        Self { touched: places.map(belongs).collect(), tiles, cells }
    }

    /// The touched tiles, by column and row.
    pub fn touched(&self) -> impl Iterator<Item = [usize; 2]> {
        let columns = self.tiles[1];
        let places = self.touched.iter().enumerate().filter(|(_, touched)| **touched);
        places.map(move |(at, _)| [at % columns, at / columns])
    }

    pub fn is_empty(&self) -> bool {
        self.touched().next().is_none()
    }
}

/// What touches the gel in a frame.
pub(crate) struct Contact {
    pub tiles: TileMap,
    /// Whether something is not as it was in the frame before; `true` without one.
    pub changed: bool,
    /// The frame's cells, if streams ask for them.
    pub cells: Option<Value>,
    pub stages: Vec<StageTime>,
}

/// What is compared, which decides what must be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Key {
    /// Rows and columns of cells.
    pub cells: [usize; 2],
    /// Whether there is a frame without contact.
    pub reference: bool,
    /// Whether a stream compares frames.
    pub stream: bool,
}

/// The small graph that maps contact, and what runs it.
pub(crate) struct ContactGraph {
    key: Key,
    graph: Graph,
    runner: Runner,
    picture: TensorId,
    crop: TensorId,
    reference: Option<TensorId>,
    before: Option<TensorId>,
    cells: TensorId,
    words: TensorId,
    changed: Option<TensorId>,
}

/// Rows and columns of cells for what a view shows.
pub(super) fn cells(view: &View) -> [usize; 2] {
    let side = |pixels: u32| {
        let cells = f64::from(pixels) * f64::from(view.scale.mm_per_pixel) / CELL_MM;
        (cells.round() as usize).max(1)
    };
    [side(view.part.height), side(view.part.width)]
}

/// Whether the mean of `frames` frames' cells differs from those `before` by more than the mean's noise.
pub(super) fn has_changed(mean: &Tensor, before: &Tensor, frames: u32) -> bool {
    let [least, most] = [CHANGED.least, CHANGED.most].map(|share| share / (frames as f32).sqrt());
    let rule = ContactRule { least, most, ..CHANGED.rule() };
    contact_map(mean, Some(before), rule).iter().any(|word| *word != 0)
}

/// The resize of a frame to cells, in levels.
fn resize([height, width]: [usize; 2]) -> CropResize {
    CropResize { width, height, mean: [0.0; 3], std: [1.0 / 255.0; 3] }
}

/// So many cells, in rows and columns, of a frame without contact, of which `part` shows what is compared.
///
/// # Errors
/// As [`Frame::bytes`].
pub(super) fn reference_cells(frame: &Frame, part: Rect, size: [usize; 2]) -> Result<Value> {
    let (bytes, all) = frame.bytes(part)?;
    let [height, width] = size;
    let (op, crop) = (resize(size), Crop { resized: [width, height], ..all });
    Ok(crop_resize(&bytes, crop, size, op.mean, op.std).into())
}

impl ContactGraph {
    pub async fn new(
        config: &Config,
        key: Key,
        pool: Option<&Arc<Pool>>,
        kernels: &KernelChoice,
    ) -> Result<Self> {
        let [height, width] = key.cells;
        let spec = TensorSpec::f32([3, height, width]);
        let mut graph = Graph::default();
        let picture = graph.input("picture", TensorSpec::u32([MAX_PIXELS]), Extent::UpTo);
        let crop = graph.input("crop", TensorSpec::u32([Crop::WORDS]), Extent::Exact);
        graph.begin_stage("contact");
        let cells = graph.apply1("contact.cells", resize(key.cells), &[picture, crop])?;
        let mut against = |name: &str, wanted: bool| {
            wanted.then(|| graph.input(name, spec.clone(), Extent::Exact))
        };
        let reference = against("contact.reference", key.reference);
        let before = against("contact.before", key.stream);
        let op = if key.reference { AGAINST } else { OWN };
        let inputs: Vec<_> = [cells].into_iter().chain(reference).collect();
        let words = graph.apply1("contact", op, &inputs)?;
        graph.mark_output(words);
        let changed = match before {
            None => None,
            Some(before) => {
                let changed = graph.apply1("contact.changed", CHANGED, &[cells, before])?;
                graph.mark_output(changed);
                graph.mark_output(cells);
                Some(changed)
            }
        };
        // A limit lies within f16's rounding of a level.
        let on = pool.map(|pool| On { pool, precision: Precision::F32, batch: 1 });
        let runner = Runner::new(config, &graph, &[], on, kernels, None).await?;
        Ok(Self { key, graph, runner, picture, crop, reference, before, cells, words, changed })
    }

    /// Looks for contact in a picture: against `reference`, and for what changed since `before`.
    ///
    /// # Errors
    /// What running returns.
    pub async fn run(
        &self,
        input: &Input<'_>,
        reference: Option<&Value>,
        before: Option<&Value>,
        deadline: Deadline,
    ) -> Result<Contact> {
        let [height, width] = self.key.cells;
        let crop = input.resized([width, height])?;
        let mut inputs = vec![(self.picture, &input.pixels), (self.crop, &crop)];
        inputs.extend(self.reference.zip(reference));
        let nothing = before.is_none();
        // The first frame of a stream is compared with anything.
        let blank: Value;
        if let Some(id) = self.before {
            inputs.push(match before {
                Some(before) => (id, before),
                None => {
                    blank = Tensor::<f32>::zeros([3, height, width]).into();
                    (id, &blank)
                }
            });
        }
        let picture = input.borrowed.map(|bytes| (self.picture, bytes));
        let given = Given { inputs: &inputs, picture };
        let (mut values, stages) = self.runner.run(&self.graph, &[], given, deadline).await?;
        let words = |id: TensorId| match values.get(&id) {
            Some(Value::U32(words)) => words.data().to_vec(),
            _ => Vec::new(),
        };
        let changed = self.changed.is_none_or(|id| nothing || words(id).iter().any(|w| *w != 0));
        let cells = self.key.cells;
        let tiles = TileMap::new(&words(self.words), ContactMap::tiles(cells), cells);
        Ok(Contact { tiles, changed, cells: values.remove(&self.cells), stages })
    }
}

#[cfg(test)]
impl TileMap {
    /// A map in which these tiles are touched, by column and row.
    pub fn of(tiles: [usize; 2], touched: &[[usize; 2]]) -> Self {
        let all = (0..tiles[0] * tiles[1]).map(|at| [at % tiles[1], at / tiles[1]]);
        let touched = all.map(|tile| touched.contains(&tile)).collect();
        Self { touched, tiles, cells: tiles.map(|side| 2 * side) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map of 8 × 6 tiles from rows of a picture.
    fn seen(rows: [&str; 6]) -> Vec<[usize; 2]> {
        let bits = rows.concat();
        let mut words = [0; 2];
        for at in bits.bytes().enumerate().filter(|(_, byte)| *byte == b'#').map(|(at, _)| at) {
            words[at / 32] |= 1 << (at % 32);
        }
        TileMap::new(&words, [6, 8], [12, 16]).touched().collect()
    }

    /// A line two tiles wide in places has 5 of 9; one tile more makes three of its tiles cores, and the rest
    /// is near them, but for what lies three further on.
    #[test]
    fn a_scratch_is_no_contact() {
        let line = ["........", ".#......", ".##.....", "..##....", "...##...", "........"];
        assert!(seen(line).is_empty());
        let more = ["........", ".#......", ".###....", "..##....", "...##..#", "........"];
        let want = [[1, 1], [1, 2], [2, 2], [3, 2], [2, 3], [3, 3], [3, 4], [4, 4]];
        assert_eq!(seen(more), want);
    }

    /// No square of 3 × 3 holds more than three of a ring's twelve tiles; of an arc there are nine in all.
    #[test]
    fn a_thin_ring_is_contact() {
        let ring = ["........", "..####..", ".#....#.", ".#....#.", "..####..", "........"];
        assert_eq!(seen(ring).len(), 12);
        let arc = ["........", "..####..", ".#....#.", ".#....#.", "..#.....", "........"];
        assert!(seen(arc).is_empty());
    }

    /// What the edge cuts goes on beyond it: of a strip one tile wide each has six of nine.
    #[test]
    fn a_contact_that_the_edge_cuts() {
        let strip = ["........", "........", "........", "........", "........", ".####..."];
        assert_eq!(seen(strip), [[1, 5], [2, 5], [3, 5], [4, 5]]);
        let inside = ["........", "........", "........", "........", ".####...", "........"];
        assert!(seen(inside).is_empty());
    }

    /// A mark in the corner: of its own four tiles two, repeated past both edges six of nine.
    #[test]
    fn two_tiles_in_a_corner_are_no_contact() {
        let mark = ["......##", "........", "........", "........", "........", "........"];
        assert!(seen(mark).is_empty());
        let three = ["......##", ".......#", "........", "........", "........", "........"];
        assert_eq!(seen(three).len(), 3);
    }

    /// Ten tiles of a ring, of which no square of 3 × 3 holds more than three.
    #[test]
    fn ten_tiles_of_a_ring_are_contact() {
        let arc = ["........", "..####..", ".#....#.", ".#....#.", "..##....", "........"];
        assert_eq!(seen(arc).len(), 10);
    }

    #[test]
    fn the_last_tile_counts() {
        let corner = ["........", "........", "........", "........", "......##", "......##"];
        assert_eq!(seen(corner), [[6, 4], [7, 4], [6, 5], [7, 5]]);
    }

    fn view(width: u32, height: u32, mm: f32) -> View {
        let gel = Rect { x: 10, y: 20, width: 500, height: 500 };
        View {
            frame: [600, 600],
            gel,
            gel_assumed: false,
            part: Rect { x: 30, y: 40, width, height },
            scale: crate::sensor::scale::Scale::stated(mm),
            lens: crate::sensor::Lens::of([0.0; 2], [600.0; 2], 0.0),
        }
    }

    /// 30.6 and 14.8 cells, 30.4 and 14.2, and at least one.
    #[test]
    fn cells_are_half_millimetres_of_the_part() {
        assert_eq!(cells(&view(306, 148, 0.05)), [15, 31]);
        assert_eq!(cells(&view(304, 142, 0.05)), [14, 30]);
        assert_eq!(cells(&view(1, 400, 0.05)), [40, 1]);
    }

    /// Three channels of so many cells at a level of 100, but for one cell, counted by column and row.
    fn even_but([height, width]: [usize; 2], [x, y]: [usize; 2], level: f32) -> Tensor {
        Tensor::from_fn([3, height, width], |i| {
            let at = i % (height * width);
            if (at % width, at / width) == (x, y) { level } else { 100.0 }
        })
    }

    /// 2.34 % of one frame, half of that of the mean of four.
    #[test]
    fn of_four_frames_the_mean_may_differ_by_half() {
        let (before, mean) = (even_but([20; 2], [9, 9], 100.0), even_but([20; 2], [9, 9], 101.8));
        assert!(has_changed(&mean, &before, 4) && !has_changed(&mean, &before, 1));
        let little = even_but([20; 2], [9, 9], 101.1);
        assert!(!has_changed(&little, &before, 4));
    }

    /// 21 × 21 cells are 11 × 11 tiles, of which the last holds one cell; the other cell is the lower right
    /// one of its tile.
    #[test]
    fn the_last_of_an_odd_number_of_cells_counts() {
        let rule =
            ContactRule { least: 0.05, most: 0.05, clipped: f32::MAX, reach: 2, factor: 3.0 };
        for (cell, tile) in [([20, 20], 120), ([5, 5], 2 * 11 + 2), ([20, 7], 3 * 11 + 10)] {
            let words = contact_map(&even_but([21; 2], cell, 200.0), None, rule);
            assert_eq!(words.len(), 4);
            assert!(words[tile / 32] >> (tile % 32) & 1 == 1, "{cell:?}: {words:?}");
        }
        assert_eq!(ContactMap::tiles([21, 4]), [11, 2]);
    }

    /// A square's corners see four of nine, its sides six: what lies two tiles before a side belongs to it, what
    /// lies three before does not.
    #[test]
    fn two_tiles_round_a_core_belong_to_it() {
        let square = ["........", "...###..", ".#.###..", "...###..", "........", "........"];
        assert!(seen(square).contains(&[1, 2]));
        let square = ["........", "...###..", "#..###..", "...###..", "........", "........"];
        assert_eq!(seen(square).len(), 9);
        let below = [".#......", "........", "###.....", "###.....", "###.....", "........"];
        assert!(seen(below).contains(&[1, 0]));
    }
}
