//! [`GpuDetector`]: a picture in, snaps out.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use image::DynamicImage;

use crate::comparison::{self, ChoiceComparison, Shift, StageComparison, Values};
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu, GpuOptions, ProgramOptions, Slot};
use crate::graph::{StageTime, TensorId};
use crate::host::HostPlan;
use crate::model::{ModelConfig, Network, Thresholds, Weights};
use crate::ops::Crop;
use crate::tensor::{Tensor, Value};

/// Most detections a picture may have.
const MAX_DETECTIONS: usize = 100;

/// What runs the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Device {
    /// A GPU, or a software adapter that acts as one.
    Gpu(AdapterChoice),
    /// This machine's CPU, in f32.
    Cpu,
    /// The f64 reference, to which the others are held; slow.
    Reference,
}

impl Default for Device {
    fn default() -> Self {
        Self::Gpu(AdapterChoice::Auto)
    }
}

impl std::str::FromStr for Device {
    type Err = Error;

    /// `auto`, `cpu`, `reference`, an adapter's index, or part of its name.
    ///
    /// # Errors
    /// [`Error::Param`] for a blank, which is part of every name.
    fn from_str(text: &str) -> Result<Self> {
        Ok(match text.trim() {
            "" => {
                let expected = "`auto`, `cpu`, `reference`, an adapter's index or part of its name";
                return Err(Error::param("detect", "device", expected, format!("`{text}`")));
            }
            "auto" => Self::default(),
            "cpu" => Self::Cpu,
            "reference" => Self::Reference,
            other => Self::Gpu(match other.parse() {
                Ok(index) => AdapterChoice::Index(index),
                Err(_) => AdapterChoice::Name(other.into()),
            }),
        })
    }
}

/// Where the weights are.
#[derive(Clone, Debug)]
pub enum WeightSource {
    /// A safetensors file.
    File(PathBuf),
    /// A safetensors file's bytes, with a name for messages.
    Bytes(PathBuf, Arc<[u8]>),
}

/// How to build a [`GpuDetector`].
#[derive(Clone, Debug)]
pub struct Config {
    /// The weights.
    pub weights: WeightSource,
    /// What runs the network.
    pub device: Device,
    /// Side of the network's input in pixels, a multiple of 32; `None` for the weight file's.
    pub input_size: Option<usize>,
    /// A detection's score must be above this; in `[0, 1]`.
    pub score: f32,
    /// Of two detections of a class whose intersection over union is above this, the lower goes; in
    /// `[0, 1]`.
    pub iou: f32,
    /// At most so many detections a picture; 1 to 100.
    pub max_detections: usize,
    /// Names of the wanted classes; empty for all.
    pub classes: Vec<String>,
    /// Longest wait for one picture on a GPU.
    pub timeout: Duration,
    /// Let wgpu check the shaders' bounds (slower; see [`GpuOptions::checked`]).
    pub checked: bool,
    /// Keep every stage's tensor, for [`GpuDetector::detect_with_stages`]; takes more memory.
    pub keep_stages: bool,
}

impl Config {
    /// The default configuration with the weights in `file`.
    pub fn new(file: impl AsRef<Path>) -> Self {
        Self {
            weights: WeightSource::File(file.as_ref().into()),
            device: Device::default(),
            input_size: None,
            score: 0.05,
            iou: 0.5,
            max_detections: MAX_DETECTIONS,
            classes: Vec::new(),
            timeout: GpuOptions::default().timeout,
            checked: false,
            keep_stages: false,
        }
    }

    fn thresholds(&self, model: &ModelConfig) -> Result<Thresholds> {
        for (name, value) in [("score", self.score), ("iou", self.iou)] {
            // A NaN is in no range.
            if !(0.0..=1.0).contains(&value) {
                return Err(Error::param("detect", name, "a number from 0 to 1", value));
            }
        }
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
        Ok(Thresholds {
            score: self.score,
            iou: self.iou,
            max_detections: self.max_detections,
            class_mask,
        })
    }
}

/// One snap in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Class name.
    pub class: String,
    /// Confidence from 0 to 1.
    pub score: f32,
    /// Corners (x1, y1, x2, y2) in pixels of the picture; pixel i covers `[i, i + 1]`.
    pub bbox: [f32; 4],
    /// Centre of the box on the gel in millimetres, from the picture's centre: x right, y down.
    pub center_mm: [f32; 2],
}

