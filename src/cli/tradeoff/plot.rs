//! Error against run time, drawn as PNG and as SVG.
//!
//! What is computed (networks, sizes, what is left out) moves boxes against the truth; how it is computed
//! (kernels, devices, precision) only rounds. So there are two panels for the first, by what is lost of the
//! overlap with the labels and by the distance of centres, and one for the second.

use std::error::Error;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use smr_gpu::Saving;
use smr_gpu::evaluation::tradeoff::{Measured, Quality, Table, front};

use super::super::draw::{
    CHART_COLOURS as COLOURS, FONT_FAMILY as FAMILY, chart_png, register_chart_font,
};
use super::super::output::count;

const WIDTH: u32 = 1200;
/// Height of a panel, and of the key.
const PANEL: u32 = 440;
const KEY: u32 = 64;
/// Below this an error is drawn as this: what no f32 tells from nothing.
const LEAST: f64 = 1e-9;
/// Height of a name beside its point, and the width of a letter, in pixels.
const NAME: (i32, i32) = (17, 8);
const GREY: RGBColor = RGBColor(120, 120, 120);

/// A plot in both formats.
pub(super) struct Plots {
    pub png: Vec<u8>,
    pub svg: Vec<u8>,
}

/// What a panel shows.
struct Panel<'a> {
    title: String,
    /// What its error is, with its unit.
    axis: &'a str,
    points: Vec<Point<'a>>,
    /// Whether those that nothing beats are on a line, and they alone are named.
    has_front: bool,
}

/// A setup in a panel.
struct Point<'a> {
    row: &'a Measured,
    error: f64,
    /// Where 95 % of the errors of resampled pictures lie.
    between: Option<[f64; 2]>,
    name: String,
}

/// Draws a table.
///
/// # Errors
/// What the plotting library returns, in words.
pub(super) fn draw(table: &Table) -> Result<Plots, Box<dyn Error>> {
    register_chart_font();
    let panels = panels(table);
    let size = (WIDTH, PANEL * panels.len() as u32 + KEY);
    let mut svg = String::new();
    chart(&SVGBackend::with_string(&mut svg, size).into_drawing_area(), table, &panels)?;
    let png = chart_png(size, |root| chart(root, table, &panels))?;
    Ok(Plots { png, svg: svg.into_bytes() })
}

/// Those of a table that have a point.
fn panels(table: &Table) -> Vec<Panel<'_>> {
    let timed = |row: &&Measured| {
        [row.wall_ms.median, row.wall_ms.percentile_95].iter().all(|ms| ms.is_finite() && *ms > 0.0)
    };
    // How it runs is the last panel's: of what is computed, the fastest way of each device.
    let is_fastest = |row: &&Measured| {
        let same = |other: &&Measured| {
            let [one, other] = [&row.setup, &other.setup];
            other.batch == 1 && other.what() == one.what() && other.device == one.device
        };
        let times = table.rows.iter().filter(same).map(|other| other.wall_ms.median);
        row.setup.batch == 1 && row.wall_ms.median <= times.fold(f64::INFINITY, f64::min)
    };
    let judged = |error: fn(&Quality) -> f64, between: fn(&Quality) -> Option<[f64; 2]>| {
        let rows = table.rows.iter().filter(timed).filter(is_fastest);
        let points = rows.filter_map(|row| {
            let quality = row.quality.as_ref()?;
            let name = match row.setup.device.as_str() {
                "cpu" => short(row),
                _ => format!("{}, {}", short(row), row.setup.how()),
            };
            Some(Point { row, error: error(quality), between: between(quality), name })
        });
        points.filter(|point| point.error.is_finite()).collect()
    };
    let rounded = table.rows.iter().filter(timed);
    let rounded = rounded.filter(|row| row.setup.what() == table.base.what());
    let rounded = rounded.filter_map(|row| {
        Some(Point { row, error: row.rounding()?, between: None, name: row.setup.how() })
    });
    let pictures = count(table.pictures, "picture");
    let panels = [
        Panel {
            title: format!("What is computed: overlap with the labels, {pictures}"),
            axis: "1 − mean IoU, %",
            points: judged(
                |q| 100.0 * (1.0 - q.iou),
                |q| q.iou_95.map(|[low, high]| [high, low].map(|iou| 100.0 * (1.0 - iou))),
            ),
            has_front: true,
        },
        Panel {
            title: "What is computed: centres against the labels".to_owned(),
            axis: "centre error, median, mm",
            points: judged(|q| q.center_error_mm, |q| q.center_error_95_mm),
            has_front: true,
        },
        Panel {
            title: format!("How it is computed: rounding of {} against f64", table.base.what()),
            axis: "largest relative error of a stage",
            points: rounded.filter(|point| point.error.is_finite()).collect(),
            has_front: false,
        },
    ];
    panels.into_iter().filter(|panel| !panel.points.is_empty()).collect()
}

