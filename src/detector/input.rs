//! From a frame to what the network takes, and back from what it gives.

use std::time::Instant;

use crate::comparison::Values;
use crate::detector::{Detection, Detections};
use crate::error::{Error, Result};
use crate::frame::{Frame, Square};
use crate::graph::{StageTime, TensorId};
use crate::model::Network;
use crate::ops::Crop;
use crate::tensor::{Tensor, Value};

/// A picture as the network takes it, and where its square lies.
pub(super) struct Input {
    pub start: Instant,
    pub width: u32,
    pub height: u32,
    /// Left and upper edge of the square in the picture.
    pub origin: [u32; 2],
    pub side: u32,
    /// The middle of what shows the gel.
    pub middle: [f32; 2],
    pub pixels: Value,
    pub square: Value,
}

impl Input {
    /// # Errors
    /// What is wrong with the frame.
    pub fn new(frame: &Frame) -> Result<Self> {
        let start = Instant::now();
        let Square { x, y, side, pixels } = frame.square()?;
        let part = frame.part();
        let crop = Crop::central(side as usize, side as usize);
        let square = crop.to_tensor(pixels.len())?.into();
        let pixels = Tensor::new([pixels.len()], pixels)?.into();
        Ok(Self {
            start,
            width: frame.width,
            height: frame.height,
            origin: [x, y],
            side,
            middle: [(part.x, part.width), (part.y, part.height)]
                .map(|(at, length)| at as f32 + length as f32 / 2.0),
            pixels,
            square,
        })
    }

    pub fn inputs(&self, network: &Network) -> [(TensorId, &Value); 2] {
        [(network.picture, &self.pixels), (network.crop, &self.square)]
    }

    /// Pixels of the picture for one of the network's input.
    pub fn scale(&self, network: &Network) -> f32 {
        self.side as f32 / network.config.input_size as f32
    }

    /// What the network's outputs say of the picture.
    pub fn detections(
        &self,
        network: &Network,
        values: &Values,
        stages: Vec<StageTime>,
    ) -> Result<Detections> {
        check_finite(network, values)?;
        Ok(Detections {
            detections: self.collect(network, values)?,
            width: self.width,
            height: self.height,
            proposals: count_of(network, values, network.proposal_count)?,
            stages,
            wall: self.start.elapsed(),
        })
    }

    fn collect(&self, network: &Network, values: &Values) -> Result<Vec<Detection>> {
        let boxes = value(network, values, network.boxes)?.f32()?;
        let scores = value(network, values, network.scores)?.f32()?;
        let classes = value(network, values, network.classes)?.u32()?;
        let count = count_of(network, values, network.count)? as usize;
        let config = &network.config;
        let scale = self.scale(network);
        let origin = self.origin.map(|at| at as f32);
        let mm_per_pixel = config.mm_per_pixel_of(self.side);
        let rows = boxes.data().chunks_exact(4).zip(scores.data()).zip(classes.data());
        rows.take(count)
            .map(|((b, score), class)| {
                let bbox = std::array::from_fn(|i| b[i] * scale + origin[i % 2]);
                let center = |i: usize| (bbox[i] + bbox[i + 2]) / 2.0 - self.middle[i];
                let class_index = (*class as usize).wrapping_sub(1);
                let name = config.classes.get(class_index);
                let name = name.ok_or_else(|| {
                    Error::tensor("detect", "detections.labels", "a class of the weights", class)
                })?;
                Ok(Detection {
                    class: name.clone(),
                    class_index,
                    score: *score,
                    bbox,
                    center_mm: [0, 1].map(|i| center(i) * mm_per_pixel),
                })
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
            let stage = network.graph.name(witness.tensor).into();
            return Err(Error::NotFinite { stage, count });
        }
    }
    Ok(())
}
