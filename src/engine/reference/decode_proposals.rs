//! Proposals from the region proposal head.

use crate::engine::reference::decode_box;
use crate::engine::tensor::Tensor;

/// Anchors of a feature map.
#[derive(Clone, Copy, Debug)]
pub struct AnchorGrid<'a> {
    /// Anchors of one cell, around the origin.
    pub cell: &'a [[f32; 4]],
    /// Pixels between cells.
    pub stride: f32,
    /// Cells in a row.
    pub width: usize,
}

impl AnchorGrid<'_> {
    /// The anchor of `index` = (y · width + x) · anchors + anchor, and which of its cell it is.
    pub fn anchor(&self, index: usize) -> ([f32; 4], usize) {
        let (anchor, position) = (index % self.cell.len(), index / self.cell.len());
        let [x, y] = [position % self.width, position / self.width].map(|p| p as f32 * self.stride);
        let [x1, y1, x2, y2] = self.cell[anchor];
        ([x1 + x, y1 + y, x2 + x, y2 + y], anchor)
    }

    /// The four deltas of `index` in `deltas [4 · anchors, H, W]`.
    pub fn deltas(&self, deltas: &Tensor, index: usize) -> [f64; 4] {
        let (anchor, position) = (index % self.cell.len(), index / self.cell.len());
        let area = deltas.dims()[1] * deltas.dims()[2];
        [0, 1, 2, 3].map(|d| f64::from(deltas.data()[(anchor * 4 + d) * area + position]))
    }
}

/// Boxes of the anchors `indices` moved by their deltas and clipped to `extent`; an index past the
/// end names the last anchor.
pub fn decode_proposals(
    deltas: &Tensor,
    indices: &[u32],
    grid: AnchorGrid<'_>,
    extent: [f32; 2],
) -> Vec<[f32; 4]> {
    let last = deltas.data().len() / 4 - 1;
    indices
        .iter()
        .map(|index| {
            let index = last.min(*index as usize);
            decode_box(grid.anchor(index).0, grid.deltas(deltas, index), extent)
        })
        .collect()
}
