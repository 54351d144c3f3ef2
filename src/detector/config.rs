//! How to build a detector.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::detector::Savings;
use crate::engine::gpu::{AdapterChoice, Faults, GpuOptions};
use crate::engine::lower::KernelChoice;
use crate::engine::precision::Precision;
use crate::error::{Error, Result};
use crate::sensor::Sensor;
use crate::sensor::frame::Frame;
use crate::sensor::scale::Gel;
use crate::smr::{Catalog, ModelConfig, Wanted, WeightSource};

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

/// How to build a [`GpuDetector`].
///
/// ```
/// use smr_gpu::{Config, Device};
///
/// let config = Config { device: Device::Cpu, score: 0.5, ..Config::new("weights/smrnet.safetensors") };
/// assert_eq!(config.score, 0.5);
/// ```
#[derive(Clone, Debug)]
pub struct Config {
    /// The weights.
    pub weights: WeightSource,
    /// What runs the network.
    pub device: Device,
    /// The sensor that takes the pictures; `None` if nobody knows: see [`Scale`](crate::Scale).
    pub sensor: Option<Sensor>,
    /// Millimetres of gel for a pixel of the frames that come, whatever their size; `None` for what the
    /// sensor says. Which part of a frame is gel is a question of its own.
    pub mm_per_pixel: Option<f32>,
    /// The part of each frame that shows the gel; `None` for what the sensor says.
    pub gel: Option<Gel>,
    /// Refuse frames whose scale would be assumed.
    pub strict_scale: bool,
    /// Longer side of the gel in the network's input, in pixels, a multiple of 32; `None` for the scale that the
    /// weights know.
    pub input_size: Option<usize>,
    /// What is left out where a picture does not need it.
    pub savings: Savings,
    /// A frame of the sensor without contact, with which others are compared where `savings` needs the map of
    /// contact, scaled and cropped as they are; `None` for [`Sensor::reference_frame`]. Without one, or for
    /// frames of another size that are not the sensor's, the frame's own smooth background serves.
    pub reference: Option<Arc<Frame<'static>>>,
    /// A detection's score must be above this; in `[0, 1]`.
    pub score: f32,
    /// The score from which a box counts, where `score` is lower so that others are seen besides: what is in
    /// doubt is so about this ([`Savings::doubt`]). In `[0, 1]`; `None` for `score`.
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
    /// in [`GpuDetector::detect_many`], and with [`Savings::regions`].
    pub batch: usize,
    /// How a GPU stores maps and weights. In [`Precision::F16`] they take half the memory, and results are
    /// less exact; a picture with values past 65504, which is as far as f16 goes, is computed once more in
    /// f32: see [`Detections::precision`]. The CPU and the reference know no f16. In [`Precision::Bf16`] and in
    /// [`Precision::Int8`] cores multiply what is rounded to it, if they have the instructions that it names; all
    /// others know f32 alone.
    pub precision: Precision,
    /// Which kernels run on a GPU; what it does not name is chosen by the adapter's kind.
    pub kernels: KernelChoice,
    /// Folder of the kernels that [`crate::verify::tune`] measured on the adapter; it counts
    /// where `kernels` names nothing.
    pub tuned_kernels: Option<PathBuf>,
    /// Let wgpu check the shaders' bounds (slower; see [`GpuOptions::bounds_checks`]).
    pub bounds_checks: bool,
    /// Time each stage on the device. A GPU then ends a pass after each; without, it runs all of a picture in one,
    /// and [`Detections::stages`] has what the host did alone.
    pub stage_times: bool,
    /// Keep every stage's tensor, for [`crate::verify::stages`]; takes more memory, and nothing
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

    /// The default configuration with the weights that [`Catalog::find`] finds: `large`, `small`, another
    /// name, or a file.
    ///
    /// # Errors
    /// [`Error::NoWeights`].
    pub fn find(weights: impl AsRef<Path>) -> Result<Self> {
        Catalog::from_env().find(weights.as_ref()).map(Self::with_weights)
    }

    /// The default configuration with these weights.
    pub fn with_weights(weights: WeightSource) -> Self {
        Self {
            weights,
            device: Device::default(),
            sensor: None,
            mm_per_pixel: None,
            gel: None,
            strict_scale: false,
            input_size: None,
            savings: Savings::default(),
            reference: None,
            score: 0.5,
            counts_above: None,
            iou: 0.5,
            max_detections: MAX_DETECTIONS,
            classes: Vec::new(),
            timeout: GpuOptions::default().timeout,
            rebuild_on_loss: true,
            in_flight: 2,
            batch: 2,
            precision: Precision::F32,
            kernels: KernelChoice::default(),
            tuned_kernels: None,
            bounds_checks: false,
            stage_times: true,
            keep_stages: false,
            faults: None,
        }
    }

    /// The score that a box must pass to count.
    fn asked(&self) -> f32 {
        self.counts_above.unwrap_or(self.score)
    }

    /// Whether a box of this score leaves doubt where less than all was computed.
    pub(super) fn is_doubtful(&self, score: f32) -> bool {
        self.savings.is_doubtful(score, self.asked())
    }

    pub(super) fn wanted(&self, model: &ModelConfig) -> Result<Wanted> {
        if let Some(size) = self.input_size.filter(|size| !ModelConfig::is_input_size(*size)) {
            return Err(Error::param("detect", "input_size", ModelConfig::INPUT_SIZES, size));
        }
        let scores = [("score", self.score), ("counts_above", self.asked()), ("iou", self.iou)];
        for (name, value) in scores {
            // A NaN is in no range.
            if !(0.0..=1.0).contains(&value) {
                return Err(Error::param("detect", name, "a number from 0 to 1", value));
            }
        }
        self.savings.check()?;
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
            score: self.savings.least_score(self.asked()).min(self.score),
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
        let alone = Config { score: 0.5, ..Config::new("weights") };
        assert!(alone.is_doubtful(0.3) && !alone.is_doubtful(0.1));
        assert_eq!(alone.wanted(&model).expect("a range").score, alone.savings.least_score(0.5));
        let besides = Config { score: 0.05, counts_above: Some(0.5), ..Config::new("weights") };
        assert!(besides.is_doubtful(0.3) && !besides.is_doubtful(0.04));
        assert_eq!(besides.wanted(&model).expect("a range").score, 0.05);
        let error =
            Config { counts_above: Some(f32::NAN), ..alone }.wanted(&model).expect_err("a range");
        assert!(error.to_string().contains("counts_above"), "{error}");
    }
}
