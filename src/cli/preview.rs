//! One sheet of what the simulator makes of a user's parts, to look at before anything is learnt from them.

use std::path::Path;

use image::imageops::{FilterType, crop_imm, overlay, resize};
use image::{Rgb, RgbImage};
use plotters::style::Color;
use plotters::style::colors::colormaps::{ColorMap, ViridisRGB};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use smr_gpu::files::Outputs;
use smr_gpu::simulator::own_part::DEEPEST_MM;
use smr_gpu::simulator::render::{Rendered, Renderer};
use smr_gpu::simulator::scene::{Own, Placed, Scene, scene_seed};
use smr_gpu::simulator::snaps::{Kind, Snap};

use super::draw::{self, Artist, BLACK, COLOURS, arrow, fill};
use super::exit::Failure;
use super::parts::described;

/// Side of a picture on the sheet, of the line below it, of what is between them, and of a part's heading.
const SIDE: u32 = 320;
const CAPTION: u32 = 22;
const GAP: u32 = 10;
const HEADING: u32 = 30;
/// Width of the heights' scale, its numbers included.
const SCALE: u32 = 90;
/// Presses of a part: columns and rows.
const PRESSES: [u32; 2] = [3, 2];
/// Free space round a part, in millimetres.
const AROUND_MM: f64 = 1.0;
/// Poses drawn for one press at most.
const ATTEMPTS: u64 = 20;
const WHITE: Rgb<u8> = Rgb([255, 255, 255]);
/// What is not of a part, and what of it no press reaches.
const GROUND: Rgb<u8> = Rgb([240, 240, 240]);
const DEEPER: Rgb<u8> = Rgb([150, 150, 150]);

/// Writes the sheet of these parts.
///
/// # Errors
/// [`Exit::Output`](super::exit::Exit::Output).
pub(super) fn write(
    outputs: &mut Outputs,
    path: &Path,
    own: &Own,
    seed: u64,
) -> Result<(), Failure> {
    outputs.check(path)?;
    draw::write(outputs, path, &sheet(own, seed))
}

/// Below each other all classes: what is seen of a part from the gel, its heights, and six presses at poses that are
/// drawn from `seed`.
fn sheet(own: &Own, seed: u64) -> RgbImage {
    let [columns, rows] = PRESSES;
    let (wide, high) = (SIDE + GAP, SIDE + CAPTION + GAP);
    let row = HEADING + rows * high + GAP;
    let names: Vec<_> = own.classes.iter().map(|kind| kind.name().to_owned()).collect();
    let mut sheet = RgbImage::from_pixel(
        GAP + wide + SCALE + columns * wide,
        GAP + row * own.classes.len() as u32,
        WHITE,
    );
    let artist = Artist::new(&names);
    let mut renderer = Renderer::new();
    for (class, kind) in own.classes.iter().enumerate() {
        let top = GAP + row * class as u32;
        let colour = COLOURS[class % COLOURS.len()];
        let mut show = |[column, line]: [u32; 2], picture: &RgbImage, caption: &str| {
            let x = GAP + column * wide + if column > 0 { SCALE } else { 0 };
            let y = top + HEADING + line * high;
            overlay(&mut sheet, picture, x.into(), y.into());
            artist.caption(&mut sheet, [x, y + SIDE], CAPTION, caption);
        };
        let seed = scene_seed(seed, class as u64);
        let rng = &mut Pcg64::seed_from_u64(seed);
        let snap = Snap::sample(rng, kind);
        let view = View::of(&snap);
        let mut seen = view.seen(&artist);
        let mut said = "seen from the gel".to_owned();
        if snap.direction(0.0).is_some() {
            let side = SIDE as f32;
            let ahead = [0.3 * side, 0.3 * side, 0.7 * side, 0.7 * side];
            arrow(&mut seen, ahead, 0.0, 2, colour);
            said += "; the arrow is its 0°";
        }
        show([0, 0], &seen, &said);
        show([0, 1], &view.heights(&artist), "heights in mm; dark grey: below all presses");
        for press in 0..columns * rows {
            let drawn = (0..ATTEMPTS).find_map(|attempt| {
                let seed = scene_seed(seed, attempt * u64::from(columns * rows) + u64::from(press));
                let scene = Scene::alone(&mut Pcg64::seed_from_u64(seed), kind);
                let snap = scene.snaps.first()?.clone();
                Some((renderer.scene(&scene, seed)?, snap))
            });
            let place = [1 + press % columns, press / columns];
            match drawn {
                Some((rendered, snap)) => {
                    let (mut picture, mm_per_px) = pressed(&rendered, &snap, colour);
                    ruler(&mut picture, mm_per_px, &artist);
                    show(place, &picture, &pose(&snap));
                }
                None => show(place, &RgbImage::from_pixel(SIDE, SIDE, GROUND), "no press shows"),
            }
        }
        let heading = match kind {
            Kind::Own(part) => described(part),
            kind => format!("{}: built in, drawn anew for each press", kind.name()),
        };
        artist.caption(&mut sheet, [GAP, top], HEADING, &heading);
    }
    sheet
}

