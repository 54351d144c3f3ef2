//! How to build a detector.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::detector::Scene;
use crate::engine::gpu::{AdapterChoice, Faults, GpuOptions};
use crate::engine::lower::Choice;
use crate::engine::precision::Precision;
use crate::error::{Error, Result};
use crate::sensor::Sensor;
use crate::sensor::frame::Frame;
use crate::sensor::scale::Gel;
use crate::smr::{ModelConfig, Wanted};

#[cfg(doc)]
use crate::detector::{Detections, GpuDetector};

/// Most detections a picture may have.
const MAX_DETECTIONS: usize = Wanted::ALL.max_detections;

/// What runs the network.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum Device {
    /// A hardware adapter if there is one that gives what the kernels need, else this machine's CPU; without
    /// the feature `cpu` a software adapter, of which [`GpuDetector::remarks`] tells. Drivers are loaded into
    /// this process, so one that crashes while it loads takes the program with it.
    #[default]
    Auto,
    /// A GPU, or a software adapter that acts as one.
    Gpu(AdapterChoice),
    /// This machine's CPU, in f32. Needs the feature `cpu`.
    Cpu,
    /// The f64 reference, to which the others are held; slow.
    Reference,
}

impl std::str::FromStr for Device {
    type Err = Error;

    /// `auto`, `gpu`, `cpu`, `reference`, in any case, an adapter's index, or part of its name. A number is
    /// an index.
    ///
    /// # Errors
    /// [`Error::Param`] for a blank, which is part of every name, and a number that is no index.
    fn from_str(text: &str) -> Result<Self> {
        let word = text.trim();
        let digits = word.strip_prefix(['-', '+']).unwrap_or(word);
        let is_number = digits.bytes().all(|b| b.is_ascii_digit());
        Ok(match word.to_lowercase().as_str() {
            "auto" => Self::Auto,
            "gpu" => Self::Gpu(AdapterChoice::Auto),
            "cpu" => Self::Cpu,
            "reference" => Self::Reference,
            _ => Self::Gpu(match word.parse() {
                Ok(index) => AdapterChoice::Index(index),
                Err(_) if !is_number => AdapterChoice::Name(word.into()),
                // A blank, too, is all digits.
                Err(_) => {
                    let expected =
                        "`auto`, `gpu`, `cpu`, `reference`, an adapter's index or part of its name";
                    return Err(Error::param("detect", "device", expected, format!("`{text}`")));
                }
            }),
        })
    }
}

impl std::fmt::Display for Device {
    /// As `--device` takes it.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Gpu(AdapterChoice::Auto | AdapterChoice::Hardware) => f.write_str("gpu"),
            Self::Gpu(AdapterChoice::Index(index)) => index.fmt(f),
            Self::Gpu(AdapterChoice::Name(name)) => f.write_str(name),
            Self::Cpu => f.write_str("cpu"),
            Self::Reference => f.write_str("reference"),
        }
    }
}

/// Where the weights are.
#[derive(Clone)]
pub enum WeightSource {
    /// A safetensors file.
    File(PathBuf),
    /// A safetensors file's bytes, with a name for messages.
    Bytes(PathBuf, Arc<[u8]>),
}

impl fmt::Debug for WeightSource {
    /// A line, without the bytes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "File({path:?})"),
            Self::Bytes(name, bytes) => write!(f, "Bytes({name:?}, {} bytes)", bytes.len()),
        }
    }
}

