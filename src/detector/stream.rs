//! Frames of one camera, in order: what did not change is not looked at again.

use crate::detector::contact;
use crate::detector::engines::Engines;
use crate::detector::input::Input;
use crate::detector::look::Sight;
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

/// Looks at frames in their order: see [`GpuDetector::stream`].
#[derive(Debug)]
pub struct Stream<'a> {
    detector: &'a GpuDetector,
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
        mean.is_ok_and(|mean| contact::has_changed(&mean, own, MEAN))
    }
}

impl<'a> Stream<'a> {
    pub(super) fn new(detector: &'a GpuDetector) -> Self {
        Self { detector, last: None }
    }

    /// Finds the snaps in the next frame. If it equals the last one that was computed, within a sensor's
    /// noise, it has that one's detections and is [`Detections::reused`]; never more than [`MOST_REUSED`]
    /// times in a row, and not where four frames in a row differ together by half as much.
    ///
    /// # Errors
    /// As [`GpuDetector::detect_frame`].
    pub fn detect(&mut self, frame: &Frame) -> Result<Detections> {
        let deadline = Deadline::after(self.detector.config.timeout);
        let input = self.detector.input(frame)?;
        let engines = self.detector.engines();
        match self.detect_with(&engines, &input, deadline) {
            Err(e) => {
                let engines = self.detector.recover(&engines, e)?;
                self.detect_with(&engines, &input, deadline)
            }
            found => found,
        }
    }

    fn detect_with(
        &mut self,
        engines: &Engines,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<Detections> {
        let last = self.last.take().filter(|last| last.view == input.view);
        let before = last.as_ref().map(|last| &last.cells);
        let look = self.detector.touched(engines, input, before, true, deadline);
        let look = pollster::block_on(look)?;
        let same = |last: &mut Last| {
            !look.changed && last.reused < MOST_REUSED && !last.fades(look.cells.as_ref())
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
                stages: [input.taken()].into_iter().chain(look.stages).collect(),
                ..input.report(found.detections.clone())
            };
            self.last = Some(last);
            return Ok(kept);
        }
        let cells = look.cells.clone();
        let sight = Sight::new(input, Some(look), &self.detector.config.scene);
        let found = pollster::block_on(self.detector.look_at(engines, sight, deadline))?;
        let view = input.view;
        let last = |cells| Last { view, cells, found: found.clone(), reused: 0, sum: Vec::new() };
        self.last = cells.map(last);
        Ok(found)
    }
}
