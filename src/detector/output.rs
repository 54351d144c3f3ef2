//! From what the network gives to detections.

use crate::detector::geometry::Region;
use crate::detector::input::Input;
use crate::detector::{Detection, Detections};
use crate::engine::graph::{StageTime, TensorId, Values};
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};
use crate::smr::{ModelConfig, Network};

/// Deviations hold where the input is at the scale that they were fitted at, within this share.
const SAME_SCALE: f64 = 0.05;

/// What the network gave for a region of its input.
pub(crate) struct RegionOutput {
    pub detections: Vec<RegionDetection>,
    pub proposals: u32,
    /// Whether the network has computed its deepest scale.
    pub deepest: bool,
}

/// A detection in one region.
pub(crate) struct RegionDetection {
    pub detection: Detection,
    /// The score's logit: scores close to 1 are equal in f32 where these differ.
    pub margin: f32,
    /// The region's place among those of its picture.
    pub part: usize,
    /// Whether it reaches an edge of its region that is none of the input.
    pub cut: bool,
}

impl Input<'_> {
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
        let RegionOutput { detections, proposals, deepest } =
            self.output(network, values, &self.whole(), 0)?;
        let found = detections.into_iter().map(|found| found.detection).collect();
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

    /// What the network's outputs say of `region`, number `part` of its picture.
    pub fn output(
        &self,
        network: &Network,
        values: &Values,
        region: &Region,
        part: usize,
    ) -> Result<RegionOutput> {
        check_finite(network, values)?;
        let detections = self.collect(network, values, region, part)?;
        let proposals = count_of(network, values, network.proposal_count)?;
        Ok(RegionOutput { detections, proposals, deepest: network.deepest })
    }

    fn collect(
        &self,
        network: &Network,
        values: &Values,
        region: &Region,
        part: usize,
    ) -> Result<Vec<RegionDetection>> {
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
        let corner = [region.x, region.y].map(|at| at as f32);
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
                let cut = region.cuts(inside, self.geometry.size);
                Ok(RegionDetection { detection, margin: *margin, part, cut })
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
        let short = || Error::tensor("detect", "counts", witness.places.end, counts.data().len());
        let own = counts.data().get(witness.places.clone()).ok_or_else(short)?;
        let count = own.iter().map(|n| u64::from(*n)).sum();
        if count > 0 {
            return Err(Error::NotFinite { stage: witness.stage.clone(), count });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::detector::input::tests::{input, uneven};
    use crate::engine::tensor::Tensor;
    use crate::smr::{Wanted, Weights};

    fn network() -> Network {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/smrnet-s.safetensors");
        Network::new(Weights::open(&file).expect("weights"), [96, 160], Wanted::ALL)
            .expect("a network")
    }

    /// What a network says that found these boxes, with their classes from 1 and their poses.
    fn values(network: &Network, found: &[([f32; 4], u32, [f32; 5])]) -> Values {
        let n = found.len();
        let floats = |shape: &[usize], data: Vec<f32>| -> Value {
            Tensor::new(crate::engine::shape::Shape(shape.to_vec()), data).expect("a tensor").into()
        };
        let integers =
            |data: Vec<u32>| -> Value { Tensor::new([data.len()], data).expect("a tensor").into() };
        let flat = |f: &dyn Fn(usize) -> Vec<f32>| (0..n).flat_map(f).collect::<Vec<f32>>();
        let mut values = Values::from([
            (network.boxes, floats(&[n, 4], flat(&|i| found[i].0.to_vec()))),
            (network.scores, floats(&[n], vec![0.9; n])),
            (network.margins, floats(&[n], vec![2.0; n])),
            (network.classes, integers(found.iter().map(|f| f.1).collect())),
            (network.count, integers(vec![n as u32])),
            (network.proposal_count, integers(vec![7])),
        ]);
        let pose = network.pose.expect("weights that know poses");
        values.insert(pose, floats(&[n, 5], flat(&|i| found[i].2.to_vec())));
        for witness in &network.witnesses {
            let words = network.graph.spec(witness.counts).shape.elements();
            values.insert(witness.counts, integers(vec![0; words]));
        }
        values
    }

    fn detections(
        input: &Input,
        region: &Region,
        found: &[([f32; 4], u32, [f32; 5])],
    ) -> Vec<Detection> {
        let network = network();
        let output = input.output(&network, &values(&network, found), region, 0);
        output.expect("an output").detections.into_iter().map(|found| found.detection).collect()
    }

    /// By hand. The second box reaches into the repeated edges: the part ends at column 420 and row 260.
    #[test]
    fn boxes_come_back_to_the_frame() {
        let input = uneven();
        let boxes = [[10.0, 20.0, 50.0, 60.0], [140.0, 70.0, 158.0, 95.0]];
        let found =
            detections(&input, &input.whole(), &[(boxes[0], 1, [0.0; 5]), (boxes[1], 2, [0.0; 5])]);
        assert_eq!(found[0].bbox, [140.0, 110.0, 220.0, 210.0]);
        assert_eq!(found[1].bbox, [400.0, 235.0, 420.0, 260.0]);
        // (180, 160) and (410, 247.5), from (300, 190).
        assert_eq!(found[0].center_mm, [-120.0 * 0.05, -30.0 * 0.05]);
        assert_eq!(found[1].center_mm, [110.0 * 0.05, 57.5 * 0.05]);
        let classes: Vec<_> = found.iter().map(|d| (d.class.as_str(), d.class_index)).collect();
        assert_eq!(classes, [("A", 0), ("B", 1)]);
    }

    #[test]
    fn a_regions_boxes_come_back_to_the_frame() {
        let region = Region { x: 32, y: 16, width: 64, height: 64 };
        let found = detections(&uneven(), &region, &[([10.0, 20.0, 50.0, 60.0], 1, [0.0; 5])]);
        // Columns 42 to 82 and rows 36 to 76 of the input.
        assert_eq!(found[0].bbox, [204.0, 150.0, 284.0, 250.0]);
    }

    /// At the weights' own 8 pixels a millimetre: two frame pixels of 1/16 mm for one of the input.
    #[test]
    fn a_pose_is_that_of_its_box() {
        let input = input(0.0625, [150, 100], [128, 160]);
        let bbox = [10.0, 20.0, 50.0, 60.0];
        let poses = [[30.0, 1.0, 0.1, 0.2, 0.75], [-60.0, 2.0, 0.3, 0.4, 0.25]];
        let found = detections(&input, &input.whole(), &[(bbox, 1, poses[0]), (bbox, 2, poses[1])]);
        let [hook, stud] = &found[..] else { panic!("two: {found:?}") };
        assert_eq!((hook.yaw_deg, hook.yaw_std_deg), (Some(30.0), Some(1.0)));
        assert_eq!((hook.center_std_mm, hook.whole), (Some([0.1, 0.2]), Some(0.75)));
        // A stud has no direction.
        assert_eq!((stud.yaw_deg, stud.yaw_std_deg), (None, None));
        assert_eq!((stud.center_std_mm, stud.whole), (Some([0.3, 0.4]), Some(0.25)));
    }

    #[test]
    fn one_value_that_is_not_finite_is_named() {
        let (input, network) = (uneven(), network());
        let mut values = values(&network, &[]);
        let witness = network.witnesses.last().expect("witnesses");
        let words = network.graph.spec(witness.counts).shape.elements();
        let told = |i| u32::from(witness.places.contains(&i));
        values.insert(witness.counts, Tensor::from_fn([words], told).into());
        let error = input.output(&network, &values, &input.whole(), 0).err().expect("an error");
        assert!(
            matches!(&error, Error::NotFinite { stage, count: 1 } if *stage == witness.stage),
            "{error}"
        );
    }
}
