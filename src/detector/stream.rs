//! Frames of one camera, in order: what did not change is not looked at again.

use crate::detector::engines::Engines;
use crate::detector::input::Input;
use crate::detector::look::Sight;
use crate::detector::view::View;
use crate::detector::{Detections, GpuDetector};
use crate::error::Result;
use crate::frame::Frame;
use crate::gpu::Deadline;
use crate::tensor::Value;

/// How often in a row a frame's detections may be kept.
pub const MOST_REUSED: u32 = 20;

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
}

impl<'a> Stream<'a> {
    pub(super) fn new(detector: &'a GpuDetector) -> Self {
        Self { detector, last: None }
    }

    /// Finds the snaps in the next frame. If it equals the last one that was computed, within a sensor's
    /// noise, it has that one's detections and is [`Detections::reused`]; never more than [`MOST_REUSED`]
    /// times in a row.
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
        let same = |last: &Last| !look.changed && last.reused < MOST_REUSED;
        if let Some(mut last) = last.filter(same) {
            last.reused += 1;
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
        let last = |cells| Last { view, cells, found: found.clone(), reused: 0 };
        self.last = cells.map(last);
        Ok(found)
    }
}
