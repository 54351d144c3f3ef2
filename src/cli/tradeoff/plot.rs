//! Error against run time, drawn as PNG and as SVG.

use std::error::Error;
use std::io::Cursor;

use image::{ImageFormat, RgbImage};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::FontStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use smr_gpu::tradeoff::{Measured, Table};

use super::super::draw::FONT;

/// Width of the picture, and of its height what does not depend on the front's length.
const WIDTH: u32 = 1200;
const HEIGHT: u32 = 640;
/// Height of a line of the key.
const LINE: u32 = 26;
/// The family that the program's own font goes by.
const FAMILY: &str = "sans-serif";
/// A shift below this is drawn as this: a thousandth of a micrometre.
const LEAST_MM: f64 = 1e-6;
/// Okabe and Ito's palette, which colour-blind eyes tell apart.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// A plot in both formats.
pub(super) struct Plots {
    pub png: Vec<u8>,
    pub svg: Vec<u8>,
}

/// Draws a table.
///
/// # Errors
/// What the plotting library returns, in words.
pub(super) fn draw(table: &Table) -> Result<Plots, Box<dyn Error>> {
    // The program brings its font: no system has to have one. A second time changes nothing.
    let _ = plotters::style::register_font(FAMILY, FontStyle::Normal, FONT);
    let height = HEIGHT + LINE * (table.front().len() as u32 + 1);
    let mut svg = String::new();
    chart(&SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area(), table)?;
    let mut pixels = vec![0; (3 * WIDTH * height) as usize];
    chart(&BitMapBackend::with_buffer(&mut pixels, (WIDTH, height)).into_drawing_area(), table)?;
    let picture = RgbImage::from_raw(WIDTH, height, pixels).ok_or("a buffer of another size")?;
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png)?;
    Ok(Plots { png: png.into_inner(), svg: svg.into_bytes() })
}

/// Place of a row: time in ms, shift in mm; those that lose more than one box in twenty lie on the top
/// edge.
fn place(row: &Measured, top: f64) -> (f64, f64) {
    let shift = row.shift_mm();
    (row.wall_ms.median, if shift.is_finite() { shift.max(LEAST_MM) } else { top })
}

/// The decades that hold all of `values`, with some room.
fn decades(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    if low.is_finite() && high.is_finite() { (low / 1.5, high * 1.5) } else { (1.0, 10.0) }
}

