//! Options that several commands share, and opening what they ask for.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use smr_gpu::engine::gpu::{AdapterChoice, Gpu, GpuOptions};
use smr_gpu::files::Outputs;
use smr_gpu::smr::{Catalog, ModelConfig};
use smr_gpu::{
    Config, Detections, Device, Error, Gel, GpuDetector, Origin, Precision, Saving, Savings, Scale,
    Sensor, WeightSource,
};

use super::adapters::Record;
use super::exit::{Exit, Failure};
use super::folders;
use super::message::remark;
use super::probe;

/// What runs a command.
#[derive(Debug, clap::Args)]
pub(super) struct DeviceArgs {
    /// What runs it: `auto` (a hardware adapter if there is one, else the CPU), `gpu` (the best adapter,
    /// including software renderers), an index of `smr-gpu devices`, a part of an adapter's name, `cpu`, or
    /// `reference` (the f64 reference, slow).
    #[arg(help_heading = "Device", long, default_value = "auto")]
    #[arg(value_name = "auto|gpu|cpu|reference|INDEX|NAME")]
    #[arg(value_parser = known::<Device>, allow_negative_numbers = true)]
    pub device: Device,
}

/// The adapter of a command that only a GPU can run.
#[derive(Debug, clap::Args)]
pub(super) struct AdapterArgs {
    /// What runs it: `auto` (the best adapter, including software renderers), an index of `smr-gpu
    /// devices`, or a part of an adapter's name.
    #[arg(help_heading = "Device", long, default_value = "auto", value_name = "auto|INDEX|NAME")]
    #[arg(value_parser = known::<Device>, allow_negative_numbers = true)]
    device: Device,
}

/// Which network finds snaps, and in what pictures.
#[derive(Debug, clap::Args)]
pub(super) struct NetworkArgs {
    /// The network: `large` (the paper's), `small` (an eighth of its multiply-adds), another name of `smr-gpu
    /// weights`, or a weight file [default: $SMR_GPU_WEIGHTS, else `large`, else `small`].
    #[arg(help_heading = "Model", long, value_name = "large|small|NAME|FILE")]
    weights: Option<PathBuf>,

    /// The sensor that took the pictures: `paper`, `gelsight-mini`, `digit`, `plain` (the whole frame is gel), or a
    /// sensor file (JSON). Without this and --mm-per-pixel, the shorter side of the gel is assumed to be 40 mm
    /// long; stderr and --json say so.
    #[arg(help_heading = "Sensor", long, value_name = "NAME|FILE", value_parser = given)]
    pub sensor: Option<Given>,

    /// Millimetres of gel a pixel; replaces the scale of --sensor.
    #[arg(help_heading = "Sensor", long, value_name = "MM", value_parser = scale, allow_negative_numbers = true)]
    pub mm_per_pixel: Option<f32>,

    /// The part of each picture that shows the gel, in pixels, or `all` [default: that of --sensor; without it the
    /// middle square of 16 : 10 frames, as the paper's camera takes, and all of others].
    #[arg(help_heading = "Sensor", long, value_name = "X,Y,W,H|all")]
    pub gel: Option<Gel>,

    /// Fail for pictures whose scale is not stated.
    #[arg(help_heading = "Sensor", long)]
    strict_scale: bool,

    /// Time limit for one picture, in seconds; the f64 reference has none.
    #[arg(help_heading = "Device", long, default_value = "120", value_name = "SECONDS", value_parser = seconds)]
    #[arg(allow_negative_numbers = true)]
    timeout: Duration,

    /// How a GPU stores maps and weights, or what cores multiply: `f16`, for GPUs, takes half the memory and is less
    /// exact. A picture that overflows f16 is run again in f32; stderr says so. `bf16` is for cores with AVX-512
    /// BF16 or NEON BF16, `int8` for those with AVX-512 VNNI, AVX-VNNI or NEON dot products; both are less exact.
    /// Others compute in f32, and stderr says so.
    #[arg(help_heading = "Speed", long, value_name = "f32|f16|bf16|int8", value_parser = known::<Precision>)]
    precision: Option<Precision>,

