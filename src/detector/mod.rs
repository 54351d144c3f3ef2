//! [`GpuDetector`]: a frame in, snaps out.
//!
//! A frame's way: `input` finds what of it the network sees ([`crate::sensor`]'s view) and brings its bytes
//! to where they are read; `contact_map` says where something touches the gel, `regions` which parts are
//! worth the network; `inference` runs those and turns what comes out into detections (`output`).
//!
//! | file | what it holds |
//! |---|---|
//! | `savings` | what may be left out of a picture |
//! | `config` | how to build a detector |
//! | `detection` | what it finds |
//! | `geometry` | how large the network's input is for a view, and regions of it |
//! | `input` | from a frame to what the network takes |
//! | `output` | from what the network gives to detections |
//! | `gate` | what one caller does at a time |
//! | `pool` | the memory of runs: as many in flight as there are arenas |
//! | `runner` | what runs a graph: a GPU, the CPU, the reference |
//! | `compiled` | the network for one size of input, and what runs it |
//! | `contact_map` | where something touches the gel |
//! | `regions` | the parts of a picture that the network runs on |
//! | `session` | the weights, the device, and the network compiled for each size of input |
//! | `inference` | the network over pictures or their regions, those of a size together |
//! | `many` | many pictures, in order |
//! | `caching` | frames of which few change |

mod caching;
pub(crate) mod compiled;
mod config;
mod contact_map;
mod detection;
mod gate;
mod geometry;
mod inference;
pub(crate) mod input;
mod many;
mod output;
mod pool;
mod regions;
mod runner;
mod savings;
pub(crate) mod session;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use web_time::Instant;

use crate::engine::gpu::{Deadline, Gpu};
use crate::engine::lock::lock;
use crate::engine::lower::KernelChoice;
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};
use crate::sensor::frame::Frame;
use crate::sensor::scale::Scale;
use crate::sensor::view::{self, Known, View};
use crate::smr::ModelConfig;
pub use caching::{CachingDetector, MOST_REUSED};
pub use config::{Config, Device};
pub use detection::{Detection, Detections};
use gate::Gate;
use geometry::Geometry;
use inference::Job;
use input::Input;
pub use savings::{Saving, Savings};
use session::{Key, Session};

/// Finds snap joints in pictures. Build it once; it holds the device, the compiled shaders, the
/// weights and all buffers. Pictures given from several threads are in flight together, as many as
/// [`Config::in_flight`] says.
pub struct GpuDetector {
    config: Config,
    model: ModelConfig,
    /// Replaced when the device was lost.
    session: RwLock<Arc<Session>>,
    /// The frame without contact as the last view shows it.
    reference: Mutex<Option<(View, Arc<Value>)>>,
    /// Held while the session is rebuilt.
    rebuilding: Gate,
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

