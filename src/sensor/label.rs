//! Boxes round the imprints.

use super::PICTURE_PX;
use super::camera::Camera;
use super::contact::Contact;
use super::gel::Grid;
use super::scene::Body;

/// A box in pixels: `x0, y0, x1, y1` as edges of pixels, so the whole picture is 0 to 1000.
pub type PixelBox = [f64; 4];

/// The imprint of one part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imprint {
    /// Tight box round the imprint, clipped to the picture.
    pub pixel_box: PixelBox,
    /// Area of the gel that touches the part, within the picture, in square pixels.
    pub area_px: f64,
}

/// Finds the imprint of each of the first `parts` parts of a body: the cells of the gel that bear
/// on it, seen through the camera.
///
/// `None` where a part does not touch the gel within the picture.
pub fn imprints(
    body: &Body,
    contact: &Contact,
    grid: Grid,
    camera: &Camera,
    parts: usize,
) -> Vec<Option<Imprint>> {
    let n = grid.cells;
    let half = grid.spacing_mm / 2.0;
    let side = PICTURE_PX as f64;
    let mut found: Vec<Option<Imprint>> = vec![None; parts];
    for (i, &pressure) in contact.pressure.iter().enumerate() {
        let owner = usize::from(body.owner[i]);
        if pressure <= 0.0 || owner >= parts {
            continue;
        }
        let (x, y) = (grid.position(i % n), grid.position(i / n));
        let depth = f64::from(contact.displacement[i]);
        let [x0, y0] = camera.project(x - half, y - half, depth);
        let [x1, y1] = camera.project(x + half, y + half, depth);
        let cell = [x0.max(0.0), y0.max(0.0), x1.min(side), y1.min(side)];
        if cell[0] >= cell[2] || cell[1] >= cell[3] {
            continue;
        }
        let area = (cell[2] - cell[0]) * (cell[3] - cell[1]);
        let imprint = found[owner].get_or_insert(Imprint { pixel_box: cell, area_px: 0.0 });
        let b = &mut imprint.pixel_box;
        *b = [b[0].min(cell[0]), b[1].min(cell[1]), b[2].max(cell[2]), b[3].max(cell[3])];
        imprint.area_px += area;
    }
    found
}