/// A part as one looks at it from the gel.
struct View<'a> {
    snap: &'a Snap,
    mm_per_px: f64,
}

impl<'a> View<'a> {
    fn of(snap: &'a Snap) -> Self {
        Self { snap, mm_per_px: 2.0 * (snap.reach() + AROUND_MM) / f64::from(SIDE) }
    }

    /// The place of a pixel's middle, and the part's height there; none where it is not.
    fn at(&self, column: u32, row: u32) -> ([f64; 2], Option<f64>) {
        let place =
            [column, row].map(|at| (f64::from(at) + 0.5 - f64::from(SIDE) / 2.0) * self.mm_per_px);
        let [x, y] = place;
        let height = match self.snap {
            Snap::Own(part) => {
                let (relief, half) = (&part.relief, part.relief.half_size());
                let cell =
                    [0, 1].map(|axis| ((place[axis] + half[axis]) / relief.spacing_mm()).floor());
                let is_inside = cell.iter().all(|at| *at >= 0.0);
                is_inside.then(|| relief.at(cell[0] as usize, cell[1] as usize)).flatten()
            }
            snap => Some(snap.height(x, y)).filter(|height| *height > -DEEPEST_MM),
        };
        (place, height)
    }

    /// Lit from the upper left.
    fn seen(&self, artist: &Artist) -> RgbImage {
        let mut picture = RgbImage::from_fn(SIDE, SIDE, |column, row| {
            let ([x, y], height) = self.at(column, row);
            if height.is_none() {
                return GROUND;
            }
            let step = self.mm_per_px / 2.0;
            let slope = |dx: f64, dy: f64| {
                let [ahead, behind] = [1.0, -1.0].map(|s| self.snap.height(x + s * dx, y + s * dy));
                (ahead - behind) / (2.0 * step)
            };
            let (right, down) = (slope(step, 0.0), slope(0.0, step));
            let light = (0.4 * right + 0.5 * down + 1.0) / right.hypot(down).hypot(1.0);
            Rgb([(30.0 + 160.0 * light.clamp(0.0, 1.2)) as u8; 3])
        });
        ruler(&mut picture, self.mm_per_px, artist);
        picture
    }

