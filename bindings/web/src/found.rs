//! What a detector finds, with the names of `smr-gpu detect --json`.

use serde::Serialize;
use smr_gpu::internals::engine::graph::StageTime;
use smr_gpu::{Detection, Detections, Error, GpuDetector, Precision, Rect, Result, Scale};

#[derive(Serialize)]
struct Found<'a> {
    width: u32,
    height: u32,
    gel: Rect,
    gel_assumed: bool,
    #[serde(flatten)]
    scale: Scale,
    /// What was assumed of scale and gel, in a line.
    assumption: Option<String>,
    detections: &'a [Detection],
    contact: Option<bool>,
    regions: Option<&'a [Rect]>,
    left_out: Vec<String>,
    timings_ms: Timings<'a>,
    precision: Precision,
    kernels: String,
}

#[derive(Serialize)]
struct Timings<'a> {
    stages: &'a [StageTime],
    total: f64,
}

/// What was found, as JSON.
///
/// # Errors
/// [`Error::Tensor`] for what JSON cannot say.
pub fn json(found: &Detections, detector: &GpuDetector) -> Result<String> {
    let all = Found {
        width: found.width,
        height: found.height,
        gel: found.gel,
        gel_assumed: found.gel_assumed,
        scale: found.scale,
        assumption: found.assumption(),
        detections: &found.detections,
        contact: found.contact,
        regions: found.regions.as_deref(),
        left_out: found.left_out(&detector.config().savings),
        timings_ms: Timings { stages: &found.stages, total: found.wall.as_secs_f64() * 1e3 },
        precision: found.precision,
        kernels: format!("{:016x}", detector.kernels().digest()),
    };
    serde_json::to_string(&all).map_err(|e| Error::tensor("detect", "result", "a value of JSON", e))
}
