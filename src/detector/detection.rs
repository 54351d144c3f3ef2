//! What a detector finds.

use std::time::Duration;

use crate::engine::graph::StageTime;
use crate::engine::precision::Precision;
use crate::sensor::rect::Rect;
use crate::sensor::scale::Scale;
use crate::sensor::view;
use crate::verify::comparison::{ChoiceComparison, Shift, StageComparison, larger};

#[cfg(doc)]
use crate::detector::{Config, Scene};
#[cfg(doc)]
use crate::smr::ModelConfig;

/// One snap in a picture.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Detection {
    /// Class name.
    pub class: String,
    /// The class's place in [`ModelConfig::classes`].
    pub class_index: usize,
    /// Confidence from 0 to 1.
    pub score: f32,
    /// Corners (x1, y1, x2, y2) in pixels of the picture; pixel i covers `[i, i + 1]`. Serialised as
    /// `box`.
    #[cfg_attr(feature = "serde", serde(rename = "box"))]
    pub bbox: [f32; 4],
    /// Centre of the box on the gel in millimetres, from the gel's middle: x right, y down.
    pub center_mm: [f32; 2],
    /// Standard deviation of that centre along x and y; `None` if the weights do not tell, or not for gel
    /// at this scale ([`Config::input_size`]).
    pub center_std_mm: Option<[f32; 2]>,
    /// Direction in which a hook's barb points, from its root to its tip: degrees in −180 to 180, 0 along
    /// x (right), 90 along y (down). `None` for a class without direction, or if the weights do not tell.
    pub yaw_deg: Option<f32>,
    /// Standard deviation of that direction; `None` as that of the centre.
    pub yaw_std_deg: Option<f32>,
    /// Probability that the picture's edge does not cut the snap; `None` if the weights do not tell.
    pub whole: Option<f32>,
}

/// What a picture holds, and what finding it took.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Detections {
    /// The snaps, best first.
    pub detections: Vec<Detection>,
    /// Width of the picture in pixels.
    pub width: u32,
    /// Height of the picture in pixels.
    pub height: u32,
    /// The part of the picture that shows the gel, from whose middle positions are.
    pub gel: Rect,
    /// Whether nobody said so: all of the picture, or as in the paper's frames.
    #[cfg_attr(feature = "serde", serde(default))]
    pub gel_assumed: bool,
    /// All that the network may see: the gel, or what a crop shows of it.
    pub part: Rect,
    /// Millimetres on the gel for a pixel of the picture, and how that is known.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub scale: Scale,
    /// How a GPU stored maps and weights: f32 also where [`Config::precision`] says f16, but the picture
    /// overflowed that.
    pub precision: Precision,
    /// Whether something touches the gel; `None` if nobody looked, which [`Scene`] decides. Where nothing
    /// does, the network did not run.
    #[cfg_attr(feature = "serde", serde(default))]
    pub contact: Option<bool>,
    /// The parts of the frame that the network looked at, with what is in contact; empty where nothing is,
    /// `None` for all of it.
    #[cfg_attr(feature = "serde", serde(default))]
    pub regions: Option<Vec<Rect>>,
    /// Whether the network looked, and without its deepest scale, which [`Scene::scales`] leaves out.
    #[cfg_attr(feature = "serde", serde(default))]
    pub without_deepest: bool,
    /// Whether a first look left a box in doubt ([`Scene::doubt`]), so that these are what a second one found
    /// in all of the picture, with nothing left out.
    #[cfg_attr(feature = "serde", serde(default))]
    pub looked_again: bool,
    /// Whether the frame is as one before it in a stream, so that its detections are that one's.
    #[cfg_attr(feature = "serde", serde(default))]
    pub reused: bool,
    /// How many proposals the last stage looked at.
    pub proposals: u32,
    /// Time by stage on the device; empty where it has no timestamps.
    pub stages: Vec<StageTime>,
    /// Time from picture to detections; serialised as `wall_ms`.
    #[cfg_attr(feature = "serde", serde(rename = "wall_ms", with = "crate::engine::milliseconds"))]
    pub wall: Duration,
}

