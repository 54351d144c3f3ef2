//! What a detector finds, as the arguments of `smr_gpu.Detections`.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use smr_gpu::{Detections, GpuDetector, Origin, Rect};

/// A dictionary with a value for each of the fields.
///
/// # Errors
/// Python's.
pub fn fields<'py>(
    py: Python<'py>,
    found: &Detections,
    detector: &GpuDetector,
) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    let snaps = &found.detections;
    macro_rules! each {
        ($name:literal, $value:expr) => {
            fields.set_item($name, snaps.iter().map($value).collect::<Vec<_>>())?
        };
    }
    each!("boxes", |snap| snap.bbox);
    each!("scores", |snap| snap.score);
    each!("labels", |snap| snap.class_index);
    each!("center_mm", |snap| snap.center_mm);
    each!("center_std_mm", |snap| snap.center_std_mm.unwrap_or([f32::NAN; 2]));
    each!("yaw_deg", |snap| snap.yaw_deg.unwrap_or(f32::NAN));
    each!("yaw_std_deg", |snap| snap.yaw_std_deg.unwrap_or(f32::NAN));
    each!("whole", |snap| snap.whole.unwrap_or(f32::NAN));
    fields.set_item("classes", &detector.model().classes)?;
    fields.set_item("width", found.width)?;
    fields.set_item("height", found.height)?;
    fields.set_item("gel", sides(&found.gel))?;
    fields.set_item("gel_assumed", found.gel_assumed)?;
    fields.set_item("part", sides(&found.part))?;
    fields.set_item("mm_per_pixel", found.scale.mm_per_pixel)?;
    let from = match found.scale.from {
        Origin::Stated => "stated",
        Origin::Sensor => "sensor",
        Origin::Label => "label",
        Origin::Assumed => "assumed",
    };
    fields.set_item("scale_from", from)?;
    fields.set_item("assumption", found.assumption())?;
    fields.set_item("contact", found.contact)?;
    let regions = found.regions.as_ref();
    fields.set_item("regions", regions.map(|all| all.iter().map(sides).collect::<Vec<_>>()))?;
    fields.set_item("left_out", found.left_out(&detector.config().savings))?;
    fields.set_item("looked_again", found.looked_again)?;
    fields.set_item("reused", found.reused)?;
    fields.set_item("precision", found.precision.to_string())?;
    let stages = PyDict::new(py);
    for stage in &found.stages {
        stages.set_item(&stage.stage, stage.time.as_secs_f64() * 1e3)?;
    }
    fields.set_item("stages_ms", stages)?;
    fields.set_item("total_ms", found.wall.as_secs_f64() * 1e3)?;
    Ok(fields)
}

fn sides(part: &Rect) -> [u32; 4] {
    [part.x, part.y, part.width, part.height]
}
