//! [`GpuDetector`]: a picture in, snaps out.
//!
//! | file | what it holds |
//! |---|---|
//! | `config` | how to build a detector |
//! | `detection` | what it finds |
//! | `view` | what a frame shows: its gel, its scale, what of it the network sees |
//! | `input` | from a frame to what the network takes, and back |
//! | `look` | the network over pictures or their parts, those of a size together |
//! | `many` | many pictures, in order |
//! | `scene` | what may be left out of a picture |
//! | `contact` | where something touches the gel |
//! | `regions` | the parts of a picture that the network looks at |
//! | `stream` | frames of which few change |
//! | `engines`, `engine` | the network, for each size of input |
//! | `runner` | what runs a graph: a GPU, the CPU, the reference |
//! | `pool` | the memory of runs: as many in flight as there are arenas |

mod config;
mod contact;
mod detection;
mod engine;
mod engines;
mod input;
mod look;
mod many;
mod pool;
mod regions;
mod runner;
mod scene;
mod stream;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use crate::engine::gpu::{Deadline, Gpu};
use crate::engine::graph::{StageTime, TensorId};
use crate::engine::lock::lock;
use crate::engine::lower::Choice;
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};
use crate::sensor::frame::Frame;
use crate::sensor::pixel_format::PixelFormat;
use crate::sensor::scale::Scale;
use crate::smr::ModelConfig;
use crate::verify::comparison::{self, StageComparison, Values};
use crate::verify::profile::{self, CommandTime};
use crate::verify::tune::{self, Tuned};

use crate::sensor::view::{self, Known, View};
pub use config::{Config, Device, WeightSource};
pub use detection::{Comparison, Detection, Detections};
use engine::Engine;
use engines::{Engines, Kind};
use input::{Geometry, Input};
use look::Sight;
pub use scene::Scene;
pub use stream::{MOST_REUSED, Stream};

/// Tensors of every stage, by the PyTorch reference's names.
pub type Stages = Vec<(String, Value)>;

/// Finds snap joints in pictures. Build it once; it holds the device, the compiled shaders, the
/// weights and all buffers. Pictures given from several threads are in flight together, as many as
/// [`Config::in_flight`] says.
pub struct GpuDetector {
    config: Config,
    model: ModelConfig,
    /// Replaced when the device was lost.
    engines: RwLock<Arc<Engines>>,
    /// The frame without contact as the last view shows it.
    reference: Mutex<Option<(View, Arc<Value>)>>,
    /// Held while the engines are rebuilt.
    rebuilding: Mutex<()>,
    /// Whether the device is the caller's, who alone can replace it.
    foreign: bool,
}

impl fmt::Debug for GpuDetector {
    /// A line: what runs which network.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (classes, adapter) = (self.model.classes.join(", "), self.adapter());
        let sensor = self.config.sensor.as_ref().map_or("none named", |sensor| &sensor.name);
        write!(f, "GpuDetector(classes {classes}, sensor {sensor}, on {adapter})")
    }
}

impl GpuDetector {
    /// Loads the weights, opens the device, compiles the shaders and allocates the buffers, as far as
    /// the pictures' size is known: with a sensor that takes frames of any size the first picture of
    /// each size does the rest.
    ///
    /// # Errors
    /// [`Error::Weights`], [`Error::NoAdapter`], [`Error::Device`], [`Error::Shader`],
    /// [`Error::Sensor`], [`Error::Picture`] for a sensor whose frames show more gel than the weights' input
    /// holds, or [`Error::Param`] for a threshold out of its range or an unknown class.
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

    /// [`GpuDetector::new_async`] on a device that is open already; `device` and `checked` of the
    /// configuration do not count, and a lost device is not replaced.
    ///
    /// # Errors
    /// As [`GpuDetector::new`].
    pub async fn on_device(gpu: Arc<Gpu>, config: Config) -> Result<Self> {
        Self::build(config, Some(gpu)).await
    }