fn chart<DB: DrawingBackend>(
    root: &DrawingArea<DB, Shift>,
    table: &Table,
    panels: &[Panel],
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    root.fill(&WHITE)?;
    let colours = Colours::of(table);
    let (upper, key) = root.split_vertically(PANEL * panels.len() as u32);
    for (area, panel) in upper.split_evenly((panels.len().max(1), 1)).iter().zip(panels) {
        draw_panel(area, panel, &colours)?;
    }
    write_key(&key, &colours)
}

/// What a setup computes, in a few words.
fn short(row: &Measured) -> String {
    let what = row.setup.what();
    match (what.split_once(", leaving out"), row.setup.leave_out.len() == Saving::ALL.len()) {
        (Some((whole, _)), true) => format!("{whole}, leaving out all"),
        _ => what,
    }
}

/// From below the least to above the greatest of `values`.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), value| {
        (low.min(value), high.max(value))
    });
    (low / margin, high * margin)
}

fn draw_panel<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    panel: &Panel,
    colours: &Colours,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    let shown = |error: f64| error.max(LEAST);
    let points = &panel.points;
    let times = points.iter().flat_map(|p| [p.row.wall_ms.median, p.row.wall_ms.percentile_95]);
    let (x0, x1) = range(times, 1.25);
    let errors = points.iter().flat_map(|p| p.between.unwrap_or([p.error; 2])).map(shown);
    let (y0, y1) = range(errors, 1.25);
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, (FAMILY, 20))
        .margin(12)
        .margin_right(32)
        .x_label_area_size(48)
        .y_label_area_size(92)
        .build_cartesian_2d((x0..x1).log_scale(), (y0..y1).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("time from picture to detections, ms a picture (median to 95th percentile)")
        .y_desc(panel.axis)
        .axis_desc_style((FAMILY, 15))
        .label_style((FAMILY, 14))
        .x_label_formatter(&|value| tick(value, x1 / x0))
        .y_label_formatter(&|value| tick(value, y1 / y0))
        .light_line_style(RGBColor(240, 240, 240))
        .bold_line_style(RGBColor(220, 220, 220))
        .draw()?;

    let rows = points.iter().map(|point| point.row);
    let error_of = |row: &Measured| {
        points.iter().find(|p| p.row.setup == row.setup).map_or(f64::INFINITY, |p| p.error)
    };
    let best = if panel.has_front { front(rows, error_of) } else { rows.collect() };
    if panel.has_front {
        let steps = best.iter().map(|row| (row.wall_ms.median, shown(error_of(row))));
        chart.draw_series(LineSeries::new(steps, RGBColor(170, 170, 170).stroke_width(2)))?;
    }
    // The chart's places are those of the whole picture.
    let screen = area.use_screen_coord();
    let mut taken = Vec::new();
    for point in points {
        let (time, late) = (point.row.wall_ms.median, point.row.wall_ms.percentile_95);
        let at = chart.backend_coord(&(time, shown(point.error)));
        let colour = colours.colour(&point.row.setup.weights);
        let [low, high] = point.between.unwrap_or([point.error; 2]).map(shown);
        for ends in
            [[(time, shown(point.error)), (late, shown(point.error))], [(time, low), (time, high)]]
        {
            let ends = ends.map(|end| chart.backend_coord(&end));
            screen.draw(&PathElement::new(ends, colour.mix(0.45).stroke_width(1)))?;
        }
        symbol(&screen, point.row, at, colours.style(point.row))?;
        taken.push((at.0 - 8, at.1 - 8, at.0 + 8, at.1 + 8));
    }
    // Names beside their points, where they cover nothing, within the panel.
    let (across, down) = area.get_pixel_range();
    for point in points.iter().filter(|point| best.iter().any(|row| row.setup == point.row.setup)) {
        let (x, y) = chart.backend_coord(&(point.row.wall_ms.median, shown(point.error)));
        let long = NAME.1 * point.name.chars().count() as i32;
        let places = [0, -20, 20, -40, 40, -60, 60, -80, 80].into_iter().flat_map(|down| {
            [(x + 12, y + down - NAME.0 / 2), (x - 12 - long, y + down - NAME.0 / 2)]
        });
        let box_at = |(left, top): (i32, i32)| (left, top, left + long, top + NAME.0);
        let is_free = |place: &(i32, i32)| {
            let (left, top, right, bottom) = box_at(*place);
            let inside = left > across.start + 100
                && right < across.end
                && top > down.start + 36
                && bottom < down.end - 52;
            inside
                && taken
                    .iter()
                    .all(|(l, t, r, b)| right < *l || left > *r || bottom < *t || top > *b)
        };
        let beside = ((x + 12).min(across.end - long), y - NAME.0 / 2);
        let place = places.clone().find(is_free).unwrap_or(beside);
        let style = TextStyle::from((FAMILY, 14)).pos(Pos::new(HPos::Left, VPos::Top));
        screen.draw(&Text::new(point.name.clone(), place, style))?;
        if (place.1 + NAME.0 / 2 - y).abs() > 12 {
            let near = if place.0 > x { place.0 - 2 } else { place.0 + long + 2 };
            let line = [(x, y), (near, place.1 + NAME.0 / 2)];
            screen.draw(&PathElement::new(line, GREY.mix(0.5).stroke_width(1)))?;
        }
        taken.push(box_at(place));
    }
    Ok(())
}

