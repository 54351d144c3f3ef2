//! Pictures with boxes, names and scores drawn in.

use std::error::Error;
use std::io::Cursor;
use std::path::Path;

use ab_glyph::FontRef;
use glam::Vec2;
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use imageproc::drawing::{draw_filled_rect_mut, draw_polygon_mut, draw_text_mut, text_size};
use imageproc::point::Point;
use imageproc::rect::Rect;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::prelude::BitMapBackend;
use plotters::style::{FontStyle, RGBColor};
use smr_gpu::files::Outputs;
use smr_gpu::{Detection, Detections};

use super::exit::{Exit, Failure};

pub(super) const FONT: &[u8] = include_bytes!("../../assets/font/DejaVuSans-Bold.ttf");

/// The family that [`FONT`] goes by in charts.
pub(super) const FONT_FAMILY: &str = "sans-serif";
/// Colours of charts' lines: Okabe and Ito's palette, which colour-blind eyes tell apart.
pub(super) const CHART_COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// A colour a class, from Okabe and Ito's palette: they differ for colour-blind eyes too, and all
/// are light enough for black letters.
pub(super) const COLOURS: [Rgb<u8>; 5] = [
    Rgb([230, 159, 0]),
    Rgb([86, 180, 233]),
    Rgb([0, 158, 115]),
    Rgb([240, 228, 66]),
    Rgb([204, 121, 167]),
];
pub(super) const BLACK: Rgb<u8> = Rgb([0, 0, 0]);

/// Draws detections.
pub(super) struct Artist<'a> {
    font: FontRef<'static>,
    classes: &'a [String],
}

impl<'a> Artist<'a> {
    /// An artist that gives each of `classes` its colour.
    pub fn new(classes: &'a [String]) -> Self {
        let font = FontRef::try_from_slice(FONT).expect("the font in the program is whole");
        Self { font, classes }
    }

    /// The picture with what was found in it, dark where nobody looked.
    pub fn draw_found(&self, mut canvas: RgbImage, found: &Detections) -> RgbImage {
        darken(&mut canvas, found.regions.as_deref());
        self.mark(&mut canvas, &found.detections);
        canvas
    }

    /// The picture with the detections in it, the best on top.
    pub fn draw(&self, picture: &DynamicImage, detections: &[Detection]) -> RgbImage {
        let mut canvas = picture.to_rgb8();
        self.mark(&mut canvas, detections);
        canvas
    }

    fn mark(&self, canvas: &mut RgbImage, detections: &[Detection]) {
        let side = canvas.width().min(canvas.height());
        // 3 px lines and 24 px letters in the sensor's 1000 px.
        let line = (side / 330).max(1) as i32;
        let letters = (side as f32 / 42.0).max(9.0);
        for detection in detections.iter().rev() {
            let class = self.classes.iter().position(|c| *c == detection.class).unwrap_or(0);
            let colour = COLOURS[class % COLOURS.len()];
            let corners = detection.bbox.map(|v| v.round() as i32);
            Self::snap(canvas, detection.bbox, detection.yaw_deg, line, colour);
            self.label(canvas, detection, corners, letters, colour);
        }
    }

    /// Draws a snap's box and, if it has one, its direction, both by lines of this thickness.
    pub fn snap(
        canvas: &mut RgbImage,
        bbox: [f32; 4],
        yaw_deg: Option<f32>,
        line: i32,
        colour: Rgb<u8>,
    ) {
        let corners = bbox.map(|v| v.round() as i32);
        // A dark rim keeps the line apart from a bright ground.
        frame(canvas, corners, line + (line + 1) / 2, BLACK);
        frame(canvas, corners, line, colour);
        if let Some(yaw) = yaw_deg {
            arrow(canvas, bbox, yaw, line, colour);
        }
    }

