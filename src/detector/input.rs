//! From a frame to what the network takes, and back from what it gives.

use std::time::{Duration, Instant};

use crate::comparison::Values;
use crate::cpu::Crop;
use crate::detector::regions::{self, Found, Window};
use crate::detector::view::View;
use crate::detector::{Detection, Detections};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::graph::{StageTime, TensorId};
use crate::model::{ModelConfig, Network};
use crate::precision::Precision;
use crate::rect::Rect;
use crate::tensor::{Tensor, Value};

/// Deviations hold where the input is at the scale that they were fitted at, within this share.
const SAME_SCALE: f64 = 0.05;

/// How large the network's input is for a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Geometry {
    /// Width and height that the view's part is resized to.
    pub resized: [usize; 2],
    /// Height and width of the input, which repeats the part's right and lower edges.
    pub size: [usize; 2],
}

impl Geometry {
    /// The part at the network's own scale, or with `longer` pixels along its longer side.
    ///
    /// # Errors
    /// [`Error::Param`] for `longer` past [`ModelConfig::INPUT_SIZES`]; [`Error::Picture`] for a part that is
    /// past them at the network's own scale.
    pub fn new(view: &View, model: &ModelConfig, longer: Option<usize>) -> Result<Self> {
        let part = [view.part.width, view.part.height].map(f64::from);
        let scale = match longer {
            Some(pixels) => pixels as f64 / part[0].max(part[1]),
            None => f64::from(model.pixels_per_mm) * f64::from(view.scale.mm_per_pixel),
        };
        let resized = part.map(|side| ((side * scale).round() as usize).max(1));
        // A side past all numbers stays as it is, and is refused.
        let padded = |side: usize| side.checked_next_multiple_of(32).unwrap_or(side);
        let [width, height] = resized.map(padded);
        for side in [width, height] {
            if ModelConfig::is_input_size(side) {
                continue;
            }
            if longer.is_some() {
                let expected = ModelConfig::INPUT_SIZES;
                return Err(Error::param("detect", "input_size", expected, side));
            }
            let (scale, most) = (model.pixels_per_mm, ModelConfig::MAX_INPUT);
            let field = part[0].max(part[1]) * f64::from(view.scale.mm_per_pixel);
            let message = format!(
                "expected a field of at most {:.3} mm along its longer side, which is {most} pixels at the \
                 weights' {scale} a millimetre, got {field:.3} mm",
                most as f32 / scale
            );
            return Err(Error::Picture { file: "picture".into(), message });
        }
        Ok(Self { resized, size: [height, width] })
    }
}

/// A picture as the network takes it, and where it lies in the frame.
pub(super) struct Input<'a> {
    pub start: Instant,
    pub view: View,
    pub geometry: Geometry,
    /// What the view's part is made from, a single word where the frame's own bytes are.
    pub pixels: Value,
    /// The frame's own bytes.
    pub borrowed: Option<&'a [u8]>,
    /// Words that the part's bytes fill.
    words: usize,
    /// How long it took to make it.
    took: Duration,
    crop: Crop,
    /// The crop of all of it, at the network's scale.
    whole: Value,
}

/// What the network gave for all of its input, or for a part.
pub(super) struct Answer {
    pub found: Vec<Found>,
    pub proposals: u32,
    /// Whether the network looked at its deepest scale too.
    pub deepest: bool,
}

impl<'a> Input<'a> {
    /// With the frame's own bytes if `borrow`, and if they are as the network reads them; else with a copy.
    ///
    /// # Errors
    /// [`Error::Capacity`] for a part of the frame that is too large.
    pub fn new(
        start: Instant,
        frame: &'a Frame<'_>,
        view: View,
        geometry: Geometry,
        borrow: bool,
    ) -> Result<Self> {
        let began = Instant::now();
        let own = if borrow { frame.own_bytes(view.part) } else { None };
        let (pixels, borrowed, crop) = match own {
            Some((bytes, crop)) => (Tensor::zeros([1]), Some(bytes), crop),
            None => {
                let (pixels, crop) = frame.bytes(view.part)?;
                (pixels, None, crop)
            }
        };
        let words = borrowed.map_or(pixels.data().len(), |bytes| bytes.len().div_ceil(4));
        let crop = Crop { resized: geometry.resized, ..crop };
        let whole = crop.to_tensor(words)?.into();
        let (pixels, took) = (pixels.into(), began.elapsed());
        Ok(Self { start, view, geometry, pixels, borrowed, words, took, crop, whole })
    }