    /// [`GpuDetector::new_async`] on a device that is open already; `device` and `bounds_checks` of the
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
            config.savings = Savings::NONE;
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
        let session = Session::open(&config, gpu).await?;
        let model = session.model().clone();
        let (session, rebuilding) = (RwLock::new(Arc::new(session)), Gate::default());
        let reference = Mutex::default();
        let detector = Self { config, model, session, reference, rebuilding, foreign };
        match detector.usual_frame() {
            Some(frame) => detector.prepare(frame).await?,
            None => detector.session().check()?,
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
    async fn prepare(&self, frame: [u32; 2]) -> Result<()> {
        let view = view::view(frame, self.known())?;
        let geometry = Geometry::new(&view, &self.model, self.config.input_size)?;
        let session = self.session();
        let (savings, size) = (&self.config.savings, geometry.size);
        // All of the network first: what leaves some of it out then shares its weights.
        let all = session.whole(size, session.precision());
        session.compiled(all).await?;
        let proposals = savings.proposals(size, false);
        session.compiled(Key { proposals, deepest: !savings.scales, ..all }).await?;
        if savings.need_contact() {
            let reference = self.reference(&view)?.is_some();
            let cells = contact_map::cells(&view);
            session.contact(contact_map::Key { cells, reference, stream: false }).await?;
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
    pub(crate) fn input<'a>(&self, frame: &'a Frame<'_>) -> Result<Input<'a>> {
        let start = Instant::now();
        frame.check()?;
        let known = self.known();
        let (scale, gel) = (frame.scale.or(known.scale), frame.gel.or(known.gel));
        let known = Known { scale, gel, crop: frame.crop, ..known };
        let view = view::view([frame.width, frame.height], known)?;
        let geometry = Geometry::new(&view, &self.model, self.config.input_size)?;
        // A GPU copies them anyhow, and who keeps stages wants them as they are.
        let borrow = self.session().on_cores() && !self.config.keep_stages;
        Input::new(start, frame, view, geometry, borrow)
    }

    /// How maps and weights are stored: [`Config::precision`], but on the CPU. A picture that overflows
    /// f16 has [`Precision::F32`] in its [`Detections`].
    pub fn precision(&self) -> Precision {
        self.session().precision()
    }

    /// How it was built; the reference frame may be the sensor's, and nothing is left out where stages are kept.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The network's configuration.
    pub fn model(&self) -> &ModelConfig {
        &self.model
    }

    /// Name of what runs the network: another where a lost device came back otherwise.
    pub fn adapter(&self) -> String {
        self.session().adapter.clone()
    }

    /// Which kernels run the network on a GPU: equal bits are promised for equal choices.
    pub fn kernels(&self) -> KernelChoice {
        self.session().kernels.clone()
    }

    /// What went otherwise than the configuration says, a line each: a damaged file with a choice of
    /// kernels, say, that was passed over.
    pub fn remarks(&self) -> Vec<String> {
        self.session().remarks.clone()
    }

    pub(crate) fn session(&self) -> Arc<Session> {
        self.session.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Finds the snaps in a [`Frame`], or with the feature `image` in a picture of that crate.
    /// [`Scale`] has which part of it is taken for gel, and at which scale. Of a frame whose scale
    /// nobody states the middle 60 mm at most along the longer side are seen, and [`Detections::assumption`] says
    /// what was assumed.
    ///
    /// # Errors
    /// [`Error::Picture`] for an empty picture, or one that shows more gel than the weights' input holds,
    /// [`Error::Param`] for a frame whose buffer does not hold what it says, [`Error::Sensor`] for one that
    /// cannot be the sensor's, [`Error::Scale`] for a scale or gel that it cannot have, or for an assumed scale
    /// with [`Config::strict_scale`], [`Error::Capacity`] for one past the device's largest binding,
    /// [`Error::DeviceLost`], [`Error::Timeout`] or [`Error::Driver`] from the device,
    /// [`Error::NotFinite`] if the network overflowed.
    pub fn detect<'f>(&self, picture: impl Into<Frame<'f>>) -> Result<Detections> {
        pollster::block_on(self.detect_async(picture))
    }

    /// [`GpuDetector::detect`] for callers with an executor of their own. Waiting for a GPU does not
    /// block. Making ready for a size that no picture had lately does, and opening a new device in place of a
    /// lost one, but not in a browser. The CPU computes before the future is ready.
    ///
    /// # Errors
    /// As [`GpuDetector::detect`].
    pub async fn detect_async<'f>(&self, picture: impl Into<Frame<'f>>) -> Result<Detections> {
        let deadline = Deadline::after(self.config.timeout);
        let frame = picture.into();
        let input = self.input(&frame)?;
        let session = self.session();
        match self.detect_with(&session, &input, deadline).await {
            Err(e) => {
                let session = self.recover(&session, e).await?;
                self.detect_with(&session, &input, deadline).await
            }
            found => found,
        }
    }

    async fn detect_with(
        &self,
        session: &Session,
        input: &Input<'_>,
        deadline: Deadline,
    ) -> Result<Detections> {
        let job = self.job(session, input, deadline).await?;
        self.run_job(session, job, deadline).await
    }

    /// What a picture's contact asks for.
    async fn job<'a>(
        &self,
        session: &Session,
        input: &'a Input<'_>,
        deadline: Deadline,
    ) -> Result<Job<'a>> {
        let contact = match self.config.savings.need_contact() {
            true => Some(self.contact(session, input, None, false, deadline).await?),
            false => None,
        };
        Ok(Job::new(input, contact, &self.config.savings))
    }