fn chart<DB: DrawingBackend>(
    root: &DrawingArea<DB, Shift>,
    table: &Table,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    root.fill(&WHITE)?;
    let (upper, key) = root.split_vertically(HEIGHT);
    let finite = table.rows.iter().map(Measured::shift_mm).filter(|mm| mm.is_finite());
    let (y0, y1) = decades(finite.map(|mm| mm.max(LEAST_MM)));
    let (x0, x1) = decades(table.rows.iter().map(|row| row.wall_ms.median));
    // One more line for what has no finite shift.
    let top = y1 * 2.0;
    let title = format!("Error against run time, {} pictures", table.pictures);
    let mut chart = ChartBuilder::on(&upper)
        .caption(title, (FAMILY, 24))
        .margin(16)
        .x_label_area_size(56)
        .y_label_area_size(96)
        .right_y_label_area_size(8)
        .build_cartesian_2d((x0..x1).log_scale(), (y0..top * 1.3).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("time from picture to detections, ms a picture (median)")
        .y_desc("shift of centres from the base in f64, mm (95th percentile)")
        .axis_desc_style((FAMILY, 17))
        .label_style((FAMILY, 14))
        .x_label_formatter(&|v| format!("{v}"))
        .y_label_formatter(&|v| format!("{v}"))
        .light_line_style(RGBColor(238, 238, 238))
        .bold_line_style(RGBColor(215, 215, 215))
        .draw()?;

    let front = table.front();
    let steps = front.iter().map(|row| place(row, top));
    chart.draw_series(LineSeries::new(steps, RGBColor(150, 150, 150).stroke_width(2)))?;
    let mut whats: Vec<String> = Vec::new();
    for row in &table.rows {
        if !whats.contains(&row.setup.what()) {
            whats.push(row.setup.what());
        }
    }
    let colour = |what: &str| {
        let at = whats.iter().position(|w| w == what).unwrap_or(0);
        COLOURS[at % COLOURS.len()]
    };
    for row in &table.rows {
        let at = place(row, top);
        let style = colour(&row.setup.what()).filled();
        match row.setup.device.as_str() {
            "cpu" => chart.draw_series([Circle::new(at, 6, style)])?.label(""),
            _ => chart.draw_series([TriangleMarker::new(at, 8, style)])?.label(""),
        };
    }
    // The front's numbers, where they meet nothing else.
    let points: Vec<(i32, i32)> =
        table.rows.iter().map(|row| chart.backend_coord(&place(row, top))).collect();
    let mut taken: Vec<(i32, i32)> = points;
    for (number, row) in (1..).zip(&front) {
        let (x, y) = chart.backend_coord(&place(row, top));
        let near =
            [(16, -14), (-16, -14), (16, 14), (-16, 14), (0, -24), (0, 24), (28, 0), (-28, 0)];
        let free = |(dx, dy): &&(i32, i32)| {
            let (x, y) = (x + dx, y + dy);
            taken.iter().all(|(u, v)| (x - u).abs() > 13 || (y - v).abs() > 13)
        };
        let (dx, dy) = near.iter().find(free).unwrap_or(&near[0]);
        let at = (x + dx, y + dy);
        let style = TextStyle::from((FAMILY, 17)).pos(Pos::new(HPos::Center, VPos::Center));
        root.draw(&Text::new(number.to_string(), at, style))?;
        taken.push(at);
    }
    if table.rows.iter().any(|row| !row.shift_mm().is_finite()) {
        let at = chart.backend_coord(&(x0, top));
        let style = TextStyle::from((FAMILY, 13)).color(&RGBColor(90, 90, 90));
        root.draw(&Text::new("more than one box in twenty lost", (at.0 + 8, at.1 - 22), style))?;
    }
    write_key(&key, &front, colour)
}

/// What each point of the front is, and how symbols are read.
fn write_key<DB: DrawingBackend>(
    key: &DrawingArea<DB, Shift>,
    front: &[&Measured],
    colour: impl Fn(&str) -> RGBColor,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    let style = TextStyle::from((FAMILY, 16));
    let text = "Circles: CPU; triangles: the adapter. A colour is a network and its input. On the line, \
                nothing else is both faster and nearer:";
    key.draw(&Text::new(text, (24, 2), style.clone()))?;
    for (at, row) in (1..).zip(front) {
        let y = (at as u32 * LINE) as i32;
        let symbol = colour(&row.setup.what()).filled();
        match row.setup.device.as_str() {
            "cpu" => key.draw(&Circle::new((36, y + 9), 6, symbol))?,
            _ => key.draw(&TriangleMarker::new((36, y + 9), 8, symbol))?,
        }
        let lost = match row.shift.lost {
            0 => String::new(),
            lost => format!(", {lost} of {} boxes lost", row.shift.boxes),
        };
        let text = format!(
            "{at}   {}: {:.1} ms, {:.5} mm{lost}",
            row.setup.name(),
            row.wall_ms.median,
            row.shift_mm()
        );
        key.draw(&Text::new(text, (56, y), style.clone()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use smr_gpu::tradeoff::{Setup, Shift as Moved, Spread};

    use super::*;

    fn row(device: &str, ms: f64, mm: f64) -> Measured {
        let spread = |v| Spread { median: v, percentile_95: v, worst: v };
        let setup = Setup {
            weights: "large".into(),
            size: None,
            device: device.into(),
            kernels: vec![],
            batch: 1,
            precision: Default::default(),
        };
        Measured {
            setup,
            wall_ms: spread(ms),
            device_ms: None,
            peak_bytes: None,
            stages: vec![],
            shift: Moved { mm: Some(spread(mm)), ..Moved::default() },
            quality: None,
        }
    }

    /// Pixels of a colour in the drawn PNG.
    fn count(table: &Table, wanted: RGBColor) -> usize {
        let png = draw(table).expect("a plot").png;
        let picture = image::load_from_memory(&png).expect("a PNG").to_rgb8();
        picture.pixels().filter(|p| p.0 == [wanted.0, wanted.1, wanted.2]).count()
    }

    #[test]
    fn every_point_is_drawn_whatever_its_shift() {
        let base = row("cpu", 1.0, 0.0).setup;
        let table = |rows| Table {
            place: None,
            weights: vec![],
            pictures: 3,
            stopped: false,
            base: base.clone(),
            rows,
        };
        // A circle of radius 6 has about 113 pixels; it is in the plot and, on the front, in the key.
        let one = count(&table(vec![row("cpu", 10.0, 0.0)]), COLOURS[0]);
        assert!((150..300).contains(&one), "{one}");
        let rows =
            vec![row("cpu", 10.0, 0.01), row("gpu", 200.0, 1e-5), row("cpu", 3.0, f64::INFINITY)];
        let three = count(&table(rows), COLOURS[0]);
        assert!(three > one + 250, "{three}");
        assert_eq!(count(&table(vec![]), COLOURS[0]), 0);
        let svg = draw(&table(vec![row("gpu", 5.0, 0.5)])).expect("a plot").svg;
        let svg = String::from_utf8(svg).expect("text");
        assert!(
            svg.contains("<polygon") && svg.contains("large, gpu: 5.0 ms, 0.50000 mm"),
            "{svg}"
        );
    }
}