    async fn build(mut config: Config, gpu: Option<Arc<Gpu>>) -> Result<Self> {
        let foreign = gpu.is_some();
        if config.keep_stages {
            config.scene = Scene::FULL;
        }
        if let Some(sensor) = &config.sensor {
            sensor.check()?;
            config.reference = config.reference.or_else(|| sensor.reference_frame.clone());
            if let (Some(file), None) = (&sensor.reference, &config.reference) {
                let message = format!(
                    "reference: expected its frame, from `Sensor::open` or `Config::reference`; got its \
                     name alone, {}",
                    file.display()
                );
                return Err(Error::Sensor { sensor: sensor.name.clone(), message });
            }
        }
        if let Some(reference) = &config.reference {
            reference.check()?;
        }
        if let Some(mm) = config.mm_per_pixel {
            Scale::stated(mm).check()?;
        }
        let engines = Engines::open(&config, gpu).await?;
        let model = engines.model().clone();
        let (engines, rebuilding) = (RwLock::new(Arc::new(engines)), Mutex::new(()));
        let reference = Mutex::default();
        let detector = Self { config, model, engines, reference, rebuilding, foreign };
        match detector.usual_frame() {
            Some(frame) => detector.prepare(frame)?,
            None => detector.engines().check()?,
        }
        Ok(detector)
    }

    /// Width and height of frames, if they are known before any comes.
    fn usual_frame(&self) -> Option<[u32; 2]> {
        match (&self.config.sensor, self.config.mm_per_pixel) {
            (Some(sensor), None) => sensor.frame,
            (None, None) if !self.config.strict_scale => Some([1000, 1000]),
            // How much gel they show depends on their size.
            _ => None,
        }
    }

    /// Builds what frames of this width and height need.
    fn prepare(&self, frame: [u32; 2]) -> Result<()> {
        let view = view::view(frame, self.known())?;
        let geometry = Geometry::new(&view, &self.model, self.config.input_size)?;
        let engines = self.engines();
        let (scene, size) = (&self.config.scene, geometry.size);
        // All of the network first: what leaves some of it out then shares its weights.
        let all = engines.whole(size, engines.precision());
        engines.engine(all)?;
        let proposals = scene.proposals(size, false);
        engines.engine(Kind { proposals, deepest: !scene.scales, ..all })?;
        if scene.looks() {
            let reference = self.reference(&view)?.is_some();
            let cells = contact::cells(&view);
            engines.contact(contact::Kind { cells, reference, stream: false })?;
        }
        Ok(())
    }