impl Detections {
    /// What was assumed of the picture's scale, and of which part of it is gel, in a line; `None` where all
    /// was stated. Where that is wrong, millimetres are, and snaps may be missed or taken for others.
    pub fn assumption(&self) -> Option<String> {
        let gel = self.gel_assumed.then_some(self.gel);
        view::assumption([self.width, self.height], gel, self.scale)
    }
}

/// What one picture gives on a device and in the f64 reference.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The network's stages, in order.
    pub stages: Vec<StageComparison>,
    /// The choice of the proposals.
    pub proposals: ChoiceComparison,
    /// The choice of the detections.
    pub detections: ChoiceComparison,
    /// How far apart the detections are that both found.
    pub shift: Shift,
    /// [`Shift::pixels`] in millimetres on the gel.
    pub shift_mm: f64,
    /// What the device found.
    pub found: Detections,
    /// What the reference found.
    pub expected: Detections,
}

impl Comparison {
    /// What is wrong, a line each; empty if the device does as the reference.
    pub fn failures(&self) -> impl Iterator<Item = &str> {
        let tensors = self.stages.iter().flat_map(|s| &s.tensors);
        let tensors = tensors.filter_map(|t| t.failure.as_ref());
        let choices = self.proposals.failures.iter().chain(&self.detections.failures);
        tensors.chain(choices).map(String::as_str)
    }

    /// Differences that rounding excuses, a line each.
    pub fn excused(&self) -> impl Iterator<Item = &str> {
        self.proposals.excused.iter().chain(&self.detections.excused).map(String::as_str)
    }

    /// The largest error of an element on its operation's own inputs, as a share of its bound.
    pub fn share(&self) -> f64 {
        self.stages.iter().map(StageComparison::share).fold(0.0, f64::max)
    }

    /// The largest bias of a tensor as a share of its bound; not a number if one is not.
    pub fn bias(&self) -> f64 {
        self.stages.iter().filter_map(StageComparison::bias).fold(0.0, larger)
    }

    /// The largest drift of a stage; not a number if one is not.
    pub fn drift(&self) -> f64 {
        self.stages.iter().filter_map(StageComparison::drift).fold(0.0, larger)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::comparison::TensorComparison;

    #[test]
    fn a_figure_that_is_no_number_is_the_largest() {
        let stage = |value: f64| {
            let (bias, drift) = (Some(value), Some(value));
            let tensor =
                TensorComparison { name: "t".into(), share: 0.0, bias, drift, failure: None };
            let (time, reference_time) = (None, Duration::ZERO);
            StageComparison { stage: "s".into(), time, reference_time, tensors: vec![tensor] }
        };
        let found = Detections {
            detections: Vec::new(),
            width: 1,
            height: 1,
            gel: Rect { x: 0, y: 0, width: 1, height: 1 },
            gel_assumed: false,
            part: Rect { x: 0, y: 0, width: 1, height: 1 },
            scale: Scale::stated(1.0),
            precision: Precision::F32,
            contact: None,
            regions: None,
            without_deepest: false,
            looked_again: false,
            reused: false,
            proposals: 0,
            stages: Vec::new(),
            wall: Duration::ZERO,
        };
        let compared = |values: &[f64]| Comparison {
            stages: values.iter().copied().map(stage).collect(),
            proposals: ChoiceComparison::default(),
            detections: ChoiceComparison::default(),
            shift: Shift::default(),
            shift_mm: 0.0,
            found: found.clone(),
            expected: found.clone(),
        };
        let sound = compared(&[0.5, 2.0, 1.0]);
        assert_eq!((sound.bias(), sound.drift()), (2.0, 2.0));
        let broken = compared(&[0.5, f64::NAN, 1.0]);
        assert!(broken.bias().is_nan() && broken.drift().is_nan());
    }
}