    /// Coloured by height, with the colours' scale beside it.
    fn heights(&self, artist: &Artist) -> RgbImage {
        let deepest = match self.snap {
            // A flat part has a scale too.
            Snap::Own(part) => part.relief.depth_mm(DEEPEST_MM).max(0.1),
            _ => DEEPEST_MM,
        };
        let colour = |height: f64| {
            let (r, g, b) = ViridisRGB.get_color(1.0 + height / deepest).rgb();
            Rgb([r, g, b])
        };
        let mut picture = RgbImage::from_pixel(SIDE + SCALE, SIDE, WHITE);
        for (column, row) in (0..SIDE).flat_map(|row| (0..SIDE).map(move |column| (column, row))) {
            let (_, height) = self.at(column, row);
            let height = height.map(|h| if h < -deepest - 1e-6 { DEEPER } else { colour(h) });
            picture.put_pixel(column, row, height.unwrap_or(GROUND));
        }
        ruler(&mut picture, self.mm_per_px, artist);
        let (left, top, long) = (SIDE + GAP, CAPTION, SIDE - 2 * CAPTION);
        for row in 0..long {
            let height = -deepest * f64::from(row) / f64::from(long - 1);
            fill(&mut picture, left as i32, (top + row) as i32, 16, 1, colour(height));
        }
        for quarter in 0..=4 {
            let y = top + quarter * (long - 1) / 4;
            fill(&mut picture, left as i32 + 16, y as i32, 5, 1, BLACK);
            let height = format!("{:.2}", deepest * f64::from(quarter) / -4.0 + 0.0);
            artist.caption(&mut picture, [left + 25, y - CAPTION / 3], CAPTION, &height);
        }
        picture
    }
}

/// What a picture shows of a snap, with its box and its direction; and the millimetres of a pixel.
fn pressed(rendered: &Rendered, snap: &Placed<Snap>, colour: Rgb<u8>) -> (RgbImage, f64) {
    let Rendered { picture, frame, labels, .. } = rendered;
    let field_px = 2.0 * (snap.part.reach() + AROUND_MM) / frame.mm_per_pixel;
    let size = <[u32; 2]>::from(picture.dimensions());
    let side = (field_px.round() as u32).min(size[0]).min(size[1]);
    let [x, y] = [0, 1].map(|axis| {
        let middle = snap.center_mm[axis] / frame.mm_per_pixel + f64::from(size[axis]) / 2.0;
        // Not beyond the picture's edge.
        ((middle - f64::from(side) / 2.0).max(0.0) as u32).min(size[axis] - side)
    });
    let scale = f64::from(SIDE) / f64::from(side);
    let part = crop_imm(picture, x, y, side, side).to_image();
    let mut part = resize(&part, SIDE, SIDE, FilterType::CatmullRom);
    for label in labels {
        let [x0, y0, x1, y1] = label.pixel_box;
        let from = [x, y].map(f64::from);
        let bbox = [x0 - from[0], y0 - from[1], x1 - from[0], y1 - from[1]];
        let bbox = bbox.map(|v| (v * scale) as f32);
        Artist::snap(&mut part, bbox, label.yaw_deg.map(|yaw| yaw as f32), 1, colour);
    }
    (part, frame.mm_per_pixel / scale)
}

/// A pose in words.
fn pose(snap: &Placed<Snap>) -> String {
    let turn = snap.yaw.to_degrees().round();
    let yaw = snap.part.direction(turn).map_or(String::new(), |yaw| format!("yaw {yaw}°, "));
    let [u, v] = snap.tilt;
    let tilt = u.hypot(v).atan().to_degrees();
    format!("{yaw}{:.2} mm deep, tilted by {tilt:.1}°", snap.depth_mm)
}

/// A line of some whole millimetres in the lower left corner, with its length.
fn ruler(picture: &mut RgbImage, mm_per_px: f64, artist: &Artist) {
    let fits = |mm: &u32| f64::from(*mm) / mm_per_px < f64::from(SIDE) / 3.0;
    let mm = [20, 10, 5, 2, 1].into_iter().find(fits).unwrap_or(1);
    let long = (f64::from(mm) / mm_per_px).round() as i32;
    let (left, top) = (GAP as i32, (SIDE - 2 * GAP - CAPTION) as i32);
    fill(picture, left - 5, top - 2, long.max(50) + 10, CAPTION as i32 + 12, GROUND);
    artist.caption(picture, [GAP, SIDE - 2 * GAP - CAPTION], CAPTION, &format!("{mm} mm"));
    fill(picture, left, top + CAPTION as i32, long, 4, BLACK);
}