/// A number of an axis whose end is so many times its beginning: 1, 2 and 5 times a power of ten, as others
/// would stand on each other; on a short one all digits.
fn tick(value: &f64, span: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    let digit = (value / 10f64.powi(exponent)).round() as i32;
    match (if span < 10.0 { 1 } else { digit }, exponent) {
        (1 | 2 | 5, -3..=5) => {
            format!("{:.*}", (-exponent).max(0) as usize, f64::from(digit) * 10f64.powi(exponent))
        }
        (1 | 2 | 5, _) => format!("{digit}e{exponent}"),
        _ => String::new(),
    }
}

/// A circle for the CPU, a triangle for an adapter; with a ring round it where something is left out.
fn symbol<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    row: &Measured,
    at: (i32, i32),
    style: ShapeStyle,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    let corners = [(0, -7), (6, 4), (-6, 4), (0, -7)].map(|(dx, dy)| (at.0 + dx, at.1 + dy));
    match (row.setup.device.as_str(), style.filled) {
        ("cpu", _) => area.draw(&Circle::new(at, 5, style))?,
        (_, true) => area.draw(&Polygon::new(corners, style))?,
        (_, false) => area.draw(&PathElement::new(corners, style))?,
    }
    if !row.setup.leave_out.is_empty() {
        area.draw(&Circle::new(at, 9, style.color.stroke_width(1)))?;
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

/// How symbols are read.
fn write_key<DB: DrawingBackend>(
    key: &DrawingArea<DB, Shift>,
    colours: &Colours,
) -> Result<(), Box<dyn Error>>
where
    DB::ErrorType: 'static,
{
    let style = TextStyle::from((FAMILY, 15));
    let mut x = 24;
    for network in &colours.networks {
        let colour = colours.colour(network);
        key.draw(&Rectangle::new([(x, 8), (x + 12, 20)], colour.filled()))?;
        key.draw(&Text::new(network.clone(), (x + 20, 5), style.clone()))?;
        x += 60 + 9 * network.chars().count() as i32;
    }
    let text = "Circles: CPU; triangles: the adapter. Hollow: another input size. A ring: something is left out.";
    key.draw(&Text::new(text, (x, 5), style.clone()))?;
    let text = "On the line (the Pareto front) nothing else is both faster and better; vertical lines are 95 % intervals.";
    Ok(key.draw(&Text::new(text, (24, 32), style))?)
}

#[cfg(test)]
mod tests {
    use smr_gpu::evaluation::tradeoff::{Setup, Shift as Moved, Spread, StageError};

    use super::*;

    /// A setup that finds centres to `mm`, and loses as much of the overlap as half that.
    fn row(device: &str, ms: f64, mm: f64) -> Measured {
        let spread = |v| Spread { median: v, percentile_95: v, worst: v };
        let setup = Setup {
            weights: "large".into(),
            size: None,
            device: device.into(),
            kernels: vec![],
            batch: 1,
            precision: Default::default(),
            leave_out: vec![],
        };
        Measured {
            setup,
            wall_ms: spread(ms),
            device_ms: None,
            peak_bytes: None,
            stages: vec![],
            shift: Moved::default(),
            quality: Some(Quality {
                iou: 1.0 - (mm / 2.0).min(0.9),
                ap50: 0.9,
                center_error_mm: mm,
                iou_95: None,
                center_error_95_mm: Some([mm / 1.5, mm * 1.5]),
            }),
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
        let shown =
            [1e-6, 2e-5, 3e-5, 0.001, 0.05, 1.0, 700.0, 2000.0, 1e5].map(|v| tick(&v, 100.0));
        assert_eq!(shown, ["1e-6", "2e-5", "", "0.001", "0.05", "1", "", "2000", "100000"]);
        assert_eq!(tick(&0.000_009_999_999_999_999, 100.0), "1e-5");
        assert_eq!([3.0, 0.04].map(|v| tick(&v, 1.5)), ["3", "0.04"]);
    }

    fn table(rows: Vec<Measured>) -> Table {
        let base = row("cpu", 1.0, 0.0).setup;
        Table { place: None, weights: vec![], pictures: 3, stopped: false, base, rows }
    }

    #[test]
    fn every_point_is_drawn() {
        // A circle of radius 5 has about 79 pixels, the key's square 169; a point is in two panels.
        let one = count(&table(vec![row("cpu", 10.0, 0.1)]), COLOURS[0]);
        assert!((240..420).contains(&one), "{one}");
        let rows = vec![row("cpu", 10.0, 0.1), row("gpu", 200.0, 0.05), row("1", 3.0, 0.5)];
        let three = count(&table(rows), COLOURS[0]);
        assert!(three > one + 200, "{three}");
        assert_eq!(count(&table(vec![]), COLOURS[0]), 0);
    }

    /// Each is named beside its point on the front, and in how it rounds; what finds nothing has no centre.
    #[test]
    fn panels_show_what_there_is_to_say() {
        let mut rows = vec![row("cpu", 10.0, 0.1), row("gpu", 20.0, 0.2)];
        rows[1].stages =
            vec![StageError { stage: "conv1".into(), relative_l2: 2e-6, largest: 0.1 }];
        let mut lost = row("cpu", 1.0, f64::INFINITY);
        lost.setup.size = Some(32);
        rows.push(lost);
        let table = table(rows);
        let panels = panels(&table);
        let names =
            |at: usize| panels[at].points.iter().map(|p| p.name.as_str()).collect::<Vec<_>>();
        assert_eq!(panels.len(), 3);
        assert_eq!(names(0), ["large", "large, gpu", "large at 32 px"]);
        assert_eq!(names(1), ["large", "large, gpu"]);
        assert_eq!(names(2), ["gpu"]);
        let svg = String::from_utf8(draw(&table).expect("a plot").svg).expect("text");
        // The adapter is slower and worse.
        assert!(svg.contains("large at 32 px") && !svg.contains("large, gpu"), "{svg}");
        assert!(svg.contains("<polygon") && svg.contains("rounding of large against f64"), "{svg}");
        // Each panel's circles lie within its axes, and what is worse lies higher.
        let heights = |at: i32| -> Vec<i32> {
            let drawn = svg.split("<circle ").skip(1);
            let down = drawn.filter_map(|circle| circle.split('"').nth(3)?.parse::<i32>().ok());
            let panel = PANEL as i32;
            down.filter(|y| (at * panel + 40..(at + 1) * panel - 60).contains(y)).collect()
        };
        assert_eq!([0, 1, 2].map(|at| heights(at).len()), [2, 1, 0], "{svg}");
        assert!(heights(0)[1] < heights(0)[0], "{svg}");
    }
}
