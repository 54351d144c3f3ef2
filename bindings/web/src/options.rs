//! A detector's options, as the library's configuration.

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use smr_gpu::internals::engine::gpu::AdapterChoice;
use smr_gpu::{Config, Device, Error, Gel, Rect, Result, Saving, Savings, Sensor};

/// What a page says of a detector; what it leaves out is as [`Config`] has it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
struct Options {
    sensor: Option<Named>,
    mm_per_pixel: Option<f32>,
    gel: Option<Rect>,
    strict_scale: Option<bool>,
    input_size: Option<usize>,
    leave_out: Option<Vec<Saving>>,
    score: Option<f32>,
    iou: Option<f32>,
    max_detections: Option<usize>,
    classes: Option<Vec<String>>,
    precision: Option<String>,
    /// Seconds.
    timeout: Option<f64>,
}

/// A built-in sensor, or the fields of a sensor file.
#[derive(Deserialize)]
#[serde(untagged)]
enum Named {
    Name(String),
    File(serde_json::Value),
}

impl Named {
    fn sensor(&self) -> Result<Sensor> {
        match self {
            Self::File(fields) => Sensor::parse(&fields.to_string()),
            Self::Name(name) => Sensor::named(name).ok_or_else(|| {
                let expected =
                    format!("{}, or the fields of a sensor file", Sensor::NAMES.join(", "));
                Error::param("load", "sensor", expected, format!("`{name}`"))
            }),
        }
    }
}

/// The configuration for weights of these bytes, called `name`, and options in JSON.
///
/// # Errors
/// [`Error::Param`] for options that there are not or that are of another kind, and [`Error::Sensor`].
pub fn config(name: &str, weights: Arc<[u8]>, options: &str) -> Result<Config> {
    let wrong = |e| Error::param("load", "options", "those of its documentation", e);
    let given: Options = serde_json::from_str(options).map_err(wrong)?;
    let usual = Config::from_bytes(name, weights);
    Ok(Config {
        device: Device::Gpu(AdapterChoice::Auto),
        sensor: given.sensor.as_ref().map(Named::sensor).transpose()?,
        mm_per_pixel: given.mm_per_pixel,
        gel: given.gel.map(Gel::Part),
        strict_scale: given.strict_scale.unwrap_or(usual.strict_scale),
        input_size: given.input_size,
        savings: given.leave_out.as_deref().map_or(usual.savings, Savings::of),
        score: given.score.unwrap_or(usual.score),
        iou: given.iou.unwrap_or(usual.iou),
        max_detections: given.max_detections.unwrap_or(usual.max_detections),
        classes: given.classes.unwrap_or_default(),
        precision: given.precision.as_deref().map_or(Ok(usual.precision), str::parse)?,
        timeout: given.timeout.map_or(Ok(usual.timeout), seconds)?,
        ..usual
    })
}

fn seconds(seconds: f64) -> Result<Duration> {
    let out = |_| Error::param("load", "timeout", "seconds from 0 on", seconds);
    Duration::try_from_secs_f64(seconds).map_err(out)
}