/// What a picture holds, and what finding it took.
#[derive(Clone, Debug)]
pub struct Detections {
    /// The snaps, best first.
    pub detections: Vec<Detection>,
    /// Width of the picture in pixels.
    pub width: u32,
    /// Height of the picture in pixels.
    pub height: u32,
    /// How many proposals the last stage looked at.
    pub proposals: u32,
    /// Time by stage on the device; empty where it has no timestamps.
    pub stages: Vec<StageTime>,
    /// Time from picture to detections.
    pub wall: Duration,
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

    /// The largest bias of a tensor as a share of its bound.
    pub fn bias(&self) -> f64 {
        self.stages.iter().filter_map(StageComparison::bias).fold(0.0, f64::max)
    }

    /// The largest drift of a stage.
    pub fn drift(&self) -> f64 {
        self.stages.iter().filter_map(StageComparison::drift).fold(0.0, f64::max)
    }
}

/// Tensors of every stage, by the PyTorch reference's names.
pub type Stages = Vec<(String, Value)>;

/// Finds snap joints in pictures. Build it once; it holds the device, the compiled shaders, the
/// weights and all buffers. Pictures given from several threads take turns.
#[derive(Debug)]
pub struct GpuDetector {
    config: Config,
    model: ModelConfig,
    adapter: String,
    engine: Mutex<Engine>,
}

#[derive(Debug)]
struct Engine {
    network: Network,
    runner: Runner,
}

#[derive(Debug)]
enum Runner {
    Gpu(Box<Slot>),
    Host(Box<HostPlan>),
    Reference,
}

impl GpuDetector {
    /// Loads the weights, opens the device, compiles the shaders and allocates the buffers.
    ///
    /// # Errors
    /// [`Error::Weights`], [`Error::NoAdapter`], [`Error::Device`], [`Error::Shader`], or
    /// [`Error::Param`] for a threshold out of its range or an unknown class.
    pub fn new(config: Config) -> Result<Self> {
        pollster::block_on(Self::new_async(config))
    }

    /// [`GpuDetector::new`] for callers with an executor of their own.
    ///
    /// # Errors
    /// As [`GpuDetector::new`].
    pub async fn new_async(config: Config) -> Result<Self> {
        Self::build(config, None).await
    }

    /// [`GpuDetector::new_async`] on a device that is open already; `device`, `timeout` and
    /// `checked` of the configuration do not count.
    ///
    /// # Errors
    /// As [`GpuDetector::new`].
    pub async fn on_device(gpu: Arc<Gpu>, mut config: Config) -> Result<Self> {
        config.device = Device::default();
        Self::build(config, Some(gpu)).await
    }

    async fn build(config: Config, gpu: Option<Arc<Gpu>>) -> Result<Self> {
        let weights = match &config.weights {
            WeightSource::File(path) => Weights::open(path)?,
            WeightSource::Bytes(name, bytes) => Weights::from_bytes(name, bytes)?,
        };
        let weights = match config.input_size {
            Some(size) => weights.with_input_size(size)?,
            None => weights,
        };
        let model = weights.config().clone();
        let thresholds = config.thresholds(&model)?;
        let network = Network::new(weights, thresholds)?;
        let (runner, adapter) = match &config.device {
            Device::Reference => (Runner::Reference, "CPU reference (f64)".to_owned()),
            Device::Cpu => {
                let plan = host_plan(&network, &config)?;
                (Runner::Host(plan), "CPU (f32)".to_owned())
            }
            Device::Gpu(choice) => {
                let options = GpuOptions {
                    adapter: choice.clone(),
                    timeout: config.timeout,
                    checked: config.checked,
                };
                let gpu = match gpu {
                    Some(gpu) => gpu,
                    None => Gpu::open(options).await?,
                };
                let adapter = format!("{} ({})", gpu.info().name, gpu.info().backend);
                (Runner::Gpu(Box::new(slot(&gpu, &network, &config).await?)), adapter)
            }
        };
        let engine = Mutex::new(Engine { network, runner });
        Ok(Self { config, model, adapter, engine })
    }

    /// The network's configuration.
    pub fn model(&self) -> &ModelConfig {
        &self.model
    }

