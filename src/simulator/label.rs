//! Boxes round the imprints.

use super::camera::Camera;
use super::contact::Contact;
use super::gel::Grid;
use super::scene::{Body, Placed};
use super::snaps::Snap;

/// A box in pixels: `x0, y0, x1, y1` as edges of pixels, so the whole picture is 0 to its size.
pub type PixelBox = [f64; 4];

/// The imprint of one part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imprint {
    /// Tight box round the imprint, clipped to what the picture shows of the gel.
    pub pixel_box: PixelBox,
    /// Area of the gel that touches the part, within the picture, in square pixels.
    pub area_px: f64,
}

/// Finds the imprint of each of the first `parts` parts of a body: the cells of the gel that bear
/// on it, seen through the camera, as far as they lie in `window`.
///
/// A cell belongs to the part that reaches deepest there: a wall that a hook grows from is a part
/// of its own, and not in the hook's box.
///
/// `None` where a part does not touch the gel within the window.
pub fn imprints(
    body: &Body,
    contact: &Contact,
    grid: Grid,
    camera: &Camera,
    window: PixelBox,
    parts: usize,
) -> Vec<Option<Imprint>> {
    let n = grid.cells;
    let half = grid.spacing_mm / 2.0;
    let [left, top, right, bottom] = window;
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
        let cell = [x0.max(left), y0.max(top), x1.min(right), y1.min(bottom)];
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

/// Points along the longer side of a snap at which [`visible_share`] looks.
const LOOKS: usize = 64;

/// How much of what a snap presses below the undeformed gel lies in a window of the picture, 0 to 1.
pub fn visible_share(snap: &Placed<Snap>, camera: &Camera, window: PixelBox) -> f64 {
    let [a, b] = snap.part.half_size();
    let step = 2.0 * a.max(b) / LOOKS as f64;
    let pose = snap.pose();
    let [left, top, right, bottom] = window;
    let (mut inside, mut all) = (0u32, 0u32);
    let counts = [a, b].map(|half| (half / step).ceil() as i32);
    for j in -counts[1]..=counts[1] {
        for i in -counts[0]..=counts[0] {
            let [x, y] = pose.gel([f64::from(i) * step, f64::from(j) * step]).into();
            let depth = snap.penetration(x, y, Snap::height);
            if depth > 0.0 {
                all += 1;
                let [px, py] = camera.project(x, y, depth);
                let seen = (left..=right).contains(&px) && (top..=bottom).contains(&py);
                inside += u32::from(seen);
            }
        }
    }
    if all == 0 { 0.0 } else { f64::from(inside) / f64::from(all) }
}
