//! A detector's options, as the library's configuration.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use smr_gpu::{Config, Error, Result, Sensor};

use crate::errors::raised;
use crate::picture::{Given, Part, Picture, Said};

/// Weights: a file's bytes, or a name or file.
#[derive(FromPyObject)]
enum Weights {
    Bytes(PyBackedBytes),
    Named(PathBuf),
}

/// What may be left out of a picture: `smr_gpu.Savings`.
#[derive(FromPyObject)]
struct Savings {
    contact: bool,
    regions: bool,
    proposals: bool,
    scales: bool,
    margin_mm: f32,
    most_of_input: f32,
    doubt: f32,
    most_proposals: usize,
}

/// The arguments of `smr_gpu.Detector`, which has their meaning.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options<'py> {
    weights: Weights,
    device: String,
    sensor: Option<String>,
    mm_per_pixel: Option<f32>,
    gel: Option<Part>,
    strict_scale: bool,
    input_size: Option<usize>,
    savings: Savings,
    reference: Option<Given<'py>>,
    score: f32,
    counts_above: Option<f32>,
    iou: f32,
    max_detections: usize,
    classes: Vec<String>,
    timeout: f64,
    rebuild_on_loss: bool,
    in_flight: usize,
    batch: usize,
    precision: String,
    tuned_kernels: Option<PathBuf>,
    bounds_checks: bool,
}

impl Options<'_> {
    /// The library's configuration.
    ///
    /// # Errors
    /// The library's, as exceptions.
    pub fn config(self, py: Python<'_>) -> PyResult<Config> {
        let nothing = Said::default();
        let reference =
            self.reference.map(|given| Picture::new(py, given, &nothing)).transpose()?;
        let reference = reference.map(|picture| Arc::new(picture.frame().into_owned()));
        let fail = |e: Error| raised(py, e);
        Ok(Config {
            device: self.device.parse().map_err(fail)?,
            sensor: self.sensor.as_deref().map(Sensor::find).transpose().map_err(fail)?,
            mm_per_pixel: self.mm_per_pixel,
            gel: self.gel.as_ref().map(Part::gel).transpose().map_err(fail)?,
            strict_scale: self.strict_scale,
            input_size: self.input_size,
            savings: self.savings.into(),
            reference,
            score: self.score,
            counts_above: self.counts_above,
            iou: self.iou,
            max_detections: self.max_detections,
            classes: self.classes,
            timeout: seconds(self.timeout).map_err(fail)?,
            rebuild_on_loss: self.rebuild_on_loss,
            in_flight: self.in_flight,
            batch: self.batch,
            precision: self.precision.parse().map_err(fail)?,
            tuned_kernels: self.tuned_kernels,
            bounds_checks: self.bounds_checks,
            ..self.weights.config().map_err(fail)?
        })
    }
}

impl Weights {
    fn config(self) -> Result<Config> {
        match self {
            Self::Bytes(bytes) => Ok(Config::from_bytes("weights", bytes.to_vec())),
            Self::Named(name) => Config::find(name),
        }
    }
}

impl From<Savings> for smr_gpu::Savings {
    fn from(savings: Savings) -> Self {
        let Savings { contact, regions, proposals, scales, .. } = savings;
        let Savings { margin_mm, most_of_input, doubt, most_proposals, .. } = savings;
        Self {
            contact,
            regions,
            proposals,
            scales,
            margin_mm,
            most_of_input,
            doubt,
            most_proposals,
        }
    }
}

fn seconds(seconds: f64) -> Result<Duration> {
    let out = |_| Error::param("detect", "timeout", "seconds from 0 on", seconds);
    Duration::try_from_secs_f64(seconds).map_err(out)
}
