//! Heights between cells and beside the part: no wall is steeper than a moulded part's.

use super::super::outline::WALL_SLOPE;

/// How far walls go down beside the part, in millimetres: further below the gel nothing presses.
const DEEP_MM: f64 = 3.0;

/// The least heights over a part's that fall nowhere faster than [`WALL_SLOPE`]; also around it.
#[derive(Clone, PartialEq)]
pub struct Walls {
    pub cells: [usize; 2],
    pub spacing_mm: f64,
    pub heights: Vec<f32>,
}

impl Walls {
    /// Takes a grid's heights, −∞ where the part is not.
    pub fn new([width, height]: [usize; 2], spacing_mm: f64, inner: &[f32]) -> Self {
        let margin = (DEEP_MM / WALL_SLOPE / spacing_mm).ceil() as usize + 1;
        let cells = [width, height].map(|n| n + 2 * margin);
        let [columns, rows] = cells;
        let mut part = vec![f32::NEG_INFINITY; columns * rows];
        for (row, heights) in inner.chunks_exact(width).enumerate() {
            let at = (row + margin) * columns + margin;
            part[at..at + width].copy_from_slice(heights);
        }
        let mut field = Field {
            columns,
            fall: WALL_SLOPE * spacing_mm,
            from: (0..part.len() as u32).collect(),
            heights: part.clone(),
            part,
        };
        // Each cell learns from its neighbours which cell's wall it stands on: there and back over all rows, in
        // each of them there and back (Danielsson 1980).
        for row in 0..rows {
            field.row(row, row.checked_sub(1));
        }
        for row in (0..rows).rev() {
            field.row(row, Some(row + 1).filter(|&next| next < rows));
        }
        Self { cells, spacing_mm, heights: field.heights }
    }

    /// Position of the cell's centre.
    pub fn position(&self, at: usize) -> [f64; 2] {
        let [columns, rows] = self.cells;
        let place = |at: usize, n: usize| (at as f64 + 0.5 - n as f64 / 2.0) * self.spacing_mm;
        [place(at % columns, columns), place(at / columns, rows)]
    }

    /// Height at a place, between cells by those around it.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let [columns, rows] = self.cells;
        let place = |v: f64, n: usize| {
            let at = v / self.spacing_mm + n as f64 / 2.0 - 0.5;
            let inside = at.clamp(0.0, n as f64 - 1.0);
            let cell = (inside as usize).min(n - 2);
            (cell, inside - cell as f64, at - inside)
        };
        let ((column, u, off_x), (row, v, off_y)) = (place(x, columns), place(y, rows));
        let cell = |column: usize, row: usize| f64::from(self.heights[row * columns + column]);
        let line = |row| cell(column, row) * (1.0 - u) + cell(column + 1, row) * u;
        let beside = off_x.hypot(off_y) * self.spacing_mm;
        line(row) * (1.0 - v) + line(row + 1) * v - WALL_SLOPE * beside
    }
}

/// Walls that are being built.
struct Field {
    columns: usize,
    /// A wall's fall from a cell to the next.
    fall: f64,
    /// Of each cell the one whose wall it stands on.
    from: Vec<u32>,
    heights: Vec<f32>,
    part: Vec<f32>,
}

impl Field {
    /// A row, once its neighbour is known.
    fn row(&mut self, row: usize, neighbour: Option<usize>) {
        let columns = self.columns;
        let start = row * columns;
        if let Some(neighbour) = neighbour {
            for column in 0..columns {
                for beside in column.saturating_sub(1)..(column + 2).min(columns) {
                    self.stand(start + column, neighbour * columns + beside);
                }
            }
        }
        for at in start + 1..start + columns {
            self.stand(at, at - 1);
        }
        for at in (start..start + columns - 1).rev() {
            self.stand(at, at + 1);
        }
    }

    fn stand(&mut self, at: usize, neighbour: usize) {
        let from = self.from[neighbour] as usize;
        let [down, right] = [from / self.columns, from % self.columns];
        let dx = right.abs_diff(at % self.columns) as f64;
        let dy = down.abs_diff(at / self.columns) as f64;
        let height = (f64::from(self.part[from]) - self.fall * (dx * dx + dy * dy).sqrt()) as f32;
        if height > self.heights[at] {
            self.heights[at] = height;
            self.from[at] = from as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beside and between the cells of a part: over each the highest of all cells' cones.
    #[test]
    fn walls_fall_by_their_slope() {
        let none = f32::NEG_INFINITY;
        let (width, height, spacing) = (9, 7, 0.05);
        let mut part = vec![none; 63];
        for (at, h) in [(0, 0.0), (1, -0.01), (31, -0.4), (32, -0.4), (40, -2.0), (62, -1.1)] {
            part[at] = h;
        }
        let walls = Walls::new([9, 7], spacing, &part);
        for at in 0..walls.heights.len() {
            let [x, y] = walls.position(at);
            let cones = part.iter().enumerate().map(|(cell, &h)| {
                let [u, v] = [(cell % 9, width), (cell / 9, height)]
                    .map(|(i, n)| (i as f64 + 0.5 - f64::from(n) / 2.0) * spacing);
                f64::from(h) - WALL_SLOPE * (x - u).hypot(y - v)
            });
            let expected = cones.fold(f64::NEG_INFINITY, f64::max);
            let got = f64::from(walls.heights[at]);
            // A cell may learn of a cone that is not quite the highest.
            assert!((got - expected).abs() < 0.02 * WALL_SLOPE * spacing, "{got} {expected}");
            assert!((walls.height(x, y) - got).abs() < 1e-9);
        }
        let [x, y] = walls.position(0);
        let corner = walls.height(x, y);
        assert!(corner < -DEEP_MM);
        assert!((walls.height(x - 3.0, y - 4.0) - (corner - 5.0 * WALL_SLOPE)).abs() < 1e-9);
    }
}
