//! Error against run time, drawn as PNG and as SVG.

use std::error::Error;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use smr_gpu::evaluation::tradeoff::{Measured, Table};

use super::super::draw::{
    CHART_COLOURS as COLOURS, FONT_FAMILY as FAMILY, chart_png, register_chart_font,
};
use super::super::output::count;

/// Width of the picture, and of its height what does not depend on the front's length.
const WIDTH: u32 = 1200;
const HEIGHT: u32 = 640;
/// Height of a line of the key.
const LINE: u32 = 26;
/// A shift below this is drawn as this: a thousandth of a micrometre.
const LEAST_MM: f64 = 1e-6;
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
    register_chart_font();
    let height = HEIGHT + LINE * (table.front().len() as u32 + 2);
    let mut svg = String::new();
    chart(&SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area(), table)?;
    let png = chart_png((WIDTH, height), |root| chart(root, table))?;
    Ok(Plots { png, svg: svg.into_bytes() })
}

/// Place of a row: time in ms, shift in mm; those that lose more than one box in twenty lie on the top
/// edge.
fn place(row: &Measured, top: f64) -> (f64, f64) {
    let shift = row.shift_mm();
    (row.wall_ms.median, if shift.is_finite() { shift.max(LEAST_MM) } else { top })
}

/// From below the least to above the greatest of `values`.
fn range(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
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
    let (y0, y1) = range(finite.map(|mm| mm.max(LEAST_MM)));
    let (x0, x1) = range(table.rows.iter().map(|row| row.wall_ms.median));
    // One more line for what has no finite shift.
    let top = y1 * 2.0;
    let title = format!("Error against run time, {}", count(table.pictures, "picture"));
    let mut chart = ChartBuilder::on(&upper)
        .caption(title, (FAMILY, 24))
        .margin(16)
        .margin_right(32)
        .x_label_area_size(56)
        .y_label_area_size(96)
        .build_cartesian_2d((x0..x1).log_scale(), (y0..top * 1.3).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("time from picture to detections, ms a picture (median)")
        .y_desc("shift of centres from the base in f64, mm (95th percentile)")
        .axis_desc_style((FAMILY, 17))
        .label_style((FAMILY, 14))
        .x_label_formatter(&tick)
        .y_label_formatter(&tick)
        .light_line_style(RGBColor(238, 238, 238))
        .bold_line_style(RGBColor(215, 215, 215))
        .draw()?;

    let front = table.front();
    let steps = front.iter().map(|row| place(row, top));
    chart.draw_series(LineSeries::new(steps, RGBColor(150, 150, 150).stroke_width(2)))?;
    let colours = Colours::of(table);
    for row in &table.rows {
        symbol(root, row, chart.backend_coord(&place(row, top)), colours.style(row))?;
    }
    // The front's numbers, where they meet nothing else: around the point, ever further off.
    let points: Vec<(i32, i32)> =
        table.rows.iter().map(|row| chart.backend_coord(&place(row, top))).collect();
    let mut taken: Vec<(i32, i32)> = points;
    for (number, row) in (1..).zip(&front) {
        let (x, y) = chart.backend_coord(&place(row, top));
        let around = [(1, -1), (-1, -1), (1, 1), (-1, 1), (0, -1), (0, 1), (1, 0), (-1, 0)];
        let rings = [15, 22, 30, 40];
        let mut near = rings.iter().flat_map(|r| around.map(|(dx, dy)| (r * dx, r * dy)));
        let free = |(dx, dy): &(i32, i32)| {
            let (x, y) = (x + dx, y + dy);
            taken.iter().all(|(u, v)| (x - u).abs() > 14 || (y - v).abs() > 14)
        };
        let (dx, dy) = near.find(free).unwrap_or((15, -15));
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
    write_key(&key, &front, &colours)
}

/// A number of an axis: 1, 2 and 5 times a power of ten, as others would stand on each other.
fn tick(value: &f64) -> String {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    let digit = (value / 10f64.powi(exponent)).round() as i32;
    match (digit, exponent) {
        (1 | 2 | 5, -3..=5) => {
            format!("{:.*}", (-exponent).max(0) as usize, f64::from(digit) * 10f64.powi(exponent))
        }
        (1 | 2 | 5, _) => format!("{digit}e{exponent}"),
        _ => String::new(),
    }
}

/// A circle for the CPU, a triangle for an adapter.
fn symbol<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    row: &Measured,
    at: (i32, i32),
    style: ShapeStyle,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    let corners = [(0, -8), (7, 5), (-7, 5), (0, -8)].map(|(dx, dy)| (at.0 + dx, at.1 + dy));
    match (row.setup.device.as_str(), style.filled) {
        ("cpu", _) => area.draw(&Circle::new(at, 6, style))?,
        (_, true) => area.draw(&Polygon::new(corners, style))?,
        (_, false) => area.draw(&PathElement::new(corners, style))?,
    }
    Ok(())
}

/// How a network's points look: what is computed shows in colour and filling, the device in the shape.
struct Colours {
    /// The networks, by their weights.
    networks: Vec<String>,
}

impl Colours {
    fn of(table: &Table) -> Self {
        let mut networks: Vec<String> = Vec::new();
        for row in &table.rows {
            if !networks.contains(&row.setup.weights) {
                networks.push(row.setup.weights.clone());
            }
        }
        Self { networks }
    }

    fn colour(&self, weights: &str) -> RGBColor {
        let at = self.networks.iter().position(|w| w == weights).unwrap_or(0);
        COLOURS[at % COLOURS.len()]
    }

    /// Filled at the scale that the weights know, hollow at another.
    fn style(&self, row: &Measured) -> ShapeStyle {
        let colour = self.colour(&row.setup.weights);
        if row.setup.size.is_none() { colour.filled() } else { colour.stroke_width(2) }
    }
}

/// What each point of the front is, and how symbols are read.
fn write_key<DB: DrawingBackend>(
    key: &DrawingArea<DB, Shift>,
    front: &[&Measured],
    colours: &Colours,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    let style = TextStyle::from((FAMILY, 16));
    let mut x = 24;
    for network in &colours.networks {
        let colour = colours.colour(network);
        key.draw(&Rectangle::new([(x, 5), (x + 12, 17)], colour.filled()))?;
        key.draw(&Text::new(network.clone(), (x + 20, 2), style.clone()))?;
        x += 60 + 9 * network.chars().count() as i32;
    }
    let text = "Circles: CPU; triangles: the adapter. Hollow: the network's input in another size than its own.";
    key.draw(&Text::new(text, (x, 2), style.clone()))?;
    let text = "On the line (the Pareto front) nothing else is both faster and nearer to the base:";
    key.draw(&Text::new(text, (24, 2 + LINE as i32), style.clone()))?;
    for (at, row) in (2..).zip(front) {
        let y = (at as u32 * LINE) as i32;
        let at = at - 1;
        symbol(key, row, (36, y + 9), colours.style(row))?;
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
    use smr_gpu::evaluation::tradeoff::{Setup, Shift as Moved, Spread};

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
    fn ticks_are_few_and_short() {
        let shown = [1e-6, 2e-5, 3e-5, 0.001, 0.05, 1.0, 700.0, 2000.0, 1e5].map(|v| tick(&v));
        assert_eq!(shown, ["1e-6", "2e-5", "", "0.001", "0.05", "1", "", "2000", "100000"]);
        assert_eq!(tick(&0.000_009_999_999_999_999), "1e-5");
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
        // A circle of radius 6 has about 113 pixels; it is in the plot and, on the front, in the key, where
        // its network's colour is a square of 13.
        let one = count(&table(vec![row("cpu", 10.0, 0.0)]), COLOURS[0]);
        assert!((320..460).contains(&one), "{one}");
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
