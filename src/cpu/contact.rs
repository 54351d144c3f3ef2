//! Where something touches the gel.

use crate::tensor::Tensor;

/// What counts as contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRule {
    /// A cell may differ by so many levels from the middle of two others.
    pub threshold: f32,
    /// From this level on in all channels a cell shows nothing, so that it may hide a contact.
    pub clipped: f32,
}

impl ContactRule {
    /// Cells from one to each of the two with which it is compared.
    pub const REACH: usize = 4;
    /// Cells of a tile's side.
    pub const TILE: usize = 2;
    /// The level to which a reference frame is brought.
    pub const LEVEL: f32 = 128.0;
    /// Darker cells of a reference frame count as this level, lest their noise grow.
    pub const DARK: f32 = 16.0;
}

/// Which tiles of `cells` `[3, H, W]`, levels from 0 to 255, are in contact: row by row, a bit each, the
/// first the lowest of the first word.
///
/// Each cell is compared with the middle of the two at [`ContactRule::REACH`] from it on either side, across,
/// along, and on both diagonals; past the edge the edge's cells count. So light that changes evenly
/// over the gel cancels. With a `reference` of the same shape each cell is divided by its own there first.
pub fn contact(cells: &Tensor, reference: Option<&Tensor>, rule: ContactRule) -> Vec<u32> {
    let [height, width] = [1, 2].map(|i| cells.dims()[i]);
    let area = height * width;
    let value = |at: usize| {
        let level = f64::from(cells.data()[at]);
        reference.map_or(level, |reference| {
            let under = f64::from(reference.data()[at].max(ContactRule::DARK));
            level * f64::from(ContactRule::LEVEL) / under
        })
    };
    let reach = ContactRule::REACH as isize;
    let touched = |x: usize, y: usize| {
        let clipped = |c: usize| cells.data()[c * area + y * width + x] >= rule.clipped;
        let differs = |c: usize| {
            let at = |dx: isize, dy: isize| {
                let x = x.saturating_add_signed(dx).min(width - 1);
                let y = y.saturating_add_signed(dy).min(height - 1);
                value(c * area + y * width + x)
            };
            [(reach, 0), (0, reach), (reach, reach), (reach, -reach)].into_iter().any(|(dx, dy)| {
                let middle = (at(dx, dy) + at(-dx, -dy)) / 2.0;
                (at(0, 0) - middle).abs() > f64::from(rule.threshold)
            })
        };
        (0..3).all(clipped) || (0..3).any(differs)
    };
    let tile = ContactRule::TILE;
    let [rows, columns] = [height, width].map(|side| side.div_ceil(tile));
    let mut words = vec![0; (rows * columns).div_ceil(32)];
    for at in 0..rows * columns {
        let (x, y) = (at % columns * tile, at / columns * tile);
        let cells = |y| (x..(x + tile).min(width)).any(|x| touched(x, y));
        if (y..(y + tile).min(height)).any(cells) {
            words[at / 32] |= 1 << (at % 32);
        }
    }
    words
}