    /// Draws a box's edge with a dark rim.
    pub fn outline(canvas: &mut RgbImage, bbox: [f32; 4], colour: Rgb<u8>) {
        let corners = bbox.map(|v| v.round() as i32);
        frame(canvas, corners, 3, BLACK);
        frame(canvas, corners, 1, colour);
    }

    /// Writes a line of text, `height` pixels high, to the right of and below a corner.
    pub fn caption(&self, canvas: &mut RgbImage, corner: [u32; 2], height: u32, text: &str) {
        let [x, y] = corner.map(|v| v as i32);
        draw_text_mut(canvas, BLACK, x, y, height as f32 * 0.7, &self.font, text);
    }

    /// Name and score on a filled ground: above the box, or wherever next to it lies in the picture.
    fn label(
        &self,
        canvas: &mut RgbImage,
        detection: &Detection,
        corners: [i32; 4],
        letters: f32,
        colour: Rgb<u8>,
    ) {
        let text = format!("{} {:.2}", detection.class, detection.score);
        let (width, height) = text_size(letters, &self.font, &text);
        let pad = (letters / 5.0).ceil() as i32;
        let size = [width as i32 + 2 * pad, height as i32 + 2 * pad];
        let picture = [canvas.width() as i32, canvas.height() as i32];
        let [x, y] = label_corner(corners, size, picture);
        fill(canvas, x, y, size[0], size[1], colour);
        draw_text_mut(canvas, BLACK, x + pad, y + pad, letters, &self.font, &text);
    }
}

/// Upper left corner of a box's label: above the box, else below it, else on it; always in the picture, as far
/// as that is large enough.
fn label_corner([x1, y1, _, y2]: [i32; 4], size: [i32; 2], picture: [i32; 2]) -> [i32; 2] {
    let [most_x, most_y] = [0, 1].map(|axis| picture[axis] - size[axis]);
    let above = y1 - size[1];
    let y = if above >= 0 {
        above
    } else if y2 <= most_y {
        y2
    } else {
        y1
    };
    [x1.min(most_x).max(0), y.min(most_y).max(0)]
}

/// Halves the levels of what the network did not look at.
fn darken(canvas: &mut RgbImage, regions: Option<&[smr_gpu::Rect]>) {
    let Some(regions) = regions else { return };
    for (x, y, pixel) in canvas.enumerate_pixels_mut() {
        let seen = regions
            .iter()
            .any(|r| (r.x..r.x + r.width).contains(&x) && (r.y..r.y + r.height).contains(&y));
        if !seen {
            pixel.0 = pixel.0.map(|level| level / 2);
        }
    }
}

/// Draws the border of a box, `thick` pixels inwards and outwards together, centred on its edge.
fn frame(canvas: &mut RgbImage, [x1, y1, x2, y2]: [i32; 4], thick: i32, colour: Rgb<u8>) {
    let (out, wide, high) = (thick / 2, x2 - x1 + thick, y2 - y1 + thick);
    fill(canvas, x1 - out, y1 - out, wide, thick, colour);
    fill(canvas, x1 - out, y2 - out, wide, thick, colour);
    fill(canvas, x1 - out, y1 - out, thick, high, colour);
    fill(canvas, x2 - out, y1 - out, thick, high, colour);
}

/// Draws an arrow through the middle of a box, in the direction in which the barb points.
pub(super) fn arrow(
    canvas: &mut RgbImage,
    bbox: [f32; 4],
    yaw_deg: f32,
    line: i32,
    colour: Rgb<u8>,
) {
    let [x1, y1, x2, y2] = bbox;
    let (middle, length) = (Vec2::new(x1 + x2, y1 + y2) / 2.0, (x2 - x1).hypot(y2 - y1) / 4.0);
    let barb = Vec2::from_angle(yaw_deg.to_radians());
    let at = |along: f32, aside: f32| (middle + barb * along + barb.perp() * aside).to_array();
    let (thick, head) = (line as f32, (length / 3.0).max(3.0 * line as f32));
    for (rim, ink) in [(thick / 2.0, BLACK), (0.0, colour)] {
        let half = thick / 2.0 + rim;
        let shaft = [
            at(-length, half),
            at(length - head, half),
            at(length - head, -half),
            at(-length, -half),
        ];
        let wide = head / 1.5 + 2.0 * rim;
        let tip = [
            at(length + 2.0 * rim, 0.0),
            at(length - head - rim, wide),
            at(length - head - rim, -wide),
        ];
        polygon(canvas, &shaft, ink);
        polygon(canvas, &tip, ink);
    }
}