    /// Name of the adapter that runs the network.
    pub fn adapter(&self) -> &str {
        &self.adapter
    }

    /// Finds the snaps in a picture of any size and pixel format. The network sees the largest
    /// centred square.
    ///
    /// # Errors
    /// [`Error::Picture`] for an empty picture, [`Error::Capacity`] for one past the device's
    /// largest binding, [`Error::DeviceLost`], [`Error::Timeout`] or [`Error::Driver`] from the
    /// device, [`Error::NotFinite`] if the network overflowed.
    pub fn detect(&self, picture: &DynamicImage) -> Result<Detections> {
        let frame = Frame::new(picture)?;
        let mut engine = self.engine.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(self.look(&mut engine, &frame)?.1)
    }

    /// [`GpuDetector::detect`], with the tensor of every stage, cut to the rows that a count made
    /// valid. Needs `Config::keep_stages`.
    ///
    /// # Errors
    /// As [`GpuDetector::detect`]; [`Error::Param`] without `keep_stages`.
    pub fn detect_with_stages(&self, picture: &DynamicImage) -> Result<(Detections, Stages)> {
        self.check_keeps_stages()?;
        let frame = Frame::new(picture)?;
        let mut engine = self.engine.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut values, detections) = self.look(&mut engine, &frame)?;
        let graph = &engine.network.graph;
        let named = |id: TensorId| Some((graph.name(id).to_owned(), values.remove(&id)?));
        Ok((detections, graph.computed().into_iter().filter_map(named).collect()))
    }

    /// Looks at a picture on the device and with the f64 reference, and compares every operation and
    /// what comes out: see [`crate::comparison`]. Needs `Config::keep_stages`.
    ///
    /// # Errors
    /// As [`GpuDetector::detect`]; [`Error::Param`] without `keep_stages` or a GPU.
    pub fn compare(&self, picture: &DynamicImage) -> Result<Comparison> {
        if !matches!(self.config.device, Device::Gpu(_)) {
            return Err(Error::param("compare", "device", "a GPU", "the CPU"));
        }
        self.check_keeps_stages()?;
        let frame = Frame::new(picture)?;
        let mut engine = self.engine.lock().unwrap_or_else(PoisonError::into_inner);
        let (got, times) = self.run(&mut engine, &frame)?;
        let network = &engine.network;
        let found = frame.detections(network, &got, times)?;
        let frame = Frame { start: Instant::now(), ..frame };
        let inputs = frame.inputs(network);
        let (want, times) = network.graph.reference(&inputs, &network.graph.computed())?;
        let expected = frame.detections(network, &want, times)?;
        let scale = f64::from(frame.scale(network));
        let outcome = comparison::compare(network, &inputs, &got, &want, scale)?;
        let time = |stage: &str| found.stages.iter().find(|t| t.stage == stage).map(|t| t.time);
        let stages = expected.stages.iter().zip(outcome.stages);
        let stages = stages.map(|(reference, tensors)| StageComparison {
            stage: reference.stage.clone(),
            time: time(&reference.stage),
            reference_time: reference.time,
            tensors,
        });
        let mm_per_pixel = f64::from(network.config.mm_per_pixel_of(frame.crop.side as u32));
        Ok(Comparison {
            stages: stages.collect(),
            proposals: outcome.proposals,
            detections: outcome.detections,
            shift: outcome.shift,
            shift_mm: outcome.shift.pixels * mm_per_pixel,
            found,
            expected,
        })
    }

    fn check_keeps_stages(&self) -> Result<()> {
        match self.config.keep_stages {
            true => Ok(()),
            false => Err(Error::param("detect", "keep_stages", true, false)),
        }
    }

    /// Looks at a picture. The values are the outputs, or with `keep_stages` those of every stage, cut
    /// to their valid rows.
    fn look(&self, engine: &mut Engine, frame: &Frame) -> Result<(Values, Detections)> {
        let (mut values, times) = self.run(engine, frame)?;
        let network = &engine.network;
        if self.config.keep_stages {
            network.graph.truncate(&frame.inputs(network), &mut values);
        }
        let detections = frame.detections(network, &values, times)?;
        Ok((values, detections))
    }

    /// Runs the network. The values are the outputs, or with `keep_stages` those of every stage, as
    /// they came.
    fn run(&self, engine: &mut Engine, frame: &Frame) -> Result<(Values, Vec<StageTime>)> {
        let Engine { network, runner } = engine;
        let inputs = frame.inputs(network);
        match runner {
            Runner::Reference => network.graph.reference(&inputs, &kept(network, &self.config)),
            Runner::Host(plan) => plan.run(&network.graph, &inputs),
            Runner::Gpu(slot) => {
                let mut run = slot.run(&inputs)?;
                Ok((run.first(), run.stages))
            }
        }
    }
}

