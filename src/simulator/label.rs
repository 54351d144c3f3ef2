//! Labels: boxes round the imprints, and what else is known of each snap.

use serde::{Deserialize, Serialize};

use super::camera::Camera;
use super::contact::Contact;
use super::gel::Grid;
use super::raster::PixelBox;
use super::scene::{Body, Placed};
use super::snaps::Snap;

/// An imprint's longer side must be at least this, in millimetres, or the scene is drawn anew: no
/// snap is visible without a label.
pub const LEAST_IMPRINT_MM: f64 = 1.5;

/// A labelled snap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// Name of its kind.
    pub kind: String,
    /// Box round the imprint, `x0, y0, x1, y1` in pixels.
    pub pixel_box: PixelBox,
    /// Area in contact, in square pixels.
    pub area_px: f64,
    /// For A the direction from the root of the arm to its barbed tip, from x towards y, in degrees
    /// from −180 to below 180; also of a hook on its side. B has none. Of one's own part the turn of its x, if
    /// it looks the same after no other.
    pub yaw_deg: Option<f64>,
    /// Depth of the highest point below the undeformed surface if the snap were not tilted, in
    /// millimetres: tilt takes the deepest point some tenths of a millimetre further.
    pub depth_mm: f64,
    /// Middle of the box in millimetres from the middle of the gel that the sensor's frames show, x
    /// right, y down, on the gel: corrected for the lens.
    pub center_mm: [f64; 2],
    /// Whether the whole snap lies in the picture.
    pub whole: bool,
    /// Share of the snap below the undeformed surface that lies in the picture.
    pub visible: f64,
    /// Number of slots, of B.
    pub slots: Option<u32>,
    /// Narrowest diameter of the hole in millimetres, of B.
    pub hole_mm: Option<f64>,
    /// Whether the wall that A grows from presses too; it is not in the box.
    pub wall: bool,
    /// Whether A lies on its side.
    pub on_side: bool,
}

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

/// Labels of all snaps, or `None` if one is not to be seen.
pub(super) fn labels(
    snaps: &[Placed<Snap>],
    found: &[Option<Imprint>],
    camera: &Camera,
    window: PixelBox,
) -> Option<Vec<Label>> {
    snaps
        .iter()
        .zip(found)
        .map(|(snap, imprint)| label(snap, (*imprint)?, camera, window))
        .collect()
}

fn label(
    snap: &Placed<Snap>,
    imprint: Imprint,
    camera: &Camera,
    window: PixelBox,
) -> Option<Label> {
    let [x0, y0, x1, y1] = imprint.pixel_box;
    if (x1 - x0).max(y1 - y0) < LEAST_IMPRINT_MM / camera.frame.mm_per_pixel {
        return None;
    }
    let visible = visible_share(snap, camera, window);
    let (hook, stud) = match &snap.part {
        Snap::Hook(hook) => (Some(hook), None),
        Snap::Stud(stud) => (None, Some(stud)),
        Snap::Own(_) => (None, None),
    };
    Some(Label {
        kind: snap.part.kind().name().to_owned(),
        pixel_box: imprint.pixel_box,
        area_px: imprint.area_px,
        yaw_deg: snap.part.direction(snap.yaw.to_degrees()),
        depth_mm: snap.depth_mm,
        center_mm: camera.flat_place(0.5 * (x0 + x1), 0.5 * (y0 + y1)),
        whole: visible == 1.0,
        visible,
        slots: stud.map(|stud| stud.slots),
        hole_mm: stud.map(|stud| stud.hole_mm()),
        wall: hook.is_some_and(|hook| hook.wall),
        on_side: hook.is_some_and(|hook| hook.on_side.is_some()),
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::simulator::raster::Raster;
    use crate::simulator::scene::Scene;
    use crate::simulator::smooth;
    use crate::simulator::snaps::Kind;

    /// The label of a snap on a gel of 16 mm at the right of a frame of 32 mm, seen through a lens that
    /// bends its corners by a fifth; how deep the gel goes, and the middle of what goes deepest in pixels.
    fn pressed(kind: Kind, center_mm: [f64; 2], yaw: f64) -> (Label, f64, [f64; 2]) {
        let frame = Raster { width: 640, height: 480, mm_per_pixel: 0.05 };
        let mut camera = Camera { frame, distortion: 0.2, ..Camera::default() };
        let window = [320.0, 80.0, 640.0, 400.0];
        camera.origin_mm = camera.flat_place(480.0, 240.0);
        let part = Snap::sample(&mut Pcg64::seed_from_u64(1), &kind);
        let snap = Placed { part, center_mm, yaw, tilt: [0.0; 2], depth_mm: 1.1 };
        let scene = Scene { snaps: vec![snap], distractors: Vec::new() };
        let grid = Grid { cells: 512, spacing_mm: 0.06 };
        let body = scene.body(grid, [20.0; 2]);
        let contact = smooth::pressed(grid, &body.penetration, 0.4);
        let found = imprints(&body, &contact, grid, &camera, window, 1);
        let label = labels(&scene.snaps, &found, &camera, window).expect("it shows").remove(0);
        let deepest = contact.displacement.iter().fold(0.0f32, |a, &b| a.max(b));
        let cells = contact.displacement.iter().enumerate().filter(|(_, d)| **d > deepest - 0.1);
        let seen: Vec<_> = cells
            .map(|(i, &d)| {
                let (x, y) = (grid.position(i % grid.cells), grid.position(i / grid.cells));
                camera.project(x, y, d.into())
            })
            .collect();
        let mean = |axis: usize| seen.iter().map(|at| at[axis]).sum::<f64>() / seen.len() as f64;
        (label, deepest.into(), [mean(0), mean(1)])
    }

    #[test]
    fn a_label_says_where_a_snap_is_and_how_deep() {
        for center in [[0.0, 0.0], [4.0, -3.0], [-4.0, 2.0]] {
            let (label, deepest, _) = pressed(Kind::B, center, 0.4);
            // The lens bends the two sides of a box differently, by a tenth of a millimetre; without the
            // lens or the gel's place in the frame it is half a millimetre and more.
            let [x, y] = [0, 1].map(|axis| label.center_mm[axis] - center[axis]);
            assert!(x.hypot(y) < 0.2, "{:?}, expected {center:?}", label.center_mm);
            assert!((label.depth_mm - deepest).abs() < 0.01, "{} of {deepest}", label.depth_mm);
        }
    }

    #[test]
    fn a_hook_s_yaw_leads_from_its_box_to_its_barb() {
        for turn in 0..12 {
            let (label, _, barb) = pressed(Kind::A, [1.0, 0.5], f64::from(turn) * PI / 6.0 - PI);
            let [x0, y0, x1, y1] = label.pixel_box;
            let way = [barb[0] - (x0 + x1) / 2.0, barb[1] - (y0 + y1) / 2.0];
            let yaw = label.yaw_deg.expect("a hook has one");
            let off = f64::atan2(way[1], way[0]).to_degrees() - yaw;
            let off = (off + 540.0).rem_euclid(360.0) - 180.0;
            assert!(off.abs() < 10.0, "the barb lies {off} degrees beside {yaw}");
        }
    }
}