/// Fills a polygon whose corners may coincide after rounding.
fn polygon(canvas: &mut RgbImage, corners: &[[f32; 2]], colour: Rgb<u8>) {
    let mut points: Vec<Point<i32>> =
        corners.iter().map(|[x, y]| Point::new(x.round() as i32, y.round() as i32)).collect();
    points.dedup();
    // The library wants an open outline.
    if points.len() > 1 && points.first() == points.last() {
        points.pop();
    }
    if points.len() > 2 {
        draw_polygon_mut(canvas, &points, colour);
    }
}

/// Fills a rectangle, as far as it lies in the picture.
pub(super) fn fill(
    canvas: &mut RgbImage,
    x: i32,
    y: i32,
    width: i32,
    height: i32,
    colour: Rgb<u8>,
) {
    if width > 0 && height > 0 {
        let rect = Rect::at(x, y).of_size(width as u32, height as u32);
        draw_filled_rect_mut(canvas, rect, colour);
    }
}

/// A chart as PNG, in the program's own font: no system has to have one.
///
/// # Errors
/// What the plotting library returns.
pub(super) fn chart_png(
    (width, height): (u32, u32),
    chart: impl FnOnce(&Chart<BitMapBackend>) -> Result<(), Box<dyn Error>>,
) -> Result<Vec<u8>, Box<dyn Error>> {
    register_chart_font();
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    chart(&BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area())?;
    let picture = RgbImage::from_raw(width, height, pixels).ok_or("a buffer of another size")?;
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png)?;
    Ok(png.into_inner())
}

/// What a chart is drawn on.
pub(super) type Chart<DB> = DrawingArea<DB, Shift>;

/// Makes [`FONT`] the charts' family. A second time changes nothing.
pub(super) fn register_chart_font() {
    let _ = plotters::style::register_font(FONT_FAMILY, FontStyle::Normal, FONT);
}

/// Writes a picture as PNG.
///
/// # Errors
/// [`Exit::Output`].
pub(super) fn write(outputs: &mut Outputs, path: &Path, picture: &RgbImage) -> Result<(), Failure> {
    Ok(outputs.write(path, &png(path, picture)?)?)
}