    async fn run_job(
        &self,
        session: &Session,
        job: Job<'_>,
        deadline: Deadline,
    ) -> Result<Detections> {
        let mut found = inference::run_jobs(session, &self.config, &[job], deadline).await;
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
        let session = self.session();
        // By the frame's place.
        let mut found = BTreeMap::new();
        let mut inputs = Vec::new();
        for (at, frame) in frames.iter().enumerate() {
            match self.input(frame) {
                Ok(input) => inputs.push((at, input)),
                Err(e) => drop(found.insert(at, Err(e))),
            }
        }
        let (mut places, mut jobs) = (Vec::new(), Vec::new());
        for (at, input) in &inputs {
            match self.job(&session, input, deadline).await {
                Ok(job) => {
                    places.push(*at);
                    jobs.push(job);
                }
                Err(e) => drop(found.insert(*at, Err(e))),
            }
        }
        let seen = inference::run_jobs(&session, &self.config, &jobs, deadline).await;
        found.extend(places.into_iter().zip(seen));
        found.into_values().collect()
    }

    /// Maps contact, and, for a caching detector, what changed since the frame with the cells `before`.
    async fn contact(
        &self,
        session: &Session,
        input: &Input<'_>,
        before: Option<&Value>,
        stream: bool,
        deadline: Deadline,
    ) -> Result<contact_map::Contact> {
        let cells = contact_map::cells(&input.view);
        let reference = self.reference(&input.view)?;
        let kind = contact_map::Key { cells, reference: reference.is_some(), stream };
        let (graph, deadline) = deadline.beside(session.contact(kind)).await;
        graph?.run(input, reference.as_deref(), before, deadline).await
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
        let cells = Arc::new(contact_map::reference_cells(frame, part, contact_map::cells(view))?);
        *known = Some((*view, cells.clone()));
        Ok(Some(cells))
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

    /// [`GpuDetector::detect_many`] of frames that own their bytes, by an iterator that keeps the detector: for
    /// programs that cannot tell how long they ask it for results.
    pub fn into_many(
        self: Arc<Self>,
        frames: impl IntoIterator<Item = Frame<'static>, IntoIter: Send + 'static>,
    ) -> impl Iterator<Item = Result<Detections>> + Send + 'static {
        many::Many::new(self, frames.into_iter())
    }

    /// What to go on with after an error: on a lost device a new one.
    ///
    /// # Errors
    /// The error itself, and what opening a device returns.
    pub(crate) async fn recover(
        &self,
        session: &Arc<Session>,
        error: Error,
    ) -> Result<Arc<Session>> {
        match error {
            Error::DeviceLost(_) if self.config.rebuild_on_loss && !self.foreign => {
                self.rebuild(session).await
            }
            error => Err(error),
        }
    }

    /// Opens a new device in place of that of `lost`, unless another caller has.
    async fn rebuild(&self, lost: &Arc<Session>) -> Result<Arc<Session>> {
        let _one = self.rebuilding.pass().await;
        let current = self.session();
        if !Arc::ptr_eq(&current, lost) {
            return Ok(current);
        }
        let mut session = Session::open(&self.config, None).await?;
        if session.adapter != lost.adapter {
            let remark = format!("{} was lost: {} goes on", lost.adapter, session.adapter);
            session.remarks.push(remark);
        }
        let session = Arc::new(session);
        *self.session.write().unwrap_or_else(PoisonError::into_inner) = session.clone();
        Ok(session)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_for_people() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet.safetensors");
        let bytes = std::fs::read(file).expect("the weights");
        let length = bytes.len();
        let config = Config { device: Device::Reference, ..Config::from_bytes("memory", bytes) };
        let line = format!("{config:?}");
        assert!(line.contains(&format!(r#"Bytes("memory", {length} bytes)"#)), "{line}");
        let detector = GpuDetector::new(config).expect("a detector");
        let want = "GpuDetector(classes A, B, sensor none named, on CPU reference (f64))";
        assert_eq!(format!("{detector:?}"), want);
        let engine = pollster::block_on(detector.session().one([320, 320])).expect("an engine");
        let network = format!("{:?}", engine.network);
        let start = "Network(320 × 320, classes A, B, Graph(";
        assert!(network.starts_with(start) && network.len() < 100, "{network}");
    }
}
