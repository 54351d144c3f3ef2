//! Labelled pictures, and how far what is found on them is from their labels.

use std::error::Error;
use std::path::Path;

use smr_gpu::evaluation::coco::{self, Dataset, Label, Picture};
use smr_gpu::evaluation::metrics::{box_iou, center};
use smr_gpu::{Detections, Frame, PixelFormat, picture};

/// Scores above this count.
pub const SCORE: f32 = 0.5;
/// A box with this overlap finds its snap.
const RIGHT: f64 = 0.5;

/// What was found of a snap.
#[derive(Clone, Copy)]
pub struct Best {
    /// Overlap of the box of its class that overlaps it most.
    pub iou: f64,
    /// That box's centre in millimetres.
    pub center: [f64; 2],
}

impl Best {
    /// Whether the box finds its snap.
    pub fn is_right(&self) -> bool {
        self.iou >= RIGHT
    }
}

/// The annotations of a folder.
///
/// # Errors
/// What reading and parsing return.
pub fn open(folder: &Path) -> Result<Dataset, Box<dyn Error>> {
    Ok(coco::parse(&std::fs::read(folder.join("annotations.json"))?)?)
}

/// A picture of a folder as a frame with the scale and the gel that its label states.
///
/// # Errors
/// What reading returns.
pub fn frame(folder: &Path, labelled: &Picture) -> Result<Frame<'static>, Box<dyn Error>> {
    let file = match folder.join(&labelled.file) {
        file if file.exists() => file,
        _ => folder.join("images").join(&labelled.file),
    };
    let decoded = picture::read(&file)?.into_rgb8();
    let (width, height) = decoded.dimensions();
    Ok(labelled.state(Frame::new(decoded.into_raw(), width, height, PixelFormat::Rgb8)))
}

/// The snaps of a picture.
pub fn snaps(labelled: &Picture) -> impl Iterator<Item = &Label> {
    labelled.labels.iter().filter(|label| !label.truth.crowd)
}

/// A snap's centre in millimetres.
pub fn center_mm(label: &Label, found: &Detections) -> [f64; 2] {
    center(label.truth.bbox).map(|x| x * f64::from(found.scale.mm_per_pixel))
}

/// The box of a snap's class that overlaps it most.
pub fn best(found: &Detections, class: &str, label: &Label) -> Option<Best> {
    let mm = f64::from(found.scale.mm_per_pixel);
    let of_class = found.detections.iter().filter(|d| d.class.eq_ignore_ascii_case(class));
    let boxes = of_class.map(|d| d.bbox.map(f64::from));
    let judged = boxes.map(|bbox| Best {
        iou: box_iou(label.truth.bbox, bbox),
        center: center(bbox).map(|x| x * mm),
    });
    judged.filter(|best| best.iou > 0.0).max_by(|a, b| a.iou.total_cmp(&b.iou))
}

/// From one place to another.
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