/// The picture as PNG.
///
/// # Errors
/// [`Exit::Output`], with `path` as its name.
pub(super) fn png(path: &Path, picture: &RgbImage) -> Result<Vec<u8>, Failure> {
    let mut png = Cursor::new(Vec::new());
    picture
        .write_to(&mut png, ImageFormat::Png)
        .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", path.display())))?;
    Ok(png.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detection(bbox: [f32; 4]) -> Detection {
        Detection {
            class: "B".into(),
            class_index: 1,
            score: 0.987,
            bbox,
            center_mm: [0.0; 2],
            center_std_mm: None,
            yaw_deg: None,
            yaw_std_deg: None,
            whole: None,
        }
    }

    /// The coloured pixels' bounding box: columns and rows, ends included.
    fn extent(picture: &RgbImage, colour: Rgb<u8>) -> Option<[u32; 4]> {
        let mut found: Option<[u32; 4]> = None;
        for (x, y, pixel) in picture.enumerate_pixels() {
            if *pixel == colour {
                let f = found.get_or_insert([x, y, x, y]);
                *f = [f[0].min(x), f[1].min(y), f[2].max(x), f[3].max(y)];
            }
        }
        found
    }

    #[test]
    fn what_nobody_looked_at_is_dark() {
        let mut canvas = RgbImage::from_pixel(4, 2, Rgb([100, 51, 0]));
        darken(&mut canvas, None);
        assert!(canvas.pixels().all(|pixel| *pixel == Rgb([100, 51, 0])));
        let seen = [smr_gpu::Rect { x: 1, y: 0, width: 2, height: 1 }];
        darken(&mut canvas, Some(&seen));
        let dark = |x, y| *canvas.get_pixel(x, y) == Rgb([50, 25, 0]);
        assert_eq!([0, 1, 2, 3].map(|x| dark(x, 0)), [true, false, false, true]);
        assert!((0..4).all(|x| dark(x, 1)));
    }

    #[test]
    fn boxes_wear_their_class_colour_and_nothing_else_changes() {
        let classes = ["A".to_owned(), "B".to_owned()];
        let artist = Artist::new(&classes);
        let ground = DynamicImage::ImageRgb8(RgbImage::from_pixel(400, 400, Rgb([90, 91, 92])));
        assert_eq!(artist.draw(&ground, &[]), ground.to_rgb8());
        let drawn = artist.draw(&ground, &[detection([100.0, 120.0, 300.0, 320.0])]);
        // 400 / 330 rounds down to a line of one pixel on the edges; the label is above the box.
        let [x1, y1, x2, y2] = extent(&drawn, COLOURS[1]).expect("B's colour");
        assert_eq!([x1, x2, y2], [100, 300, 320]);
        assert!(y1 < 120, "no label above the box");
        assert_eq!(*drawn.get_pixel(200, 320), COLOURS[1]);
        assert_eq!(*drawn.get_pixel(200, 220), Rgb([90, 91, 92]));
        assert_eq!(extent(&drawn, COLOURS[0]), None);
    }

    #[test]
    fn labels_stay_in_the_picture_at_every_edge() {
        let corner = |bbox| label_corner(bbox, [50, 12], [300, 300]);
        // Above the box where there is room, else below it, else on it, and never past the right edge.
        assert_eq!(corner([100, 100, 200, 200]), [100, 88]);
        assert_eq!(corner([100, 12, 200, 200]), [100, 0]);
        assert_eq!(corner([0, 11, 100, 100]), [0, 100]);
        assert_eq!(corner([200, 0, 300, 288]), [200, 288]);
        assert_eq!(corner([0, 0, 300, 300]), [0, 0]);
        assert_eq!(corner([280, 295, 300, 300]), [250, 283]);
        assert_eq!(corner([280, 5, 300, 300]), [250, 5]);
        assert_eq!(corner([-20, -30, 10, 300]), [0, 0]);
        // All of its ground is drawn there: as much as of one in the middle.
        let classes = ["A".to_owned(), "B".to_owned()];
        let artist = Artist::new(&classes);
        let grounds = [[100, 100, 200, 200], [280, 0, 300, 300]].map(|corners| {
            let mut canvas = RgbImage::from_pixel(300, 300, Rgb([90, 91, 92]));
            let bbox = corners.map(|v| v as f32);
            artist.label(&mut canvas, &detection(bbox), corners, 12.0, COLOURS[1]);
            canvas.pixels().filter(|p| **p != Rgb([90, 91, 92])).count()
        });
        assert!(grounds[0] > 0 && grounds[0] == grounds[1], "{grounds:?}");
        // Pictures smaller than any label do not stop it.
        for (w, h) in [(1, 1), (1, 200), (200, 1)] {
            let tiny = DynamicImage::ImageRgb8(RgbImage::new(w, h));
            let drawn = artist.draw(&tiny, &[detection([0.0, 0.0, w as f32, h as f32])]);
            assert_eq!(drawn.dimensions(), (w, h));
        }
    }
}
