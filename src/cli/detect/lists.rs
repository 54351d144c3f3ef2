//! Lists of all snaps of a run: CSV, and COCO results. `smr-gpu merge` makes one of several.

use std::path::Path;

use serde::Serialize;
use smr_gpu::Detections;
use smr_gpu::files::{Outputs, Unfinished};

use super::super::exit::{Exit, Failure};
use super::super::source::frame::FrameId;

/// What a list has before its first entry, between two, and behind the last.
pub(in super::super) type Frame = [&'static str; 3];

/// Of a table; a row ends with its line.
pub(in super::super) const CSV: Frame =
    ["frame,index,time_s,class,score,x1,y1,x2,y2,x_mm,y_mm,yaw_deg,whole\n", "", ""];
/// Of COCO results; each begins a line.
pub(in super::super) const COCO: Frame = ["[", ",", "\n]\n"];

/// A row for each snap.
pub(super) struct Csv(Unfinished);

#[derive(Serialize)]
struct Row<'a> {
    frame: String,
    index: u64,
    time_s: Option<f64>,
    class: &'a str,
    score: f32,
    x1: f32,
    y1: f32,
    x2: f32,
    y2: f32,
    x_mm: f32,
    y_mm: f32,
    yaw_deg: Option<f32>,
    whole: Option<f32>,
}

impl Csv {
    pub fn create(outputs: &Outputs, path: &Path) -> Result<Self, Failure> {
        let mut file = outputs.create(path)?;
        file.write(CSV[0].as_bytes())?;
        Ok(Self(file))
    }

    pub fn add(&mut self, id: &FrameId, found: &Detections) -> Result<(), Failure> {
        let path = self.0.path();
        let failed = |e: &dyn std::fmt::Display| {
            Failure::new(Exit::Output, format!("{}: {e}", path.display()))
        };
        let mut rows = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
        for snap in found {
            let ([x1, y1, x2, y2], [x_mm, y_mm]) = (snap.bbox, snap.center_mm);
            let (score, yaw_deg, whole) = (snap.score, snap.yaw_deg, snap.whole);
            let (frame, index, time_s) = (id.to_string(), id.index, id.time_s);
            let class = snap.class.as_str();
            let row = Row {
                frame,
                index,
                time_s,
                class,
                score,
                x1,
                y1,
                x2,
                y2,
                x_mm,
                y_mm,
                yaw_deg,
                whole,
            };
            rows.serialize(row).map_err(|e| failed(&e))?;
        }
        let rows = rows.into_inner().map_err(|e| failed(&e))?;
        Ok(self.0.write(&rows)?)
    }

    pub fn finish(self, outputs: &mut Outputs) -> Result<(), Failure> {
        Ok(outputs.finish(self.0)?)
    }
}

/// An array of results.
pub(super) struct Coco {
    file: Unfinished,
    is_empty: bool,
}

#[derive(Serialize)]
struct CocoResult<'a> {
    image_id: u64,
    category_id: usize,
    /// Left, top, width, height in pixels.
    bbox: [f32; 4],
    score: f32,
    file_name: &'a str,
    index: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
}

impl Coco {
    pub fn create(outputs: &Outputs, path: &Path) -> Result<Self, Failure> {
        let mut file = outputs.create(path)?;
        file.write(COCO[0].as_bytes())?;
        Ok(Self { file, is_empty: true })
    }

    pub fn add(&mut self, id: &FrameId, found: &Detections) -> Result<(), Failure> {
        let file_name = &id.to_string();
        for snap in found {
            let ([x1, y1, ..], [width, height]) = (snap.bbox, snap.size());
            let result = CocoResult {
                image_id: id.number,
                // As `simulate` numbers them.
                category_id: snap.class_index + 1,
                bbox: [x1, y1, width, height],
                score: snap.score,
                file_name,
                index: id.index,
                time_s: id.time_s,
            };
            let text = serde_json::to_string(&result).map_err(|e| {
                Failure::new(Exit::Output, format!("{}: {e}", self.file.path().display()))
            })?;
            let between = if self.is_empty { "" } else { COCO[1] };
            self.is_empty = false;
            self.file.write(format!("{between}\n{text}").as_bytes())?;
        }
        Ok(())
    }

    pub fn finish(mut self, outputs: &mut Outputs) -> Result<(), Failure> {
        self.file.write(COCO[2].as_bytes())?;
        Ok(outputs.finish(self.file)?)
    }
}