/// How to build a [`GpuDetector`].
///
/// ```
/// use smr_gpu::{Config, Device};
///
/// let config = Config::new("weights/smrnet.safetensors").device(Device::Cpu).score(0.5);
/// assert_eq!(config.score, 0.5);
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Config {
    /// The weights.
    pub weights: WeightSource,
    /// What runs the network.
    pub device: Device,
    /// The sensor that takes the pictures; `None` if nobody knows: see [`crate::sensor::scale`].
    pub sensor: Option<Sensor>,
    /// Millimetres of gel for a pixel of the frames that come, whatever their size; `None` for what the
    /// sensor says. Which part of a frame is gel is a question of its own.
    pub mm_per_pixel: Option<f32>,
    /// The part of each frame that shows the gel; `None` for what the sensor says.
    pub gel: Option<Gel>,
    /// Refuse frames whose scale would be assumed.
    pub strict_scale: bool,
    /// Longer side of the gel in the network's input, in pixels; `None` for the scale that the weights
    /// know. The input has as many as the next multiple of 32.
    pub input_size: Option<usize>,
    /// What is left out where a picture does not need it.
    pub scene: Scene,
    /// A frame of the sensor without contact, with which others are compared where `scene` looks for
    /// contact, scaled and cropped as they are; `None` for [`Sensor::reference_frame`]. Without one, or for
    /// frames of another size that are not the sensor's, the frame's own smooth background serves.
    pub reference: Option<Arc<Frame<'static>>>,
    /// A detection's score must be above this; in `[0, 1]`.
    pub score: f32,
    /// The score from which a box counts, where `score` is lower so that others are seen besides: what is in
    /// doubt is so about this ([`Scene::doubt`]). In `[0, 1]`; `None` for `score`.
    pub counts_above: Option<f32>,
    /// Of two detections of a class whose intersection over union is above this, the lower goes; in
    /// `[0, 1]`.
    pub iou: f32,
    /// At most so many detections a picture; 1 to 100.
    pub max_detections: usize,
    /// Names of the wanted classes; empty for all.
    pub classes: Vec<String>,
    /// Longest wait for one picture, from the call on, on a GPU or, between its kernels, on the CPU; without the time that it takes to make ready for
    /// a size that no picture had lately. Of pictures that [`GpuDetector::detect_many`] begins ahead, each run
    /// has it for itself.
    pub timeout: Duration,
    /// Build everything anew when the device was lost, once a call, so that the next picture is found
    /// like any other.
    pub rebuild_on_loss: bool,
    /// Runs that may be in flight on a GPU at a time, or be computed by the CPU; each takes memory once it is
    /// needed. Fewer callers than cores share all cores, one waiting for the other's sections; as many as there
    /// are cores compute on one each.
    pub in_flight: usize,
    /// Pictures, or parts of pictures, of one size that a run on a GPU takes together where there are as many:
    /// in [`GpuDetector::detect_many`], and with [`Scene::regions`].
    pub batch: usize,
    /// How a GPU stores maps and weights. In [`Precision::F16`] they take half the memory, and results are
    /// less exact; a picture with values past 65504, which is as far as f16 goes, is looked at once more in
    /// f32: see [`Detections::precision`]. The CPU and the reference know no f16.
    pub precision: Precision,
    /// Which kernels run on a GPU; what it does not name is chosen by the adapter's kind.
    pub choice: Choice,
    /// Folder in which to look for the choice that [`crate::verify::tune`] measured on the adapter; it counts
    /// where `choice` names nothing.
    pub choices: Option<PathBuf>,
    /// Let wgpu check the shaders' bounds (slower; see [`GpuOptions::checked`]).
    pub checked: bool,
    /// Keep every stage's tensor, for [`GpuDetector::detect_with_stages`]; takes more memory, and nothing
    /// of a picture is left out.
    pub keep_stages: bool,
    /// For tests: calls to the device that fail.
    #[doc(hidden)]
    pub faults: Option<Faults>,
}

impl Config {
    /// The default configuration with the weights in `file`.
    pub fn new(file: impl AsRef<Path>) -> Self {
        Self::with_weights(WeightSource::File(file.as_ref().into()))
    }

    /// The default configuration with a weight file's bytes; `name` stands for the file in messages.
    pub fn from_bytes(name: impl AsRef<Path>, bytes: impl Into<Arc<[u8]>>) -> Self {
        Self::with_weights(WeightSource::Bytes(name.as_ref().into(), bytes.into()))
    }

    fn with_weights(weights: WeightSource) -> Self {
        Self {
            weights,
            device: Device::default(),
            sensor: None,
            mm_per_pixel: None,
            gel: None,
            strict_scale: false,
            input_size: None,
            scene: Scene::default(),
            reference: None,
            score: 0.05,
            counts_above: None,
            iou: 0.5,
            max_detections: MAX_DETECTIONS,
            classes: Vec::new(),
            timeout: GpuOptions::default().timeout,
            rebuild_on_loss: true,
            in_flight: 2,
            batch: 2,
            precision: Precision::F32,
            choice: Choice::default(),
            choices: None,
            checked: false,
            keep_stages: false,
            faults: None,
        }
    }

    /// Sets [`Config::device`].
    pub fn device(mut self, device: Device) -> Self {
        self.device = device;
        self
    }

    /// Sets [`Config::sensor`].
    pub fn sensor(mut self, sensor: Sensor) -> Self {
        self.sensor = Some(sensor);
        self
    }

    /// Sets [`Config::mm_per_pixel`].
    pub fn mm_per_pixel(mut self, millimetres: f32) -> Self {
        self.mm_per_pixel = Some(millimetres);
        self
    }

    /// Sets [`Config::gel`].
    pub fn gel(mut self, part: Gel) -> Self {
        self.gel = Some(part);
        self
    }

    /// Sets [`Config::strict_scale`].
    pub fn strict_scale(mut self, strict: bool) -> Self {
        self.strict_scale = strict;
        self
    }

    /// Sets [`Config::input_size`].
    pub fn input_size(mut self, pixels: usize) -> Self {
        self.input_size = Some(pixels);
        self
    }

