//! A frame's results as `--json` prints them.

use serde::Serialize;
use smr_gpu::engine::graph::StageTime;
use smr_gpu::{Detection, Detections, GpuDetector, Precision, Rect, Scale};

use super::super::source::frame::FrameId;

/// Version of docs/reference/detect.schema.json.
const VERSION: u32 = 1;

#[derive(Serialize)]
pub(super) struct Record<'a> {
    version: u32,
    file: String,
    /// Where the name is no Unicode, see [`super::super::source::Source::base64`].
    #[serde(skip_serializing_if = "Option::is_none")]
    file_base64: Option<String>,
    /// The file's name, or `source#index`.
    frame: String,
    index: u64,
    /// Null where the source has none.
    time_s: Option<f64>,
    width: u32,
    height: u32,
    /// The part that shows the gel, and whether that is assumed.
    gel: Rect,
    gel_assumed: bool,
    #[serde(flatten)]
    scale: Scale,
    detections: &'a [Detection],
    /// Whether something touches the gel; null where nobody looked.
    contact: Option<bool>,
    /// The parts of the picture that the network looked at, if any; null for all of it.
    regions: Option<&'a [Rect]>,
    /// What was left out, and why.
    left_out: Vec<String>,
    timings_ms: Timings<'a>,
    adapter: String,
    precision: Precision,
    /// The choice of kernels: where it is equal, so are the bits.
    kernels: String,
}

#[derive(Serialize)]
struct Timings<'a> {
    stages: &'a [StageTime],
    total: f64,
}

impl<'a> Record<'a> {
    pub fn new(id: &FrameId, found: &'a Detections, detector: &GpuDetector) -> Self {
        Self {
            version: VERSION,
            file: id.source.to_string(),
            file_base64: id.source.base64(),
            frame: id.to_string(),
            index: id.index,
            time_s: id.time_s,
            width: found.width,
            height: found.height,
            gel: found.gel,
            gel_assumed: found.gel_assumed,
            scale: found.scale,
            detections: &found.detections,
            contact: found.contact,
            regions: found.regions.as_deref(),
            left_out: found.left_out(&detector.config().savings),
            timings_ms: Timings { stages: &found.stages, total: found.wall.as_secs_f64() * 1e3 },
            adapter: detector.adapter(),
            precision: found.precision,
            kernels: format!("{:016x}", detector.kernels().digest()),
        }
    }
}
