//! The table for people.

use smr_gpu::{Detections, Origin, Scale};

use super::super::exit::Failure;
use super::super::output::line;
use super::super::printable::printable;
use super::super::source::frame::FrameId;
use super::super::source::{Source, column_width};

/// Heading of the classes' column.
const CLASS: &str = "class";

/// The table for people: a line a snap, or one for a picture without, below a head with their scale.
pub(super) struct Table {
    file_width: usize,
    class_width: usize,
    /// That of the last head.
    scale: Option<Scale>,
}

impl Table {
    pub fn new(sources: &[Source], classes: &[String]) -> Self {
        let names = classes.iter().map(String::as_str).chain([CLASS]);
        let longest = names.map(|name| printable(name).chars().count()).max();
        let (file_width, class_width) = (column_width(sources), longest.unwrap_or(0));
        Self { file_width, class_width, scale: None }
    }

    /// The head, where the scale is another than that of the last.
    fn heading(&mut self, scale: Scale) -> Result<(), Failure> {
        if self.scale.replace(scale) == Some(scale) {
            return Ok(());
        }
        let [x1, y1, x2, y2] = ["x1", "y1", "x2", "y2"];
        let from = match scale.from {
            Origin::Stated => "stated",
            Origin::Sensor => "of the sensor",
            Origin::Label => "of the label",
            Origin::Assumed => "assumed",
        };
        line(format!(
            "{:w$}  {CLASS:c$}  score  {x1:>7} {y1:>7} {x2:>7} {y2:>7} px  {:>7} {:>7} mm  {:>6} °  at \
             {:.4} mm a pixel, {from}",
            "file",
            "x",
            "y",
            "yaw",
            scale.mm_per_pixel,
            w = self.file_width,
            c = self.class_width
        ))
    }

    pub fn frame(&mut self, id: &FrameId, found: &Detections) -> Result<(), Failure> {
        self.heading(found.scale)?;
        let file = printable(id);
        let Self { file_width: w, class_width: c, .. } = *self;
        if found.detections.is_empty() {
            return line(format!("{file:w$}  no snaps"));
        }
        for d in &found.detections {
            let [x1, y1, x2, y2] = d.bbox;
            let [x, y] = d.center_mm;
            line(format!(
                "{file:w$}  {:c$}  {:.3}  {x1:7.1} {y1:7.1} {x2:7.1} {y2:7.1}     {x:7.2} {y:7.2}     \
                 {:>6}{}",
                printable(&d.class),
                d.score,
                d.yaw_deg.map_or("-".into(), |yaw| format!("{yaw:.1}")),
                // Below an even chance.
                if d.whole.is_some_and(|whole| whole < 0.5) { "  cut by the edge" } else { "" }
            ))?;
        }
        Ok(())
    }
}