async fn slot(gpu: &Arc<Gpu>, network: &Network, config: &Config) -> Result<Slot> {
    Slot::of(gpu, &network.graph, &kept(network, config), ProgramOptions::default()).await
}

fn host_plan(network: &Network, config: &Config) -> Result<Box<HostPlan>> {
    Ok(Box::new(HostPlan::new(&network.graph, &kept(network, config))?))
}

/// The tensors that a run gives back beside the outputs.
fn kept(network: &Network, config: &Config) -> Vec<TensorId> {
    if config.keep_stages { network.graph.computed() } else { Vec::new() }
}

/// A picture as the network takes it, and where its square lies.
struct Frame {
    start: Instant,
    width: u32,
    height: u32,
    crop: Crop,
    pixels: Value,
    square: Value,
}

impl Frame {
    /// # Errors
    /// [`Error::Picture`] for an empty picture.
    fn new(picture: &DynamicImage) -> Result<Self> {
        let start = Instant::now();
        let (width, height) = (picture.width(), picture.height());
        if width == 0 || height == 0 {
            let message = format!("expected at least 1 × 1 pixel, got {width} × {height}");
            return Err(Error::Picture { file: "picture".into(), message });
        }
        let rgba = picture.to_rgba8();
        let pixels: Vec<u32> = bytemuck::pod_collect_to_vec(rgba.as_raw());
        let crop = Crop::central(width as usize, height as usize);
        let square = crop.to_tensor(pixels.len())?.into();
        let pixels = Tensor::new([pixels.len()], pixels)?.into();
        Ok(Self { start, width, height, crop, pixels, square })
    }

    fn inputs(&self, network: &Network) -> [(TensorId, &Value); 2] {
        [(network.picture, &self.pixels), (network.crop, &self.square)]
    }

    /// Pixels of the picture for one of the network's input.
    fn scale(&self, network: &Network) -> f32 {
        self.crop.side as f32 / network.config.input_size as f32
    }

    /// What the network's outputs say of the picture.
    fn detections(
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
        let origin = [self.crop.x as f32, self.crop.y as f32];
        let middle = [self.width as f32 / 2.0, self.height as f32 / 2.0];
        let mm_per_pixel = config.mm_per_pixel_of(self.crop.side as u32);
        let rows = boxes.data().chunks_exact(4).zip(scores.data()).zip(classes.data());
        rows.take(count)
            .map(|((b, score), class)| {
                let bbox = std::array::from_fn(|i| b[i] * scale + origin[i % 2]);
                let center = |i: usize| (bbox[i] + bbox[i + 2]) / 2.0 - middle[i];
                let name = config.classes.get((*class as usize).wrapping_sub(1));
                let name = name.ok_or_else(|| {
                    Error::tensor("detect", "detections.labels", "a class of the weights", class)
                })?;
                Ok(Detection {
                    class: name.clone(),
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

/// Looks for values that are not finite in what each head gave: NaN stays NaN from where it arises
/// to these, while comparisons behind them would only drop it.
fn check_finite(network: &Network, values: &Values) -> Result<()> {
    let proposals = count_of(network, values, network.proposal_count)? as usize;
    for witness in &network.witnesses {
        let tensor = value(network, values, witness.tensor)?.f32()?;
        let live = match witness.by_proposal {
            true => proposals * tensor.dims().iter().skip(1).product::<usize>(),
            false => tensor.data().len(),
        };
        let count = tensor.data().iter().take(live).filter(|v| !v.is_finite()).count() as u64;
        if count > 0 {
            let stage = network.graph.name(witness.tensor).into();
            return Err(Error::NotFinite { stage, count });
        }
    }
    Ok(())
}