    /// Sets [`Config::scene`].
    pub fn scene(mut self, scene: Scene) -> Self {
        self.scene = scene;
        self
    }

    /// Sets [`Config::reference`].
    pub fn reference(mut self, frame: Frame<'static>) -> Self {
        self.reference = Some(Arc::new(frame));
        self
    }

    /// Sets [`Config::score`].
    pub fn score(mut self, above: f32) -> Self {
        self.score = above;
        self
    }

    /// Sets [`Config::counts_above`].
    pub fn counts_above(mut self, score: f32) -> Self {
        self.counts_above = Some(score);
        self
    }

    /// Sets [`Config::iou`].
    pub fn iou(mut self, most: f32) -> Self {
        self.iou = most;
        self
    }

    /// Sets [`Config::max_detections`].
    pub fn max_detections(mut self, most: usize) -> Self {
        self.max_detections = most;
        self
    }

    /// Sets [`Config::classes`].
    pub fn classes(mut self, names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.classes = names.into_iter().map(Into::into).collect();
        self
    }

    /// Sets [`Config::timeout`].
    pub fn timeout(mut self, longest: Duration) -> Self {
        self.timeout = longest;
        self
    }

    /// Sets [`Config::rebuild_on_loss`].
    pub fn rebuild_on_loss(mut self, rebuild: bool) -> Self {
        self.rebuild_on_loss = rebuild;
        self
    }

    /// Sets [`Config::in_flight`].
    pub fn in_flight(mut self, runs: usize) -> Self {
        self.in_flight = runs;
        self
    }

    /// Sets [`Config::batch`].
    pub fn batch(mut self, pictures: usize) -> Self {
        self.batch = pictures;
        self
    }

    /// Sets [`Config::precision`].
    pub fn precision(mut self, precision: Precision) -> Self {
        self.precision = precision;
        self
    }

    /// Sets [`Config::choice`].
    pub fn choice(mut self, choice: Choice) -> Self {
        self.choice = choice;
        self
    }

    /// Sets [`Config::choices`].
    pub fn choices(mut self, folder: impl Into<PathBuf>) -> Self {
        self.choices = Some(folder.into());
        self
    }

    /// Sets [`Config::checked`].
    pub fn checked(mut self, checked: bool) -> Self {
        self.checked = checked;
        self
    }

    /// Sets [`Config::keep_stages`].
    pub fn keep_stages(mut self, keep: bool) -> Self {
        self.keep_stages = keep;
        self
    }

    /// The score that a box must pass to count.
    fn asked(&self) -> f32 {
        self.counts_above.unwrap_or(self.score)
    }

    /// Whether a box of this score leaves doubt where less than all was looked at.
    pub(super) fn is_doubtful(&self, score: f32) -> bool {
        self.scene.is_doubtful(score, self.asked())
    }

    pub(super) fn wanted(&self, model: &ModelConfig) -> Result<Wanted> {
        let scores = [("score", self.score), ("counts_above", self.asked()), ("iou", self.iou)];
        for (name, value) in scores {
            // A NaN is in no range.
            if !(0.0..=1.0).contains(&value) {
                return Err(Error::param("detect", name, "a number from 0 to 1", value));
            }
        }
        self.scene.check()?;
        if !(1..=MAX_DETECTIONS).contains(&self.max_detections) {
            let got = self.max_detections;
            return Err(Error::param("detect", "max_detections", "1 to 100", got));
        }
        let mut class_mask = 0;
        for name in &self.classes {
            let index = model.classes.iter().position(|c| c.eq_ignore_ascii_case(name));
            let index = index.ok_or_else(|| {
                Error::param("detect", "classes", model.classes.join(", "), format!("`{name}`"))
            })?;
            class_mask |= 2u32 << index;
        }
        if self.classes.is_empty() {
            class_mask = u32::MAX;
        }
        Ok(Wanted {
            score: self.scene.least_score(self.asked()).min(self.score),
            iou: self.iou,
            max_detections: self.max_detections,
            class_mask,
            ..Wanted::ALL
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boxes down to a score that does not count are seen, and those about the one that does are doubtful.
    #[test]
    fn doubt_is_about_the_score_that_counts() {
        let model = ModelConfig::large();
        let alone = Config::new("weights").score(0.5);
        assert!(alone.is_doubtful(0.3) && !alone.is_doubtful(0.1));
        assert_eq!(alone.wanted(&model).expect("a range").score, alone.scene.least_score(0.5));
        let besides = Config::new("weights").score(0.05).counts_above(0.5);
        assert!(besides.is_doubtful(0.3) && !besides.is_doubtful(0.04));
        assert_eq!(besides.wanted(&model).expect("a range").score, 0.05);
        let error = alone.counts_above(f32::NAN).wanted(&model).expect_err("a range");
        assert!(error.to_string().contains("counts_above"), "{error}");
    }
}