    /// Longer side of the gel in the network's input, in pixels, a multiple of 32 [default: by the scale that the
    /// weights were trained at]. Another scale finds fewer snaps.
    #[arg(help_heading = "Advanced", long, value_name = "PIXELS", value_parser = input_size)]
    size: Option<usize>,
}

/// Which of the network's boxes stay.
#[derive(Debug, clap::Args)]
pub(super) struct BoxArgs {
    /// Non-maximum suppression: of two boxes of a class with a larger intersection over union than this (0 to 1),
    /// drop the one with the lower score.
    #[arg(help_heading = "Advanced", long, default_value_t = 0.5, value_name = "IOU", value_parser = fraction)]
    #[arg(allow_negative_numbers = true)]
    pub iou: f32,
}

/// A sensor that an option names, with its file if it has one.
#[derive(Clone, Debug)]
pub(super) struct Given {
    sensor: Sensor,
    file: Option<PathBuf>,
}

/// A network, what it may leave out, and where it runs.
#[derive(Debug, clap::Args)]
pub(super) struct DetectorArgs {
    #[command(flatten)]
    pub network: NetworkArgs,

    #[command(flatten)]
    device: DeviceArgs,

    /// What to leave out where a picture does not need it, separated by commas: `contact` (the network, where
    /// nothing touches the gel), `regions` (the gel away from contacts), `proposals` (places unlikely to be a snap),
    /// `scales` (the deepest of the three scales). Where a box is then in doubt, the picture is run again with
    /// nothing left out [default: contact,regions].
    #[arg(help_heading = "Speed", long, value_name = "WHAT,…", value_delimiter = ',')]
    #[arg(value_parser = PossibleValuesParser::new(Saving::ALL.map(Saving::name)).map(saving))]
    leave_out: Vec<Saving>,

    /// Leave nothing out.
    #[arg(help_heading = "Speed", long, conflicts_with = "leave_out")]
    exact: bool,

    #[command(flatten)]
    boxes: BoxArgs,
}

/// A saving by one of the names.
fn saving(name: String) -> Saving {
    let named = Saving::ALL.into_iter().find(|saving| saving.name() == name);
    named.expect("clap lets through those names alone")
}

/// Longest time limit: a day, which every clock and driver counts.
const MAX_SECONDS: f64 = 86_400.0;

/// Parses a time from 0 s to a day.
///
/// # Errors
/// In words, also for NaN.
fn seconds(text: &str) -> Result<Duration, String> {
    let expected = || format!("expected a number of seconds from 0 to {MAX_SECONDS}");
    let seconds: f64 = text.parse().map_err(|_| expected())?;
    match (0.0..=MAX_SECONDS).contains(&seconds) {
        true => Duration::try_from_secs_f64(seconds).map_err(|_| expected()),
        false => Err(expected()),
    }
}

/// A sensor by its name or from its file.
///
/// # Errors
/// In words.
pub(super) fn sensor(text: &str) -> Result<Sensor, String> {
    Sensor::find(text).map_err(|e| match e {
        Error::Param { expected, .. } => format!("expected {expected}"),
        other => other.to_string(),
    })
}

fn given(text: &str) -> Result<Given, String> {
    let file = Sensor::named(text).is_none().then(|| text.into());
    Ok(Given { sensor: sensor(text)?, file })
}

/// Parses millimetres a pixel.
///
/// # Errors
/// In words.
fn scale(text: &str) -> Result<f32, String> {
    let mm = text.parse().map_err(|_| "expected a number of millimetres".to_owned())?;
    Scale::stated(mm).check().map(|()| mm).map_err(|e| match e {
        Error::Param { expected, .. } => format!("expected {expected}"),
        other => other.to_string(),
    })
}

/// Parses a side of the network's input.
///
/// # Errors
/// In words.
pub(super) fn input_size(text: &str) -> Result<usize, String> {
    let size = text.parse().ok().filter(|size| ModelConfig::is_input_size(*size));
    size.ok_or_else(|| format!("expected {}", ModelConfig::INPUT_SIZES))
}

/// Parses a number of a range.
///
/// # Errors
/// In words, also for NaN.
pub(super) fn number(text: &str, [least, most]: [f64; 2]) -> Result<f64, String> {
    // A NaN is in no range.
    let value = text.parse().ok().filter(|value| (least..=most).contains(value));
    value.ok_or_else(|| format!("expected a number from {least} to {most}"))
}

