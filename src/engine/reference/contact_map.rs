//! Where something touches the gel.

use crate::engine::tensor::Tensor;

/// What counts as contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRule {
    /// Share of the brightness by which an untouched tile may differ at least, however even the gel is.
    pub least: f32,
    /// And at most, however uneven it is.
    pub most: f32,
    /// From this level on in all channels a cell shows nothing, so that it may hide a contact.
    pub clipped: f32,
    /// Cells from one to each of the two with which it is compared.
    pub reach: u32,
    /// Touched tiles differ by more than so many times what the calmest quarter of all differs by.
    pub factor: f32,
}

impl ContactRule {
    /// Cells of a tile's side.
    pub const TILE: usize = 2;
    /// Darker surroundings count as this level, lest their noise grow.
    pub const DARK: f32 = 16.0;
    /// The level to which a reference frame is brought.
    pub const LEVEL: f32 = 128.0;
    /// Steps from `least` to `most`.
    pub const STEPS: usize = 32;
    /// What a tile with a clipped cell is taken to differ by.
    pub const HIDDEN: f32 = 1e9;

    /// The limit after so many steps.
    fn limit(&self, step: usize) -> f64 {
        let [least, most] = [self.least, self.most].map(f64::from);
        least + (most - least) * step as f64 / Self::STEPS as f64
    }
}

/// Which tiles of `cells` `[3, H, W]`, levels from 0 to 255, are in contact: row by row, a bit each, the
/// first the lowest of the first word.
///
/// Each cell is compared with the middle of the two at [`ContactRule::reach`] from it on either side, across,
/// along, and on both diagonals, as a share of that middle; past the edge the edge's cells count. So light
/// that changes evenly over the gel cancels, and its strength does. With a `reference` of the same shape each
/// cell is divided by its own there first. A tile differs by as much as the cell of it that differs most.
///
/// Clouds of the coating and noise are all over a gel, contact is here and there: a tile is touched if it
/// differs by more than a limit, the first of those between [`ContactRule::least`] and
/// [`ContactRule::most`] that is [`ContactRule::factor`] times what a quarter of the tiles stay below.
pub fn contact_map(cells: &Tensor, reference: Option<&Tensor>, rule: ContactRule) -> Vec<u32> {
    let [height, width] = [1, 2].map(|i| cells.dims()[i]);
    let differences = differences(cells, reference, rule);
    let calm = |limit: f64| {
        let under = differences.iter().filter(|d| **d * f64::from(rule.factor) <= limit);
        4 * under.count() >= differences.len()
    };
    let limits = (0..ContactRule::STEPS).map(|step| rule.limit(step));
    let limit = limits.into_iter().find(|limit| calm(*limit)).unwrap_or(f64::from(rule.most));
    let tiles = [height, width].map(|side| side.div_ceil(ContactRule::TILE));
    let mut words = vec![0; (tiles[0] * tiles[1]).div_ceil(32)];
    for (at, difference) in differences.into_iter().enumerate() {
        if difference > limit {
            words[at / 32] |= 1 << (at % 32);
        }
    }
    words
}

/// What each tile differs by, row by row.
fn differences(cells: &Tensor, reference: Option<&Tensor>, rule: ContactRule) -> Vec<f64> {
    let [height, width] = [1, 2].map(|i| cells.dims()[i]);
    let area = height * width;
    let dark = f64::from(ContactRule::DARK);
    let value = |at: usize| {
        let level = f64::from(cells.data()[at]);
        reference.map_or(level, |reference| {
            let under = f64::from(reference.data()[at]).max(dark);
            level * f64::from(ContactRule::LEVEL) / under
        })
    };
    let reach = rule.reach as isize;
    let of_cell = |x: usize, y: usize| {
        let is_clipped = |c: usize| cells.data()[c * area + y * width + x] >= rule.clipped;
        if (0..3).all(is_clipped) {
            return f64::from(ContactRule::HIDDEN);
        }
        let of_channel = |c: usize| {
            let at = |dx: isize, dy: isize| {
                let x = x.saturating_add_signed(dx).min(width - 1);
                let y = y.saturating_add_signed(dy).min(height - 1);
                value(c * area + y * width + x)
            };
            let pairs = [(reach, 0), (0, reach), (reach, reach), (reach, -reach)];
            let of_pair = |(dx, dy): (isize, isize)| {
                let middle = (at(dx, dy) + at(-dx, -dy)) / 2.0;
                (at(0, 0) - middle).abs() / middle.max(dark)
            };
            pairs.map(of_pair).into_iter().fold(0.0, f64::max)
        };
        (0..3).map(of_channel).fold(0.0, f64::max)
    };
    let tile = ContactRule::TILE;
    let [rows, columns] = [height, width].map(|side| side.div_ceil(tile));
    let of_tile = |at: usize| {
        let (x, y) = (at % columns * tile, at / columns * tile);
        let row = |y| (x..(x + tile).min(width)).map(|x| of_cell(x, y)).fold(0.0, f64::max);
        (y..(y + tile).min(height)).map(row).fold(0.0, f64::max)
    };
    (0..rows * columns).map(of_tile).collect()
}