    /// The time that it took to get at the frame's bytes.
    pub fn taken(&self) -> StageTime {
        StageTime { stage: "frame".to_owned(), time: self.took }
    }

    /// The crop of all of the view's part, resized to this width and height.
    ///
    /// # Errors
    /// As [`Crop::to_tensor`].
    pub fn resized(&self, resized: [usize; 2]) -> Result<Value> {
        Ok(Crop { resized, ..self.crop }.to_tensor(self.words)?.into())
    }

    /// The crop of a part of the network's input.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a window that begins behind the resized part.
    pub fn part(&self, window: &Window) -> Result<Value> {
        let window = [window.x, window.y];
        Ok(Crop { window, ..self.crop }.to_tensor(self.words)?.into())
    }

    /// All of the network's input.
    pub fn whole(&self) -> Window {
        let [height, width] = self.geometry.size;
        Window { x: 0, y: 0, width, height }
    }

    /// What the frame shows where a part of the network's input is.
    pub fn rect(&self, window: &Window) -> Rect {
        let part = self.view.part;
        let side = |at: usize, length: usize, axis: usize, first: u32, full: u32| {
            let scale = self.scale()[axis];
            let from = ((at as f32 * scale) as u32).min(full - 1);
            let to = (((at + length) as f32 * scale).ceil() as u32).min(full);
            (first + from, to.saturating_sub(from).max(1))
        };
        let (x, width) = side(window.x, window.width, 0, part.x, part.width);
        let (y, height) = side(window.y, window.height, 1, part.y, part.height);
        Rect { x, y, width, height }
    }

    pub fn inputs(&self, network: &Network) -> [(TensorId, &Value); 2] {
        [(network.picture, &self.pixels), (network.crop, &self.whole)]
    }

    /// Pixels of the frame for one of the network's input, along x and y.
    pub fn scale(&self) -> [f32; 2] {
        let part = [self.view.part.width, self.view.part.height];
        std::array::from_fn(|axis| part[axis] as f32 / self.geometry.resized[axis] as f32)
    }

    /// Whether the network sees the gel at its own scale, at which the deviations that it states hold.
    fn is_at_own_scale(&self, model: &ModelConfig) -> bool {
        let own = f64::from(model.pixels_per_mm) * f64::from(self.view.scale.mm_per_pixel);
        self.scale().iter().all(|scale| (1.0 / (own * f64::from(*scale)) - 1.0).abs() <= SAME_SCALE)
    }

    /// What the network's outputs say of the picture.
    pub fn detections(
        &self,
        network: &Network,
        values: &Values,
        stages: Vec<StageTime>,
    ) -> Result<Detections> {
        let Answer { found, proposals, deepest } =
            self.answer(network, values, &self.whole(), 0)?;
        let found = found.into_iter().map(|found| found.detection).collect();
        let without_deepest = !deepest;
        Ok(Detections { proposals, without_deepest, stages, ..self.report(found) })
    }

    /// These detections of the picture, and that nothing was left out.
    pub fn report(&self, detections: Vec<Detection>) -> Detections {
        let [width, height] = self.view.frame;
        Detections {
            detections,
            width,
            height,
            gel: self.view.gel,
            gel_assumed: self.view.gel_assumed,
            part: self.view.part,
            scale: self.view.scale,
            precision: Precision::F32,
            contact: None,
            regions: None,
            without_deepest: false,
            looked_again: false,
            reused: false,
            proposals: 0,
            stages: Vec::new(),
            wall: self.start.elapsed(),
        }
    }

