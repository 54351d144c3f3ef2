//! Line charts of the report.

use std::error::Error;
use std::ops::Range;

use plotters::prelude::*;

use super::super::draw::{self, CHART_COLOURS, FONT_FAMILY, chart_png};

const SIZE: (u32, u32) = (720, 480);
/// Points are marked on lines of at most so many.
const MARKED: usize = 20;

/// A chart of lines, each with its name and its points.
pub(super) struct Chart<'a> {
    pub title: &'a str,
    pub x: (&'a str, Range<f64>),
    pub y: (&'a str, Range<f64>),
    pub lines: &'a [(String, Vec<(f64, f64)>)],
    /// Where the names go: into the corner that the lines leave free.
    pub names: SeriesLabelPosition,
}

/// Draws it as PNG.
///
/// # Errors
/// What the plotting library returns.
pub(super) fn png(chart: &Chart) -> Result<Vec<u8>, Box<dyn Error>> {
    chart_png(SIZE, |root| draw(root, chart))
}

fn draw(root: &draw::Chart<BitMapBackend>, chart: &Chart) -> Result<(), Box<dyn Error>> {
    root.fill(&WHITE)?;
    let mut axes = ChartBuilder::on(root)
        .caption(chart.title, (FONT_FAMILY, 20))
        .margin(12)
        .margin_right(24)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d(chart.x.1.clone(), chart.y.1.clone())?;
    axes.configure_mesh()
        .x_desc(chart.x.0)
        .y_desc(chart.y.0)
        .axis_desc_style((FONT_FAMILY, 15))
        .label_style((FONT_FAMILY, 13))
        .max_light_lines(0)
        .bold_line_style(RGBColor(220, 220, 220))
        .draw()?;
    for (at, (name, points)) in chart.lines.iter().enumerate() {
        let colour = CHART_COLOURS[at % CHART_COLOURS.len()];
        axes.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(3)));
        if points.len() <= MARKED {
            axes.draw_series(points.iter().map(|at| Circle::new(*at, 4, colour.filled())))?;
        }
    }
    axes.configure_series_labels()
        .position(chart.names.clone())
        .label_font((FONT_FAMILY, 14))
        .background_style(WHITE.mix(0.8))
        .border_style(RGBColor(200, 200, 200))
        .draw()?;
    Ok(root.present()?)
}
