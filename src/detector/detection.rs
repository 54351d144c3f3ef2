//! What a detector finds.

use std::time::Duration;

use crate::engine::graph::StageTime;
use crate::engine::precision::Precision;
use crate::sensor::rect::{self, Rect};
use crate::sensor::scale::Scale;
use crate::sensor::view;

#[cfg(doc)]
use crate::detector::Config;
use crate::detector::Savings;
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

impl Detection {
    /// The box's centre (x, y) in pixels of the picture.
    pub fn center(&self) -> [f32; 2] {
        [0, 1].map(|axis| (self.bbox[axis] + self.bbox[axis + 2]) / 2.0)
    }

    /// The box's width and height in pixels of the picture.
    pub fn size(&self) -> [f32; 2] {
        [0, 1].map(|axis| self.bbox[axis + 2] - self.bbox[axis])
    }

    /// Corners of the rectangle along [`Detection::yaw_deg`] that the box encloses, in pixels of the picture:
    /// from the one at the upper left of a snap that points right, in the sense of the yaw. Those of the box for
    /// a snap without direction. From 40° to 50° off an axis, where a box hardly depends on which side is the
    /// longer, it is a square.
    pub fn corners(&self) -> [[f32; 2]; 4] {
        let ([x, y], [width, height]) = (self.center(), self.size());
        let (sin, cos) = self.yaw_deg.unwrap_or(0.0).to_radians().sin_cos();
        // The box of a rectangle l × w: width = l |cos| + w |sin|, height = l |sin| + w |cos|.
        let (s, c) = (sin.abs(), cos.abs());
        let determinant = c * c - s * s;
        let sides = [width * c - height * s, height * c - width * s].map(|side| side / determinant);
        let is_known = determinant.abs() >= 0.17 && sides.iter().all(|side| *side > 0.0);
        let square = [width.min(height) / (s + c); 2];
        let [l, w] = if is_known { sides } else { square };
        [[-l, -w], [l, -w], [l, w], [-l, w]].map(|[along, across]| {
            [x + (along * cos - across * sin) / 2.0, y + (along * sin + across * cos) / 2.0]
        })
    }
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
    /// Whether something touches the gel; `None` if [`Savings`] did not ask. Where nothing
    /// does, the network did not run.
    #[cfg_attr(feature = "serde", serde(default))]
    pub contact: Option<bool>,
    /// The parts of the frame that the network ran on, with what is in contact; empty where nothing is,
    /// `None` for all of it.
    #[cfg_attr(feature = "serde", serde(default))]
    pub regions: Option<Vec<Rect>>,
    /// Whether the network ran, and without its deepest scale, which [`Savings::scales`] leaves out.
    #[cfg_attr(feature = "serde", serde(default))]
    pub without_deepest: bool,
    /// Whether a first run left a box in doubt ([`Savings::doubt`]), so that these are what a second one found
    /// in all of the picture, with nothing left out.
    #[cfg_attr(feature = "serde", serde(default))]
    pub looked_again: bool,
    /// Whether the frame is as one before it in a stream, so that its detections are that one's.
    #[cfg_attr(feature = "serde", serde(default))]
    pub reused: bool,
    /// How many proposals the last stage saw.
    pub proposals: u32,
    /// Time by stage on the device; empty where it has no timestamps.
    pub stages: Vec<StageTime>,
    /// Time from picture to detections; serialised as `wall_ms`.
    #[cfg_attr(feature = "serde", serde(rename = "wall_ms", with = "crate::engine::milliseconds"))]
    pub wall: Duration,
}

impl Detections {
    /// How many snaps there are.
    pub fn len(&self) -> usize {
        self.detections.len()
    }

    /// Whether there is no snap.
    pub fn is_empty(&self) -> bool {
        self.detections.is_empty()
    }

    /// The snaps, best first.
    pub fn iter(&self) -> std::slice::Iter<'_, Detection> {
        self.detections.iter()
    }

    /// What was assumed of the picture's scale, and of which part of it is gel, in a line; `None` where all
    /// was stated. Where that is wrong, millimetres are, and snaps may be missed or taken for others.
    pub fn assumption(&self) -> Option<String> {
        let gel = self.gel_assumed.then_some(self.gel);
        view::assumption([self.width, self.height], gel, self.scale)
    }

    /// What was left out of the picture by a detector with these savings, and why, a line each; nothing where
    /// all was computed.
    pub fn left_out(&self, savings: &Savings) -> Vec<String> {
        if self.reused {
            return vec![
                "the frame: it equals an earlier one within the sensor's noise".to_owned(),
            ];
        }
        if savings.contact && self.contact == Some(false) {
            return vec!["the network: nothing touches the gel".to_owned()];
        }
        let mut left = Vec::new();
        if let Some(regions) = &self.regions {
            let share = 1.0 - rect::area(regions) / rect::area(&[self.part]);
            let margin = savings.margin_mm;
            left.push(format!("{share:.2} of the gel: no contact within {margin} mm of it"));
        }
        if savings.proposals && !self.looked_again {
            let most = savings.most_proposals;
            left.push(format!("proposals: none but the best, {most} in 320 x 320 pixels"));
        }
        if self.without_deepest {
            left.push("the deepest scale: no box was in doubt without it".to_owned());
        }
        left
    }
}

impl IntoIterator for Detections {
    type Item = Detection;
    type IntoIter = std::vec::IntoIter<Detection>;