    /// What the network's outputs say of part number `part`, which is `window`.
    pub fn answer(
        &self,
        network: &Network,
        values: &Values,
        window: &Window,
        part: usize,
    ) -> Result<Answer> {
        check_finite(network, values)?;
        let found = self.collect(network, values, window, part)?;
        let proposals = count_of(network, values, network.proposal_count)?;
        Ok(Answer { found, proposals, deepest: network.deepest })
    }

    fn collect(
        &self,
        network: &Network,
        values: &Values,
        window: &Window,
        part: usize,
    ) -> Result<Vec<Found>> {
        let boxes = value(network, values, network.boxes)?.f32()?;
        let scores = value(network, values, network.scores)?.f32()?;
        let margins = value(network, values, network.margins)?.f32()?;
        let classes = value(network, values, network.classes)?.u32()?;
        let poses = match network.pose {
            Some(pose) => value(network, values, pose)?.f32()?.data().as_chunks::<5>().0,
            None => &[],
        };
        let count = count_of(network, values, network.count)? as usize;
        let config = &network.config;
        let scale = self.scale();
        let states = self.is_at_own_scale(config);
        let origin = [self.view.part.x, self.view.part.y].map(|at| at as f32);
        let edge = self.geometry.resized.map(|side| side as f32);
        let corner = [window.x, window.y].map(|at| at as f32);
        let rows = boxes.data().chunks_exact(4).zip(scores.data()).zip(margins.data());
        let rows = rows.zip(classes.data());
        rows.take(count)
            .enumerate()
            .map(|(i, (((b, score), margin), class))| {
                let inside = std::array::from_fn(|k| b[k] + corner[k % 2]);
                // What repeats the part's edge is no part of it.
                let bbox: [f32; 4] = std::array::from_fn(|k| {
                    let axis = k % 2;
                    inside[k].min(edge[axis]) * scale[axis] + origin[axis]
                });
                let center = [0, 1].map(|axis| (bbox[axis] + bbox[axis + 2]) / 2.0);
                let class_index = (*class as usize).wrapping_sub(1);
                let name = config.classes.get(class_index);
                let name = name.ok_or_else(|| {
                    Error::tensor("detect", "detections.labels", "a class of the weights", class)
                })?;
                let pose = poses.get(i);
                let direction = pose.filter(|_| config.directed.contains(name));
                let detection = Detection {
                    class: name.clone(),
                    class_index,
                    score: *score,
                    bbox,
                    center_mm: self.view.place_mm(center),
                    center_std_mm: pose.filter(|_| states).map(|p| [p[2], p[3]]),
                    yaw_deg: direction.map(|p| p[0]),
                    yaw_std_deg: direction.filter(|_| states).map(|p| p[1]),
                    whole: pose.map(|p| p[4]),
                };
                let cut = regions::is_cut(inside, window, self.geometry.size);
                Ok(Found { detection, margin: *margin, part, cut })
            })
            .collect()
    }
}

fn value<'a>(network: &Network, values: &'a Values, id: TensorId) -> Result<&'a Value> {
    let name = network.graph.name(id);
    values.get(&id).ok_or_else(|| Error::tensor("detect", name, "an output", "nothing"))
}

fn count_of(network: &Network, values: &Values, id: TensorId) -> Result<u32> {
    Ok(value(network, values, id)?.u32()?.data().first().copied().unwrap_or(0))
}

/// Names the first tensor in which the network found values that are not finite.
fn check_finite(network: &Network, values: &Values) -> Result<()> {
    for witness in &network.witnesses {
        let counts = value(network, values, witness.counts)?.u32()?;
        let count = counts.data().iter().map(|n| u64::from(*n)).sum();
        if count > 0 {
            return Err(Error::NotFinite { stage: witness.stage.clone(), count });
        }
    }
    Ok(())
}