/// Parses what the library has names for, a device for one.
///
/// # Errors
/// In words, without the library's name of the option.
pub(super) fn known<T: FromStr<Err = Error>>(text: &str) -> Result<T, String> {
    text.parse().map_err(|e| match e {
        Error::Param { expected, got, .. } => format!("expected {expected}, got {got}"),
        other => other.to_string(),
    })
}

/// Parses a number from 0 to 1.
///
/// # Errors
/// As [`number`].
pub(super) fn fraction(text: &str) -> Result<f32, String> {
    exact_fraction(text).map(|value| value as f32)
}

/// [`fraction`] with all its digits.
///
/// # Errors
/// As [`fraction`].
pub(super) fn exact_fraction(text: &str) -> Result<f64, String> {
    number(text, [0.0, 1.0])
}

impl DeviceArgs {
    /// What is to be held to the reference.
    ///
    /// # Errors
    /// [`Exit::Usage`] for the reference itself.
    pub fn but_the_reference(&self) -> Result<Device, Failure> {
        match &self.device {
            Device::Reference => {
                Err(Failure::usage("--device: expected what is held to the reference, got it"))
            }
            device => Ok(device.clone()),
        }
    }
}

impl AdapterArgs {
    /// The adapter.
    ///
    /// # Errors
    /// [`Exit::Usage`] for the CPU.
    pub fn choice(&self) -> Result<AdapterChoice, Failure> {
        match &self.device {
            Device::Gpu(choice) => Ok(choice.clone()),
            Device::Auto => Ok(AdapterChoice::Auto),
            Device::Cpu | Device::Reference => {
                Err(Failure::usage("--device: expected a GPU or a software renderer, got the CPU"))
            }
        }
    }

    /// Opens the adapter, with the network's limit on each run.
    ///
    /// # Errors
    /// As [`choice`](Self::choice), and what the library returns.
    pub fn open(&self, network: &NetworkArgs) -> Result<Arc<Gpu>, Failure> {
        let (adapter, timeout) = (self.choice()?, network.timeout);
        resolved(&Device::Gpu(adapter.clone()))?;
        let options = GpuOptions { adapter, timeout, ..GpuOptions::default() };
        Ok(pollster::block_on(Gpu::open(options))?)
    }
}

impl NetworkArgs {
    /// Spares what a configuration of these options is read from: the weights, the sensor's file and its
    /// reference frame.
    pub fn spare(&self, outputs: &mut Outputs, config: &Config) {
        config.weights.file().into_iter().for_each(|file| outputs.spare(file));
        if let Some(Given { sensor, file }) = &self.sensor {
            file.iter().chain(&sensor.reference).for_each(|file| outputs.spare(file));
        }
    }

    /// The library's configuration for these options, on whatever device.
    ///
    /// # Errors
    /// [`Exit::Weights`] if there is no weight file.
    pub fn config(&self, savings: Savings) -> Result<Config, Failure> {
        self.config_with(weights(self.weights.as_deref())?, savings)
    }

    /// [`config`](Self::config) with other weights.
    fn config_with(&self, weights: WeightSource, savings: Savings) -> Result<Config, Failure> {
        let mut config = Config::with_weights(weights);
        config.input_size = self.size;
        config.sensor = self.sensor.as_ref().map(|given| given.sensor.clone());
        config.mm_per_pixel = self.mm_per_pixel;
        config.gel = self.gel;
        config.strict_scale = self.strict_scale;
        config.savings = savings;
        config.timeout = self.timeout;
        config.precision = self.precision.unwrap_or_default();
        config.tuned_kernels = folders::tuned();
        Ok(config)
    }
}

impl DetectorArgs {
    /// What may be left out.
    fn savings(&self) -> Savings {
        match (self.exact, &self.leave_out[..]) {
            (true, _) => Savings::NONE,
            (false, []) => Savings::default(),
            (false, savings) => Savings::of(savings),
        }
    }

    /// The library's configuration for these options.
    ///
    /// # Errors
    /// See [`NetworkArgs::config`].
    pub fn config(&self) -> Result<Config, Failure> {
        self.config_with(weights(self.network.weights.as_deref())?)
    }

