//! From a frame to what the network takes, and back from what it gives.

use std::time::{Duration, Instant};

use crate::detector::regions::{self, Found, Window};
use crate::detector::{Detection, Detections};
use crate::engine::graph::{StageTime, TensorId};
use crate::engine::precision::Precision;
use crate::engine::reference::Crop;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};
use crate::sensor::frame::Frame;
use crate::sensor::rect::Rect;
use crate::sensor::view::View;
use crate::smr::{ModelConfig, Network};
use crate::verify::comparison::Values;

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

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::LazyLock;

    use super::*;
    use crate::engine::reference::crop_resize;
    use crate::engine::tensor::Tensor;
    use crate::sensor::Lens;
    use crate::sensor::pixel_format::PixelFormat;
    use crate::sensor::scale::Scale;
    use crate::smr::{Wanted, Weights};

    /// A frame of 640 × 400 pixels whose gel's middle is at (300, 190), of which 300 × 200 at (120, 60) are
    /// seen.
    fn view(mm_per_pixel: f32) -> View {
        View {
            frame: [640, 400],
            gel: Rect { x: 100, y: 40, width: 400, height: 300 },
            gel_assumed: false,
            part: Rect { x: 120, y: 60, width: 300, height: 200 },
            scale: Scale::stated(mm_per_pixel),
            lens: Lens::of([0.0; 2], [640.0, 400.0], 0.0),
        }
    }

    fn input(mm_per_pixel: f32, resized: [usize; 2], size: [usize; 2]) -> Input<'static> {
        static FRAME: LazyLock<Frame> =
            LazyLock::new(|| Frame::new(vec![0; 640 * 400], 640, 400, PixelFormat::Gray8));
        let (view, geometry) = (view(mm_per_pixel), Geometry { resized, size });
        Input::new(Instant::now(), &FRAME, view, geometry, true).expect("an input")
    }

    /// Two frame pixels for one of the input along x, and 2.5 along y.
    fn uneven() -> Input<'static> {
        input(0.05, [150, 80], [96, 160])
    }

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
        let counts = network.witnesses.iter().map(|w| (w.counts, integers(vec![0])));
        values.extend(counts);
        values
    }

    fn detections(
        input: &Input,
        window: &Window,
        found: &[([f32; 4], u32, [f32; 5])],
    ) -> Vec<Detection> {
        let network = network();
        let answer = input.answer(&network, &values(&network, found), window, 0);
        answer.expect("an answer").found.into_iter().map(|found| found.detection).collect()
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
    fn a_windows_boxes_come_back_to_the_frame() {
        let window = Window { x: 32, y: 16, width: 64, height: 64 };
        let found = detections(&uneven(), &window, &[([10.0, 20.0, 50.0, 60.0], 1, [0.0; 5])]);
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
        values.insert(witness.counts, Tensor::new([1], vec![1_u32]).expect("a tensor").into());
        let error = input.answer(&network, &values, &input.whole(), 0).err().expect("an error");
        assert!(
            matches!(&error, Error::NotFinite { stage, count: 1 } if *stage == witness.stage),
            "{error}"
        );
    }

    /// 0.4 pixels of the input for one of the frame: 140.4 and 59.6, in whole thirty-twos.
    #[test]
    fn sizes_are_rounded_and_filled_up() {
        let part = Rect { x: 3, y: 5, width: 351, height: 149 };
        let view = View { part, ..view(0.05) };
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/smrnet-s.safetensors");
        let weights = Weights::open(&file).expect("weights");
        let geometry = |longer| Geometry::new(&view, weights.config(), longer).expect("a size");
        assert_eq!(geometry(None), Geometry { resized: [140, 60], size: [64, 160] });
        // 149 · 320 / 351 = 135.8.
        assert_eq!(geometry(Some(320)), Geometry { resized: [320, 136], size: [160, 320] });
    }

    #[test]
    fn windows_are_told_in_pixels_of_the_frame() {
        let input = uneven();
        // Columns 32 to 96 are 64 to 192, rows 16 to 49 are 40 to 122.5, all from (120, 60).
        let window = Window { x: 32, y: 16, width: 64, height: 33 };
        let want = Rect { x: 184, y: 100, width: 128, height: 83 };
        assert_eq!(input.rect(&window), want);
        // What repeats the edge shows no more than the part.
        let window = Window { x: 96, y: 64, width: 64, height: 32 };
        let want = Rect { x: 312, y: 220, width: 108, height: 40 };
        assert_eq!(input.rect(&window), want);
        assert_eq!(input.rect(&input.whole()), input.view.part);
    }

    /// `tests/fixtures/resize.py` has numbers of its own for a part that is shrunk across, stretched along
    /// and filled up to 32 × 32.
    #[test]
    fn the_network_sees_what_python_computes() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/resize.json");
        let text = std::fs::read_to_string(file).expect("a fixture");
        let stored: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let numbers = |name: &str| -> Vec<usize> {
            serde_json::from_value(stored[name].clone()).expect("numbers")
        };
        let levels: Vec<f32> = serde_json::from_value(stored["levels"].clone()).expect("levels");
        let [width, height] = numbers("frame")[..] else { panic!("a size") };
        let bytes: Vec<u8> = (0..height * width * 3)
            .map(|i| {
                let (x, y, c) = (i / 3 % width, i / 3 / width, i % 3);
                ((x * x * 3 + y * 29 + c * 71 + x * y * 5) % 251) as u8
            })
            .collect();
        let frame = Frame::new(bytes, width as u32, height as u32, PixelFormat::Rgb8);
        let [x, y, w, h] = numbers("part")[..] else { panic!("a part") };
        let [x, y, w, h] = [x, y, w, h].map(|n| n as u32);
        let part = Rect { x, y, width: w, height: h };
        let frame_size = [frame.width, frame.height];
        let view = View { frame: frame_size, gel: part, part, ..view(0.5) };
        let [across, along] = numbers("resized")[..] else { panic!("a size") };
        let geometry = Geometry { resized: [across, along], size: [32, 32] };
        let input = Input::new(Instant::now(), &frame, view, geometry, false).expect("an input");
        for window in [input.whole(), Window { x: 5, y: 14, width: 27, height: 18 }] {
            let (Value::U32(pixels), Value::U32(crop)) =
                (&input.pixels, &input.part(&window).expect("a crop"))
            else {
                panic!("integers")
            };
            let crop = Crop::from_tensor(crop, pixels.data().len()).expect("a crop");
            let size = [window.height, window.width];
            let seen = crop_resize(pixels, crop, size, [0.0; 3], [1.0 / 255.0; 3]);
            for (i, level) in seen.data().iter().enumerate() {
                let (x, y) = (i % window.width, i / window.width % window.height);
                let c = i / (window.width * window.height);
                let want = levels[(c * 32 + window.y + y) * 32 + window.x + x];
                assert!((level - want).abs() < 0.002, "({x}, {y}, {c}): {level} for {want}");
            }
        }
    }
}