    /// What is known of frames before they come.
    fn known(&self) -> Known<'_> {
        let Config { sensor, mm_per_pixel, gel, strict_scale, .. } = &self.config;
        let scale = mm_per_pixel.map(Scale::stated);
        Known { sensor: sensor.as_ref(), scale, gel: *gel, crop: None, strict: *strict_scale }
    }

    /// Checks a frame and brings it to what the network takes.
    fn input<'a>(&self, frame: &'a Frame<'_>) -> Result<Input<'a>> {
        let start = Instant::now();
        frame.check()?;
        let known = self.known();
        let (scale, gel) = (frame.scale.or(known.scale), frame.gel.or(known.gel));
        let known = Known { scale, gel, crop: frame.crop, ..known };
        let view = view::view([frame.width, frame.height], known)?;
        let geometry = Geometry::new(&view, &self.model, self.config.input_size)?;
        // A GPU copies them anyhow, and who keeps stages wants them as they are.
        let borrow = self.engines().on_cores() && !self.config.keep_stages;
        Input::new(start, frame, view, geometry, borrow)
    }

    /// How maps and weights are stored: [`Config::precision`], but on the CPU. A picture that overflows
    /// f16 has [`Precision::F32`] in its [`Detections`].
    pub fn precision(&self) -> Precision {
        self.engines().precision()
    }

    /// What is left out where a picture does not need it: [`Config::scene`].
    pub fn scene(&self) -> Scene {
        self.config.scene
    }

    /// The network's configuration.
    pub fn model(&self) -> &ModelConfig {
        &self.model
    }

    /// Name of what runs the network: another where a lost device came back otherwise.
    pub fn adapter(&self) -> String {
        self.engines().adapter.clone()
    }

    /// Which kernels run the network on a GPU: equal bits are promised for equal choices.
    pub fn choice(&self) -> Choice {
        self.engines().choice.clone()
    }

    /// What went otherwise than the configuration says, a line each: a damaged file with a choice of
    /// kernels, say, that was passed over.
    pub fn remarks(&self) -> Vec<String> {
        self.engines().remarks.clone()
    }

    /// Measures which kernels are fastest on `gpu` for this network: see [`crate::verify::tune`]. The detector
    /// must hold its weights: one with [`Device::Reference`] does.
    ///
    /// # Errors
    /// As [`tune::tune`].
    pub fn tune(
        &self,
        gpu: &Arc<Gpu>,
        limit: Duration,
        progress: impl FnMut(usize, usize),
    ) -> Result<Tuned> {
        let noise = self.noise();
        let input = self.input(&noise)?;
        let engine = self.engines().one(input.geometry.size)?;
        let inputs = input.inputs(&engine.network);
        tune::tune(gpu, &engine.network.graph, &inputs, self.config.precision, limit, progress)
    }

    /// Times every command of this network on `gpu`: see [`crate::verify::profile`]. The detector must hold its
    /// weights: one with [`Device::Reference`] does. `remark` hears what [`GpuDetector::remarks`] would tell of
    /// one on `gpu`.
    ///
    /// # Errors
    /// As [`profile::commands`].
    pub fn profile(
        &self,
        gpu: &Arc<Gpu>,
        runs: usize,
        remark: impl FnMut(String),
    ) -> Result<Vec<CommandTime>> {
        let noise = self.noise();
        let input = self.input(&noise)?;
        let engine = self.engines().one(input.geometry.size)?;
        let inputs = input.inputs(&engine.network);
        let mut remarks = Vec::new();
        let choice = engine::choose(&self.config, gpu, &mut remarks);
        remarks.into_iter().for_each(remark);
        let how = (&choice, self.config.precision);
        profile::commands(gpu, &engine.network.graph, &inputs, how, runs)
    }

    /// A picture of the sensor's size in which there is something everywhere.
    fn noise(&self) -> Frame<'static> {
        let frame = self.config.sensor.as_ref().and_then(|sensor| sensor.frame);
        let [width, height] = frame.unwrap_or([1000, 1000]);
        let pixel = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 24) as u8;
        let pixels: Vec<u8> = (0..width as usize * height as usize).map(pixel).collect();
        Frame::new(pixels, width, height, PixelFormat::Gray8)
    }

    fn engines(&self) -> Arc<Engines> {
        self.engines.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Finds the snaps in a picture of the crate [`image`], of any kind of pixel. The network sees what
    /// [`Config::sensor`] says is gel.
    ///
    /// # Errors
    /// As [`GpuDetector::detect_frame`].
    #[cfg(feature = "image")]
    pub fn detect(&self, picture: &image::DynamicImage) -> Result<Detections> {
        self.detect_frame(&Frame::from(picture))
    }

    /// Finds the snaps in a picture in memory. [`crate::sensor::scale`] says which part of it is taken for gel, and at
    /// which scale. Of a frame whose scale nobody states the middle 60 mm at most along the longer side are
    /// seen, and [`Detections::assumption`] says what was assumed.
    ///
    /// # Errors
    /// [`Error::Picture`] for an empty picture, or one that shows more gel than the weights' input holds,
    /// [`Error::Param`] for a frame whose buffer does not hold what it says, [`Error::Sensor`] for one that
    /// cannot be the sensor's, [`Error::Scale`] for a scale or gel that it cannot have, or for an assumed scale
    /// with [`Config::strict_scale`], [`Error::Capacity`] for one past the device's largest binding,
    /// [`Error::DeviceLost`], [`Error::Timeout`] or [`Error::Driver`] from the device,
    /// [`Error::NotFinite`] if the network overflowed.
    pub fn detect_frame(&self, frame: &Frame) -> Result<Detections> {
        pollster::block_on(self.detect_async(frame))
    }

    /// [`GpuDetector::detect_frame`] for callers with an executor of their own. Waiting for a GPU does not
    /// block; making ready for a size that no picture had lately does, and opening a new device in place of a
    /// lost one. The CPU computes before the future is ready.
    ///
    /// # Errors
    /// As [`GpuDetector::detect_frame`].
    pub async fn detect_async(&self, frame: &Frame<'_>) -> Result<Detections> {
        let deadline = Deadline::after(self.config.timeout);
        let input = self.input(frame)?;
        let engines = self.engines();
        match self.detect_with(&engines, &input, deadline).await {
            Err(e) => self.detect_with(&*self.recover(&engines, e)?, &input, deadline).await,
            found => found,
        }
    }

    async fn detect_with(
        &self,
        engines: &Engines,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<Detections> {
        let sight = self.sight(engines, input, deadline).await?;
        self.look_at(engines, sight, deadline).await
    }

    /// What a picture's contact asks for.
    async fn sight<'a>(
        &self,
        engines: &Engines,
        input: &'a Input<'_>,
        deadline: Deadline,
    ) -> Result<Sight<'a>> {
        let look = match self.config.scene.looks() {
            true => Some(self.touched(engines, input, None, false, deadline).await?),
            false => None,
        };
        Ok(Sight::new(input, look, &self.config.scene))
    }

    async fn look_at(
        &self,
        engines: &Engines,
        sight: Sight<'_>,
        deadline: Deadline,
    ) -> Result<Detections> {
        let mut found = look::look_at(engines, &self.config, &[sight], deadline).await;
        found.pop().unwrap_or_else(|| Err(Error::tensor("detect", "picture", "one", "none")))
    }

    /// [`GpuDetector::detect_async`] of several frames, those of a size together.
    async fn detect_batch(&self, frames: &[Frame<'_>]) -> Vec<Result<Detections>> {
        let mut found = self.detect_together(frames).await;
        for (found, frame) in found.iter_mut().zip(frames) {
            // On a device that is opened anew.
            if matches!(found, Err(Error::DeviceLost(_))) {
                *found = self.detect_async(frame).await;
            }
        }
        found
    }

    async fn detect_together(&self, frames: &[Frame<'_>]) -> Vec<Result<Detections>> {
        // Its caller may come back for them late.
        let deadline = Deadline::of_each_run(self.config.timeout);
        let engines = self.engines();
        // By the frame's place.
        let mut found = BTreeMap::new();
        let mut inputs = Vec::new();
        for (at, frame) in frames.iter().enumerate() {
            match self.input(frame) {
                Ok(input) => inputs.push((at, input)),
                Err(e) => drop(found.insert(at, Err(e))),
            }
        }
        let (mut places, mut sights) = (Vec::new(), Vec::new());
        for (at, input) in &inputs {
            match self.sight(&engines, input, deadline).await {
                Ok(sight) => {
                    places.push(*at);
                    sights.push(sight);
                }
                Err(e) => drop(found.insert(*at, Err(e))),
            }
        }
        let seen = look::look_at(&engines, &self.config, &sights, deadline).await;
        found.extend(places.into_iter().zip(seen));
        found.into_values().collect()
    }

    /// Looks for contact, and, for a stream, for what changed since the frame with the cells `before`.
    async fn touched(
        &self,
        engines: &Engines,
        input: &Input<'_>,
        before: Option<&Value>,
        stream: bool,
        deadline: Deadline,
    ) -> Result<contact::Look> {
        let cells = contact::cells(&input.view);
        let reference = self.reference(&input.view)?;
        let kind = contact::Kind { cells, reference: reference.is_some(), stream };
        let (look, deadline) = deadline.beside(|| engines.contact(kind));
        look?.look(input, reference.as_deref(), before, deadline).await
    }

    /// The cells of [`Config::reference`] in a view, if that has its size or is the sensor's at another.
    fn reference(&self, view: &View) -> Result<Option<Arc<Value>>> {
        let Some(frame) = &self.config.reference else { return Ok(None) };
        let (size, sensor) = ([frame.width, frame.height], self.config.sensor.as_ref());
        let part = match view.frame == size {
            true => Some(view.part),
            false => sensor.and_then(|sensor| sensor.same_part(view.gel, view.part, size)),
        };
        let Some(part) = part else { return Ok(None) };
        let mut known = lock(&self.reference);
        if let Some((_, cells)) = known.as_ref().filter(|(of, _)| of == view) {
            return Ok(Some(cells.clone()));
        }
        let cells = Arc::new(contact::reference_cells(frame, part, contact::cells(view))?);
        *known = Some((*view, cells.clone()));
        Ok(Some(cells))
    }

    /// Looks at frames of one camera in their order: one that equals the last that was computed keeps its
    /// detections.
    pub fn stream(&self) -> Stream<'_> {
        Stream::new(self)
    }

    /// [`GpuDetector::stream`] over `frames`. The iterator ends with them; an error is that of its frame
    /// alone.
    pub fn detect_stream<'a>(
        &'a self,
        frames: impl IntoIterator<Item = Frame<'a>> + 'a,
    ) -> impl Iterator<Item = Result<Detections>> + 'a {
        let mut stream = self.stream();
        frames.into_iter().map(move |frame| stream.detect(&frame))
    }

    /// Finds the snaps in each of `frames`, in their order, with several in flight: the next frame is
    /// taken when a place is free, so memory is bounded whatever there are.
    ///
    /// The iterator ends with the frames; an error is that of its frame alone.
    pub fn detect_many<'a>(
        &'a self,
        frames: impl IntoIterator<Item = Frame<'a>, IntoIter: Send> + 'a,
    ) -> impl Iterator<Item = Result<Detections>> + 'a {
        many::Many::new(self, frames.into_iter())
    }

    /// [`GpuDetector::detect_frame`], with the tensor of every stage, cut to the rows that a count
    /// made valid. Needs `Config::keep_stages`.
    ///
    /// # Errors
    /// As [`GpuDetector::detect_frame`]; [`Error::Param`] without `keep_stages`.
    pub fn detect_with_stages(&self, frame: &Frame) -> Result<(Detections, Stages)> {
        self.check_keeps_stages()?;
        let deadline = Deadline::after(self.config.timeout);
        let input = self.input(frame)?;
        let (mut values, detections) = pollster::block_on(self.look_at_stages(&input, deadline))?;
        let engine = self.engines().one(input.geometry.size)?;
        let graph = &engine.network.graph;
        let named = |id: TensorId| Some((graph.name(id).to_owned(), values.remove(&id)?));
        Ok((detections, graph.computed().into_iter().filter_map(named).collect()))
    }

    /// Looks at a picture on the device and with the f64 reference, and compares every operation and
    /// what comes out: see [`crate::verify::comparison`]. Needs `Config::keep_stages`.
    ///
    /// # Errors
    /// As [`GpuDetector::detect_frame`]; [`Error::Param`] without `keep_stages` or a GPU;
    /// [`Error::Overflow`] where the device's numbers overflow and those of the reference do not.
    pub fn compare(&self, frame: &Frame) -> Result<Comparison> {
        let mut input = self.input(frame)?;
        let engine = self.engines().one(input.geometry.size)?;
        if !engine.is_gpu() {
            return Err(Error::param("compare", "device", "a GPU", "the CPU"));
        }
        self.check_keeps_stages()?;
        let network = &engine.network;
        let deadline = Deadline::after(self.config.timeout);
        let (got, times) = pollster::block_on(engine.run(&input.inputs(network), deadline))?;
        let found = input.detections(network, &got, times);
        input.start = Instant::now();
        let inputs = input.inputs(network);
        let (want, times) = network.graph.reference(&inputs, &network.graph.computed())?;
        let expected = input.detections(network, &want, times)?;
        let precision = engine.how().precision;
        let found = match found {
            Err(Error::NotFinite { stage, count }) => {
                return Err(Error::Overflow { stage, count, precision: precision.to_string() });
            }
            found => Detections { precision, ..found? },
        };
        let scale = input.scale().into_iter().map(f64::from).fold(0.0, f64::max);
        let outcome = comparison::compare(network, &inputs, [&got, &want], scale, engine.how())?;
        let time = |stage: &str| found.stages.iter().find(|t| t.stage == stage).map(|t| t.time);
        let stages = expected.stages.iter().zip(outcome.stages);
        let stages = stages.map(|(reference, tensors)| StageComparison {
            stage: reference.stage.clone(),
            time: time(&reference.stage),
            reference_time: reference.time,
            tensors,
        });
        let mm_per_pixel = f64::from(input.view.scale.mm_per_pixel);
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

    async fn look_at_stages(
        &self,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<(Values, Detections)> {
        let engines = self.engines();
        match self.look_with(&engines, input, deadline).await {
            Err(e) => self.look_with(&*self.recover(&engines, e)?, input, deadline).await,
            found => found,
        }
    }

    fn check_keeps_stages(&self) -> Result<()> {
        match self.config.keep_stages {
            true => Ok(()),
            false => Err(Error::param("detect", "keep_stages", true, false)),
        }
    }

    /// What to go on with after an error: on a lost device a new one.
    ///
    /// # Errors
    /// The error itself, and what opening a device returns.
    fn recover(&self, engines: &Arc<Engines>, error: Error) -> Result<Arc<Engines>> {
        match error {
            Error::DeviceLost(_) if self.config.rebuild_on_loss && !self.foreign => {
                self.rebuild(engines)
            }
            error => Err(error),
        }
    }

    /// Looks at a whole picture. The values are the outputs, or with `keep_stages` those of every stage,
    /// cut to their valid rows.
    async fn look_with(
        &self,
        engines: &Engines,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<(Values, Detections)> {
        let (size, precision) = (input.geometry.size, engines.precision());
        let engine = |precision| engines.engine(engines.whole(size, precision));
        match self.look_in(engine(precision)?, input, deadline).await {
            Err(Error::NotFinite { .. }) if precision == Precision::F16 => {
                self.look_in(engine(Precision::F32)?, input, deadline).await
            }
            found => found.map(|(values, found)| (values, Detections { precision, ..found })),
        }
    }

    async fn look_in(
        &self,
        engine: Arc<Engine>,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<(Values, Detections)> {
        let network = &engine.network;
        let inputs = input.inputs(network);
        let (mut values, times): (Values, Vec<StageTime>) = engine.run(&inputs, deadline).await?;
        if self.config.keep_stages {
            network.graph.truncate(&inputs, &mut values);
        }
        let detections = input.detections(network, &values, times)?;
        Ok((values, detections))
    }

    /// Opens a new device in place of that of `lost`, unless another thread has.
    fn rebuild(&self, lost: &Arc<Engines>) -> Result<Arc<Engines>> {
        let _one = lock(&self.rebuilding);
        let current = self.engines();
        if !Arc::ptr_eq(&current, lost) {
            return Ok(current);
        }
        let mut engines = pollster::block_on(Engines::open(&self.config, None))?;
        if engines.adapter != lost.adapter {
            let remark = format!("{} was lost: {} goes on", lost.adapter, engines.adapter);
            engines.remarks.push(remark);
        }
        let engines = Arc::new(engines);
        *self.engines.write().unwrap_or_else(PoisonError::into_inner) = engines.clone();
        Ok(engines)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[cfg(feature = "serde")]
    use crate::{sensor::rect::Rect, sensor::scale::Origin};
    #[cfg(feature = "serde")]
    use std::time::Duration;

    /// The names that `smr-gpu detect --json` prints, and all of it back.
    #[cfg(feature = "serde")]
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

    #[test]
    fn a_line_for_people() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet.safetensors");
        let bytes = std::fs::read(file).expect("the weights");
        let length = bytes.len();
        let config = Config::from_bytes("memory", bytes).device(Device::Reference);
        let line = format!("{config:?}");
        assert!(line.contains(&format!(r#"Bytes("memory", {length} bytes)"#)), "{line}");
        let detector = GpuDetector::new(config).expect("a detector");
        let want = "GpuDetector(classes A, B, sensor none named, on CPU reference (f64))";
        assert_eq!(format!("{detector:?}"), want);
        let engine = detector.engines().one([320, 320]).expect("an engine");
        let network = format!("{:?}", engine.network);
        let start = "Network(320 × 320, classes A, B, Graph(";
        assert!(network.starts_with(start) && network.len() < 100, "{network}");
    }
}