    /// [`config`](Self::config) with other weights than the options name.
    ///
    /// # Errors
    /// As [`config`](Self::config).
    pub fn config_with(&self, weights: WeightSource) -> Result<Config, Failure> {
        let mut config = self.network.config_with(weights, self.savings())?;
        config.iou = self.boxes.iou;
        config.device = self.device.device.clone();
        Ok(config)
    }
}

/// What to open for `device`, once the drivers were loaded in a process of its own: for `auto` the CPU where
/// that shows no adapter that would do.
///
/// # Errors
/// [`Exit::Device`] where a GPU is asked for and the drivers crash or hang.
fn resolved(device: &Device) -> Result<Device, Failure> {
    match device {
        Device::Cpu | Device::Reference => Ok(device.clone()),
        Device::Gpu(_) => match probe::adapters(probe::PATIENTLY) {
            Ok(_) => Ok(device.clone()),
            Err(why) => Err(Failure::new(Exit::Device, why)),
        },
        Device::Auto => match probe::adapters(probe::BRIEFLY) {
            Ok(found) if found.iter().any(Record::serves) => Ok(Device::Auto),
            Ok(_) => Ok(Device::Cpu),
            Err(why) => {
                remark(format!("{why}; going on with the CPU"));
                Ok(Device::Cpu)
            }
        },
    }
}

/// Builds a detector.
///
/// # Errors
/// What the library returns, and [`Exit::Device`] for drivers that crash or hang.
pub(super) fn open(mut config: Config) -> Result<GpuDetector, Failure> {
    config.device = resolved(&config.device)?;
    let detector = GpuDetector::new(config)?;
    detector.remarks().iter().for_each(remark);
    Ok(detector)
}

/// What was told of assumed scales.
#[derive(Debug, Default)]
pub(super) struct Assumed {
    /// Sizes of pictures of which it was told what is assumed.
    sizes: HashSet<[u32; 2]>,
    /// Whether it was told of a picture without a snap.
    empty: bool,
}

impl Assumed {
    /// What is assumed of a picture, to be told once a size: others of it are most likely of the same sensor;
    /// and once what that may have cost.
    pub fn remarks(&mut self, source: &impl std::fmt::Display, found: &Detections) -> Vec<String> {
        let size = [found.width, found.height];
        let mut remarks = Vec::new();
        if let Some(what) = found.assumption()
            && self.sizes.insert(size)
        {
            let options = match found.scale.from {
                Origin::Assumed => "--sensor, or --mm-per-pixel and --gel, state it",
                _ => "--gel states it",
            };
            remarks.push(format!("{source}: {what}; {options}"));
        }
        let unseen = found.detections.is_empty() && found.contact != Some(false);
        if unseen && found.scale.from == Origin::Assumed && !self.empty {
            self.empty = true;
            remarks.push(format!(
                "{source}: no snap at the assumed scale, at which {:.1} × {:.1} mm are seen; if it shows \
                 one, state the scale",
                found.part.width as f32 * found.scale.mm_per_pixel,
                found.part.height as f32 * found.scale.mm_per_pixel
            ));
        }
        remarks
    }
}

/// Opens a GPU for `device`; `None` stands for the CPU, as in [`open`].
///
/// # Errors
/// As [`open`].
pub(super) fn open_gpu(device: &Device) -> Result<Option<Arc<Gpu>>, Failure> {
    let adapter = match resolved(device)? {
        Device::Gpu(choice) => choice,
        Device::Auto => AdapterChoice::Hardware,
        Device::Cpu | Device::Reference => return Ok(None),
    };
    match pollster::block_on(Gpu::open(GpuOptions { adapter, ..GpuOptions::default() })) {
        Err(Error::NoAdapter { .. }) if *device == Device::Auto => Ok(None),
        other => Ok(Some(other?)),
    }
}

/// The weights that are asked for, or what runs without.
///
/// # Errors
/// [`Exit::Weights`] if there are none.
fn weights(given: Option<&Path>) -> Result<WeightSource, Failure> {
    let catalog = Catalog::from_env();
    if let Some(given) = given {
        return Ok(catalog.find(given)?);
    }
    let (found, note) = catalog.usual()?;
    note.into_iter().for_each(remark);
    Ok(found)
}
