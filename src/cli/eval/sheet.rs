//! The worst pictures of a set, drawn into one.

use image::imageops::{FilterType, overlay};
use image::{Rgb, RgbImage};
use smr_gpu::Detection;
use smr_gpu::evaluation::Seen;

use super::super::draw::Artist;
use super::Labelled;

/// Pictures on a sheet, and of these in a row.
const PICTURES: usize = 10;
const COLUMNS: usize = 5;
/// Longer side of a picture on the sheet, height of the line below it, and what is between them.
const SIDE: u32 = 400;
const CAPTION: u32 = 24;
const GAP: u32 = 8;
const WHITE: Rgb<u8> = Rgb([255, 255, 255]);

/// The worst pictures, the very worst first: snaps in white, boxes above `conf` in their classes'
/// colours. Each comes with its labels and what was seen. `None` if all are right to the pixel.
pub(in super::super) fn worst(
    pictures: &[(&Labelled, &Seen)],
    classes: &[String],
    conf: f32,
) -> Option<RgbImage> {
    let badness = |seen: &Seen| seen.badness(classes.len(), conf.into());
    let mut worst: Vec<Shown> =
        pictures.iter().map(|(labelled, seen)| (badness(seen), *labelled, *seen)).collect();
    worst.retain(|(badness, ..)| *badness > 0.0);
    worst.sort_by(|a, b| b.0.total_cmp(&a.0));
    draw(worst, classes, conf)
}

/// The best pictures that show a snap, the very best first, as [`worst`] draws them. `None` if none does.
pub(in super::super) fn best(
    pictures: &[(&Labelled, &Seen)],
    classes: &[String],
    conf: f32,
) -> Option<RgbImage> {
    let shown = pictures.iter().filter(|(_, seen)| !seen.snaps.is_empty());
    // Of one snap and of three alike.
    let lack = |seen: &Seen| seen.badness(classes.len(), conf.into()) / seen.snaps.len() as f64;
    let mut best: Vec<Shown> =
        shown.map(|(labelled, seen)| (lack(seen), *labelled, *seen)).collect();
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    draw(best, classes, conf)
}

/// How far off a picture is, its labels, and what was seen.
type Shown<'a> = (f64, &'a Labelled, &'a Seen);

/// The first pictures on one sheet.
fn draw(mut shown: Vec<Shown>, classes: &[String], conf: f32) -> Option<RgbImage> {
    shown.truncate(PICTURES);
    if shown.is_empty() {
        return None;
    }
    let (columns, rows) = (shown.len().min(COLUMNS), shown.len().div_ceil(COLUMNS));
    let (wide, high) = (SIDE + GAP, SIDE + CAPTION + GAP);
    let mut sheet =
        RgbImage::from_pixel(columns as u32 * wide + GAP, rows as u32 * high + GAP, WHITE);
    let artist = Artist::new(classes);
    for (number, (badness, labelled, seen)) in shown.into_iter().enumerate() {
        let (x, y) =
            ((number % COLUMNS) as u32 * wide + GAP, (number / COLUMNS) as u32 * high + GAP);
        // It was read a moment ago; if it is gone since, its place stays empty.
        if let Ok(picture) = labelled.source.picture() {
            let scale = f64::from(SIDE) / f64::from(picture.width().max(picture.height()));
            let small = picture.resize(SIDE, SIDE, FilterType::Triangle);
            let scaled = |bbox: [f64; 4]| bbox.map(|v| (v * scale) as f32);
            let found = seen.found.iter().filter(|f| f.scored.score > conf.into());
            let found: Vec<Detection> = found
                .map(|f| Detection {
                    class: classes[f.class].clone(),
                    class_index: f.class,
                    score: f.scored.score as f32,
                    bbox: scaled(f.scored.bbox),
                    center_mm: [0.0; 2],
                    center_std_mm: None,
                    yaw_deg: f.yaw_deg.map(|yaw| yaw as f32),
                    yaw_std_deg: None,
                    whole: None,
                })
                .collect();
            let mut small = small.to_rgb8();
            for snap in &seen.snaps {
                Artist::outline(&mut small, scaled(snap.truth.bbox), WHITE);
            }
            overlay(&mut sheet, &artist.draw(&small.into(), &found), x.into(), y.into());
        }
        let snaps: Vec<&str> = seen.snaps.iter().map(|s| classes[s.class].as_str()).collect();
        let snaps = if snaps.is_empty() { "nothing".to_owned() } else { snaps.join(" ") };
        let file = labelled.picture.file.display();
        let caption = format!("{file}: {snaps}; off by {badness:.2}");
        artist.caption(&mut sheet, [x, y + SIDE], CAPTION, &caption);
    }
    Some(sheet)
}