    fn into_iter(self) -> Self::IntoIter {
        self.detections.into_iter()
    }
}

impl<'a> IntoIterator for &'a Detections {
    type Item = &'a Detection;
    type IntoIter = std::slice::Iter<'a, Detection>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[cfg(feature = "serde")]
    use crate::sensor::scale::Origin;

    #[cfg(feature = "serde")]
    /// The names that `smr-gpu detect --json` prints, and all of it back.
    #[test]
    fn detections_are_serialised() {
        let stages = vec![StageTime { stage: "input".into(), time: Duration::from_micros(1500) }];
        let detection = Detection {
            class: "B".into(),
            class_index: 1,
            score: 0.75,
            bbox: [1.0, 2.5, 3.0, 4.0],
            center_mm: [-0.5, 0.25],
            center_std_mm: Some([0.125, 0.0625]),
            yaw_deg: None,
            yaw_std_deg: None,
            whole: Some(0.5),
        };
        let found = Detections {
            detections: vec![detection],
            width: 640,
            height: 480,
            gel: Rect { x: 80, y: 0, width: 480, height: 480 },
            gel_assumed: false,
            part: Rect { x: 80, y: 0, width: 400, height: 480 },
            scale: Scale { mm_per_pixel: 0.0625, from: Origin::Assumed },
            precision: Precision::F16,
            contact: Some(true),
            regions: Some(vec![Rect { x: 1, y: 2, width: 3, height: 4 }]),
            without_deepest: true,
            looked_again: false,
            reused: false,
            proposals: 7,
            stages,
            wall: Duration::from_millis(20),
        };
        let json = serde_json::to_value(&found).expect("serialised");
        let want = serde_json::json!({
            "detections": [{
                "class": "B", "class_index": 1, "score": 0.75,
                "box": [1.0, 2.5, 3.0, 4.0], "center_mm": [-0.5, 0.25],
                "center_std_mm": [0.125, 0.0625], "yaw_deg": null, "yaw_std_deg": null, "whole": 0.5
            }],
            "width": 640, "height": 480, "gel": {"x": 80, "y": 0, "width": 480, "height": 480},
            "part": {"x": 80, "y": 0, "width": 400, "height": 480},
            "gel_assumed": false, "mm_per_pixel": 0.0625, "scale_from": "assumed",
            "precision": "f16", "proposals": 7,
            "contact": true, "regions": [{"x": 1, "y": 2, "width": 3, "height": 4}],
            "without_deepest": true, "looked_again": false, "reused": false,
            "stages": [{"stage": "input", "ms": 1.5}],
            "wall_ms": 20.0
        });
        assert_eq!(json, want);
        assert_eq!(serde_json::from_value::<Detections>(want).expect("read"), found);
        let negative = r#"{"stage": "input", "ms": -1.0}"#;
        assert!(serde_json::from_str::<StageTime>(negative).is_err());
    }

    fn pointing(yaw_deg: Option<f32>, bbox: [f32; 4]) -> Detection {
        Detection {
            class: "A".into(),
            class_index: 0,
            score: 1.0,
            bbox,
            center_mm: [0.0; 2],
            center_std_mm: None,
            yaw_deg,
            yaw_std_deg: None,
            whole: None,
        }
    }

    /// 8 × 4 pixels round (10, 20), turned by angles whose sine and cosine are those of a 3-4-5 triangle, or by
    /// right angles, and back from the box.
    #[test]
    fn a_box_gives_its_turned_rectangle_back() {
        let yaw = (0.6_f32).atan2(0.8).to_degrees();
        for (yaw, width, height) in [
            (0.0, 8.0, 4.0),
            (90.0, 4.0, 8.0),
            (180.0, 8.0, 4.0),
            (yaw, 8.8, 8.0),
            (-yaw, 8.8, 8.0),
            (90.0 - yaw, 8.0, 8.8),
        ] {
            let bbox =
                [10.0 - width / 2.0, 20.0 - height / 2.0, 10.0 + width / 2.0, 20.0 + height / 2.0];
            let snap = pointing(Some(yaw), bbox);
            assert_eq!(
                (snap.center(), snap.size().map(|v| (v * 10.0).round())),
                ([10.0, 20.0], [width, height].map(|v| (v * 10.0).round()))
            );
            let (sin, cos) = yaw.to_radians().sin_cos();
            for ([x, y], [along, across]) in
                snap.corners().into_iter().zip([[-4.0, -2.0], [4.0, -2.0], [4.0, 2.0], [-4.0, 2.0]])
            {
                let want = [10.0 + along * cos - across * sin, 20.0 + along * sin + across * cos];
                let off = (x - want[0]).hypot(y - want[1]);
                assert!(off < 1e-4, "{yaw}: ({x}, {y}), {want:?}");
            }
        }
        let stud = pointing(None, [1.0, 2.0, 5.0, 8.0]);
        assert_eq!(stud.corners(), [[1.0, 2.0], [5.0, 2.0], [5.0, 8.0], [1.0, 8.0]]);
        // Half of the diagonal each way.
        let square = pointing(Some(45.0), [0.0, 0.0, 2.0, 2.0]).corners();
        let want = [[1.0, 0.0], [2.0, 1.0], [1.0, 2.0], [0.0, 1.0]];
        for (got, want) in square.as_flattened().iter().zip(want.as_flattened()) {
            assert!((got - want).abs() < 1e-5, "{square:?}");
        }
    }
}
