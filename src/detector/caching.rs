//! Frames of one camera, in order: what did not change is not computed again.

use std::sync::Arc;

use crate::detector::contact_map;
use crate::detector::inference::Job;
use crate::detector::input::Input;
use crate::detector::session::Session;
use crate::detector::{Detections, GpuDetector};
use crate::engine::gpu::Deadline;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;
use crate::sensor::frame::Frame;
use crate::sensor::view::View;

/// How often in a row a frame's detections may be kept.
pub const MOST_REUSED: u32 = 20;
/// After so many kept frames their mean is compared too: a snap that comes too faintly for one frame shows
/// there, since noise is less by the root.
const MEAN: u32 = 4;

/// A detector for the frames of one camera in their order, that keeps the detections of the last computed frame
/// for those that equal it within a sensor's noise. What computes every frame is [`GpuDetector::detect_many`].
///
/// ```no_run
/// use std::sync::Arc;
/// use smr_gpu::{CachingDetector, Config, Frame, GpuDetector, PixelFormat};
///
/// # fn next_frame() -> Option<Vec<u8>> { None }
/// let detector = Arc::new(GpuDetector::new(Config::new("weights/smrnet-s.safetensors"))?);
/// let mut camera = CachingDetector::new(detector);
/// while let Some(bytes) = next_frame() {
///     let found = camera.detect(&Frame::new(bytes, 1920, 1200, PixelFormat::BayerRggb8))?;
///     println!("{} snaps, {}", found.len(), if found.reused { "as before" } else { "computed" });
/// }
/// # Ok::<(), smr_gpu::Error>(())
/// ```
#[derive(Debug)]
pub struct CachingDetector {
    detector: Arc<GpuDetector>,
    last: Option<Last>,
}

/// The last frame that was computed.
#[derive(Debug)]
struct Last {
    view: View,
    cells: Value,
    found: Detections,
    /// Frames since then.
    reused: u32,
    /// The sum of their cells since the last mean.
    sum: Vec<f32>,
}

impl Last {
    /// Counts one more frame that equals this one; whether the mean of the last [`MEAN`] does not.
    fn fades(&mut self, cells: Option<&Value>) -> bool {
        let (Value::F32(own), Some(Value::F32(cells))) = (&self.cells, cells) else { return false };
        self.sum.resize(cells.data().len(), 0.0);
        self.sum.iter_mut().zip(cells.data()).for_each(|(sum, cell)| *sum += cell / MEAN as f32);
        self.reused += 1;
        if !self.reused.is_multiple_of(MEAN) {
            return false;
        }
        let mean = Tensor::new(cells.shape().clone(), std::mem::take(&mut self.sum));
        mean.is_ok_and(|mean| contact_map::has_changed(&mean, own, MEAN))
    }
}

impl CachingDetector {
    /// For a camera's frames, by a detector that others may use beside it.
    pub fn new(detector: Arc<GpuDetector>) -> Self {
        Self { detector, last: None }
    }

    /// The detector itself.
    pub fn detector(&self) -> &Arc<GpuDetector> {
        &self.detector
    }

    /// Finds the snaps in the next frame. If it equals the last one that was computed, within a sensor's
    /// noise, it has that one's detections and is [`Detections::reused`]; never more than [`MOST_REUSED`]
    /// times in a row, and not where four frames in a row differ together by half as much.
    ///
    /// # Errors
    /// As [`GpuDetector::detect`].
    pub fn detect<'f>(&mut self, frame: impl Into<Frame<'f>>) -> Result<Detections> {
        pollster::block_on(self.detect_async(frame))
    }

    /// [`CachingDetector::detect`] for callers with an executor of their own; it waits as
    /// [`GpuDetector::detect_async`] does.
    ///
    /// # Errors
    /// As [`GpuDetector::detect`].
    pub async fn detect_async<'f>(&mut self, frame: impl Into<Frame<'f>>) -> Result<Detections> {
        let (detector, frame) = (self.detector.clone(), frame.into());
        let deadline = Deadline::after(detector.config.timeout);
        let input = detector.input(&frame)?;
        let session = detector.session();
        match self.detect_with(&session, &input, deadline).await {
            Err(e) => {
                let session = detector.recover(&session, e).await?;
                self.detect_with(&session, &input, deadline).await
            }
            found => found,
        }
    }

    async fn detect_with(
        &mut self,
        session: &Session,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<Detections> {
        let last = self.last.take().filter(|last| last.view == input.view);
        let before = last.as_ref().map(|last| &last.cells);
        let contact = self.detector.contact(session, input, before, true, deadline).await?;
        let same = |last: &mut Last| {
            !contact.changed && last.reused < MOST_REUSED && !last.fades(contact.cells.as_ref())
        };
        if let Some(last) = last.and_then(|mut last| same(&mut last).then_some(last)) {
            let found = &last.found;
            let kept = Detections {
                contact: found.contact,
                regions: found.regions.clone(),
                without_deepest: found.without_deepest,
                looked_again: found.looked_again,
                proposals: found.proposals,
                precision: found.precision,
                reused: true,
                stages: [input.taken()].into_iter().chain(contact.stages).collect(),
                ..input.report(found.detections.clone())
            };
            self.last = Some(last);
            return Ok(kept);
        }
        let cells = contact.cells.clone();
        let job = Job::new(input, Some(contact), &self.detector.config.savings);
        let found = self.detector.run_job(session, job, deadline).await?;
        let view = input.view;
        let last = |cells| Last { view, cells, found: found.clone(), reused: 0, sum: Vec::new() };
        self.last = cells.map(last);
        Ok(found)
    }
}
