//! The gel's surface between the cells of the contact's grid.

use super::camera::Camera;
use super::gel::Grid;

/// The deformed surface of the gel.
pub struct Surface {
    grid: Grid,
    /// Depth and gradient of each cell.
    cells: Vec<[f32; 3]>,
}

/// The surface at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Displacement into the gel in millimetres.
    pub depth: f32,
    /// Its derivatives along x and y.
    pub gradient: [f32; 2],
}

impl Surface {
    /// Takes displacements in millimetres, `[cells][cells]`, and finds gradients by central
    /// differences.
    ///
    /// # Panics
    /// If `displacement` is not as long as the grid.
    pub fn new(grid: Grid, displacement: Vec<f32>) -> Self {
        let n = grid.cells;
        assert_eq!(displacement.len(), n * n);
        let scale = (0.5 / grid.spacing_mm) as f32;
        let mut cells = Vec::with_capacity(n * n);
        for y in 0..n {
            let above = &displacement[y.saturating_sub(1) * n..][..n];
            let row = &displacement[y * n..][..n];
            let below = &displacement[(y + 1).min(n - 1) * n..][..n];
            for x in 0..n {
                cells.push([
                    row[x],
                    scale * (row[(x + 1).min(n - 1)] - row[x.saturating_sub(1)]),
                    scale * (below[x] - above[x]),
                ]);
            }
        }
        Self { grid, cells }
    }

    /// The surface at a point in millimetres from the centre, between cells by bilinear
    /// interpolation; the outermost cells go on for ever.
    pub fn at(&self, x_mm: f64, y_mm: f64) -> SurfacePoint {
        let last = (self.grid.cells - 1) as f32;
        let x = (self.grid.index(x_mm) as f32).clamp(0.0, last - 0.001);
        let y = (self.grid.index(y_mm) as f32).clamp(0.0, last - 0.001);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let i = row * self.grid.cells + column;
        let [a, b] = [self.cells[i], self.cells[i + 1]];
        let [c, d] = [self.cells[i + self.grid.cells], self.cells[i + self.grid.cells + 1]];
        let mix = |k: usize| {
            let top = a[k] + fx * (b[k] - a[k]);
            let bottom = c[k] + fx * (d[k] - c[k]);
            top + fy * (bottom - top)
        };
        SurfacePoint { depth: mix(0), gradient: [mix(1), mix(2)] }
    }
}

impl Surface {
    /// The point of the surface that the camera sees where a flat gel would show the point
    /// `x_mm`, `y_mm`.
    ///
    /// It solves `x = x_mm (1 − depth(x) / distance)` about the middle of the picture,
    /// [`Camera::project`] backwards, in two steps from the flat gel. A step shrinks the error by the
    /// slope times `x_mm / distance`, which is 0.16 for a slope of 1 at the gel's edge.
    pub fn seen(&self, camera: &Camera, x_mm: f64, y_mm: f64) -> SurfacePoint {
        self.seen_from(camera, x_mm, y_mm, 2).1
    }

    /// As [`seen`](Self::seen), in this many steps, with the point's place in millimetres: a camera
    /// that is nearer than twice the field needs more.
    pub fn seen_from(
        &self,
        camera: &Camera,
        x_mm: f64,
        y_mm: f64,
        steps: u32,
    ) -> ([f64; 2], SurfacePoint) {
        let [left, top] = camera.origin_mm;
        let mut place = [x_mm, y_mm];
        let mut point = self.at(x_mm, y_mm);
        for _ in 0..steps {
            if point.depth.abs() < 1e-3 {
                break;
            }
            let shrink = 1.0 - f64::from(point.depth) / camera.distance_mm;
            place = [(x_mm + left) * shrink - left, (y_mm + top) * shrink - top];
            point = self.at(place[0], place[1]);
        }
        (place, point)
    }

    /// The grid.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Displacement of each cell, `[cells][cells]`.
    pub fn depths(&self) -> Vec<f32> {
        self.cells.iter().map(|cell| cell[0]).collect()
    }
}
