//! Reading a weight file: safetensors, names as in PyTorch's state dict, f16 or f32.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

use half::slice::HalfFloatSliceExt;
use safetensors::{Dtype, SafeTensors};

use crate::engine::lock::lock;
use crate::engine::shape::{Shape, TensorSpec};
use crate::engine::tensor::{Constant, Tensor};
use crate::error::{Error, Result};
use crate::files;
use crate::smr::configuration::ModelConfig;

/// Epsilon of PyTorch's batch norm.
const BN_EPS: f64 = 1e-5;
/// Longest file in bytes: twice that of the network in f32, whose 31 million weights take 124 MB.
pub const MAX_FILE: u64 = 256 << 20;
/// Longest header: that of the network's 289 tensors has 28 kB.
const MAX_HEADER: u64 = 1 << 20;
/// Most tensors in a file.
const MAX_TENSORS: usize = 4096;

/// The tensors of a weight file and its configuration. Building a network takes the tensors out one
/// by one, so what is missing, misshapen or left over is noticed.
///
/// A tensor is read and unpacked when somebody wants its values, and kept by nobody here.
#[derive(Clone)]
pub struct Weights {
    file: PathBuf,
    config: ModelConfig,
    tensors: Source,
}

#[derive(Clone)]
enum Source {
    File(BTreeMap<String, Stored>),
    Random(u32),
}

/// Bytes that somebody holds.
pub type Bytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// Where weights are.
#[derive(Clone)]
pub enum WeightSource {
    /// A safetensors file.
    File(PathBuf),
    /// A safetensors file's bytes, with a name for messages.
    Bytes(PathBuf, Arc<[u8]>),
    /// [`WeightSource::Bytes`] that are part of the program.
    Static(&'static str, &'static [u8]),
}

impl fmt::Debug for WeightSource {
    /// A line, without the bytes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "File({path:?})"),
            Self::Bytes(name, bytes) => write!(f, "Bytes({name:?}, {} bytes)", bytes.len()),
            Self::Static(name, bytes) => write!(f, "Static({name:?}, {} bytes)", bytes.len()),
        }
    }
}

impl WeightSource {
    /// The file; `None` for bytes.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Bytes(..) | Self::Static(..) => None,
        }
    }

    /// The file, or what stands for it in messages.
    pub fn name(&self) -> &Path {
        match self {
            Self::File(name) | Self::Bytes(name, _) => name,
            Self::Static(name, _) => Path::new(name),
        }
    }

    /// All bytes. A file is read; others are not copied.
    ///
    /// # Errors
    /// [`Error::Weights`] for a file that cannot be read, is no regular file or longer than [`MAX_FILE`].
    pub fn bytes(&self) -> Result<Bytes> {
        Ok(match self {
            Self::File(path) => {
                let fail = |e: std::io::Error| Error::Weights {
                    file: path.clone(),
                    message: e.to_string(),
                };
                Arc::new(files::read(path, MAX_FILE).map_err(fail)?)
            }
            Self::Bytes(_, bytes) => Arc::new(bytes.clone()),
            Self::Static(_, bytes) => Arc::new(*bytes),
        })
    }
}

/// Where the bytes of a weight file are.
#[derive(Clone)]
enum Held {
    Memory(Bytes),
    File(Arc<OnDisk>),
}

/// An open file, as it was when all of it was looked at.
struct OnDisk {
    file: Mutex<File>,
    /// For messages.
    name: PathBuf,
    length: u64,
    modified: Option<SystemTime>,
}

impl OnDisk {
    fn fail(&self, message: impl fmt::Display) -> Error {
        Error::Weights { file: self.name.clone(), message: message.to_string() }
    }

    /// The bytes there, if nobody has written to the file since.
    fn read(&self, range: &Range<usize>) -> Result<Vec<u8>> {
        let mut bytes = vec![0; range.len()];
        let mut file = lock(&self.file);
        let read = file.seek(SeekFrom::Start(range.start as u64));
        read.and_then(|_| file.read_exact(&mut bytes)).map_err(|e| self.fail(e))?;
        let now = file.metadata().map_err(|e| self.fail(e))?;
        match (now.len(), now.modified().ok()) == (self.length, self.modified) {
            true => Ok(bytes),
            false => Err(self.fail("expected the file as it was opened, got one written since")),
        }
    }
}

impl Held {
    /// # Errors
    /// [`Error::Weights`] for a file that cannot be read any more, or was written to.
    fn read(&self, range: &Range<usize>) -> Result<Cow<'_, [u8]>> {
        match self {
            Self::Memory(bytes) => Ok((**bytes).as_ref()[range.clone()].into()),
            Self::File(file) => file.read(range).map(Cow::from),
        }
    }
}

/// A tensor as it lies in a weight file.
#[derive(Clone)]
struct Stored {
    held: Held,
    range: Range<usize>,
    half: bool,
    shape: Shape,
    /// The largest absolute value.
    largest: f32,
}

impl Stored {
    /// The tensor, unpacked.
    fn tensor(&self) -> Result<Tensor> {
        let bytes: &[u8] = &self.held.read(&self.range)?;
        if self.half {
            // The tensors of a file need not lie where their elements may.
            let values: Cow<[half::f16]> = match bytemuck::try_cast_slice(bytes) {
                Ok(values) => values.into(),
                Err(_) => bytemuck::pod_collect_to_vec(bytes).into(),
            };
            let mut tensor = Tensor::zeros(self.shape.clone());
            values.convert_to_f32_slice(tensor.data_mut());
            return Ok(tensor);
        }
        Ok(Tensor::from_fn(self.shape.clone(), |i| {
            f32::from_le_bytes(std::array::from_fn(|k| bytes[4 * i + k]))
        }))
    }
}

/// A tensor that was taken out of the weights and not unpacked yet.
#[derive(Clone)]
enum Taken {
    Stored(Stored),
    Random { name: String, shape: Shape, seed: u32 },
}

impl Taken {
    fn shape(&self) -> &Shape {
        match self {
            Self::Stored(stored) => &stored.shape,
            Self::Random { shape, .. } => shape,
        }
    }

    fn tensor(&self) -> Result<Tensor> {
        match self {
            Self::Stored(stored) => stored.tensor(),
            Self::Random { name, shape, seed } => Ok(random_tensor(name, shape.clone(), *seed)),
        }
    }

    /// No absolute value is larger.
    fn largest(&self) -> f32 {
        match self {
            Self::Stored(stored) => stored.largest,
            Self::Random { .. } => 4.0,
        }
    }
}

impl fmt::Debug for Weights {
    /// A line: where they are from, and how many.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.tensors {
            Source::File(tensors) => {
                write!(f, "Weights({}, {} tensors)", self.file.display(), tensors.len())
            }
            Source::Random(seed) => write!(f, "Weights(random, seed {seed})"),
        }
    }
}

/// A convolution with its batch norm folded in: weight `[O, I, kh, kw]`, bias `[O]`.
#[derive(Clone, Debug)]
pub struct Folded {
    /// Weight, scaled by the batch norm.
    pub weight: Constant,
    /// Bias.
    pub bias: Constant,
}

impl Weights {
    /// Reads weights from wherever they are.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn load(source: &WeightSource) -> Result<Self> {
        match source {
            WeightSource::File(path) => Self::open(path),
            WeightSource::Bytes(..) | WeightSource::Static(..) => {
                Self::from_shared(source.name(), source.bytes()?)
            }
        }
    }

    /// Reads a weight file.
    ///
    /// # Errors
    /// [`Error::Weights`] if it cannot be read, is no regular file or longer than [`MAX_FILE`], is
    /// truncated, has no valid `config`, or holds a value that is not finite.
    pub fn open(path: &Path) -> Result<Self> {
        let fail = |e: std::io::Error| Error::Weights { file: path.into(), message: e.to_string() };
        let (file, length) = files::open(path).map_err(fail)?;
        let modified = file.metadata().map_err(fail)?.modified().ok();
        // All of it once, to look at every value; then each tensor when it is wanted.
        let bytes = files::read_open(&file, length, MAX_FILE).map_err(fail)?;
        let held = OnDisk { file: Mutex::new(file), name: path.into(), length, modified };
        Self::parse(path, &bytes, Held::File(Arc::new(held)))
    }

    /// Reads weights from memory; `name` stands for the file in messages.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn from_bytes(name: &Path, bytes: &[u8]) -> Result<Self> {
        Self::from_shared(name, Arc::new(bytes.to_vec()))
    }

    /// [`Weights::from_bytes`] of bytes that are not copied.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn from_shared(name: &Path, shared: Bytes) -> Result<Self> {
        Self::parse(name, (*shared).as_ref(), Held::Memory(shared.clone()))
    }

    fn parse(name: &Path, bytes: &[u8], held: Held) -> Result<Self> {
        let fail = |message: String| Error::Weights { file: name.into(), message };
        check_length(bytes).map_err(fail)?;
        let (_, header) = SafeTensors::read_metadata(bytes)
            .map_err(|e| fail(format!("not a whole safetensors file: {e}")))?;
        let text = header.metadata().as_ref().and_then(|m| m.get("config"));
        let text = text.ok_or_else(|| fail("metadata: expected `config`, got none".into()))?;
        let config = ModelConfig::parse(text).map_err(fail)?;
        let count = header.tensors().len();
        if count > MAX_TENSORS {
            return Err(fail(format!("expected at most {MAX_TENSORS} tensors, got {count}")));
        }
        let parsed = SafeTensors::deserialize(bytes)
            .map_err(|e| fail(format!("not a whole safetensors file: {e}")))?;
        let mut tensors = BTreeMap::new();
        for (tensor_name, view) in parsed.iter() {
            let data = view.data();
            // Of finite floats the larger has the larger bits, but for the sign.
            let (half, largest) = match view.dtype() {
                Dtype::F16 => {
                    let bits = data.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
                    let bits = bits.map(|b| b & 0x7fff).max().unwrap_or(0);
                    (true, half::f16::from_bits(bits).to_f32())
                }
                Dtype::F32 => {
                    let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
                    let bits = data.chunks_exact(4).map(|b| word(b) & 0x7fff_ffff).max();
                    (false, f32::from_bits(bits.unwrap_or(0)))
                }
                other => {
                    let message =
                        format!("tensor `{tensor_name}`: expected F16 or F32, got {other:?}");
                    return Err(fail(message));
                }
            };
            let first = data.as_ptr() as usize - bytes.as_ptr() as usize;
            let stored = Stored {
                held: held.clone(),
                range: first..first + data.len(),
                half,
                shape: Shape(view.shape().to_vec()),
                largest,
            };
            if !largest.is_finite() {
                let tensor = stored.tensor()?;
                let at = tensor.data().iter().position(|v| !v.is_finite()).unwrap_or(0);
                let got = tensor.data()[at];
                let message =
                    format!("tensor `{tensor_name}`: expected finite values, got {got} at {at}");
                return Err(fail(message));
            }
            tensors.insert(tensor_name.to_owned(), stored);
        }
        Ok(Self { file: name.into(), config, tensors: Source::File(tensors) })
    }

    /// Untrained weights for any variant, the same for the same seed on every machine: for tests
    /// and benchmarks, whose subject is not what the network finds. Scaled so that activations
    /// neither vanish nor grow. `weights/training/variants.py` makes the same values.
    pub fn random(config: ModelConfig, seed: u32) -> Self {
        Self { file: "random weights".into(), config, tensors: Source::Random(seed) }
    }

    /// The network's configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    fn fail(&self, message: String) -> Error {
        Error::Weights { file: self.file.clone(), message }
    }

    /// Takes a tensor out.
    ///
    /// # Errors
    /// [`Error::Weights`] if it is missing or has another shape.
    pub fn take(&mut self, name: &str, shape: impl Into<Shape>) -> Result<Tensor> {
        self.take_packed(name, shape)?.tensor()
    }

    fn take_packed(&mut self, name: &str, shape: impl Into<Shape>) -> Result<Taken> {
        let shape = shape.into();
        let tensors = match &mut self.tensors {
            Source::File(tensors) => tensors,
            Source::Random(seed) => {
                return Ok(Taken::Random { name: name.into(), shape, seed: *seed });
            }
        };
        match tensors.remove(name) {
            None => Err(self.fail(format!("tensor `{name}`: expected {shape}, got none"))),
            Some(t) if t.shape != shape => {
                Err(self.fail(format!("tensor `{name}`: expected {shape}, got {}", t.shape)))
            }
            Some(t) => Ok(Taken::Stored(t)),
        }
    }

    /// Takes the convolution `conv` without bias and the batch norm `bn`, and folds them in f64:
    /// with s = γ / √(σ² + ε), weight·s and β − μ·s.
    ///
    /// # Errors
    /// As [`Weights::take`], for a negative variance, and for what overflows when folded.
    pub fn take_folded(&mut self, conv: &str, bn: &str, shape: impl Into<Shape>) -> Result<Folded> {
        let weight = self.take_packed(&format!("{conv}.weight"), shape)?;
        let channels = weight.shape().0[0];
        let gamma = self.take(&format!("{bn}.weight"), [channels])?;
        let beta = self.take(&format!("{bn}.bias"), [channels])?;
        let mean = self.take(&format!("{bn}.running_mean"), [channels])?;
        let var = self.take(&format!("{bn}.running_var"), [channels])?;
        if let Some(v) = var.data().iter().find(|v| **v < 0.0) {
            let message = format!("tensor `{bn}.running_var`: expected at least 0, got {v}");
            return Err(self.fail(message));
        }
        let at = |t: &Tensor, c: usize| f64::from(t.data()[c]);
        let scales: Vec<f64> =
            (0..channels).map(|c| at(&gamma, c) / (at(&var, c) + BN_EPS).sqrt()).collect();
        let bias =
            Tensor::from_fn([channels], |c| (at(&beta, c) - at(&mean, c) * scales[c]) as f32);
        let largest = scales.iter().fold(0.0, |a: f64, s| a.max(s.abs()));
        let safe = ((f64::from(weight.largest()) * largest) as f32).is_finite();
        let spec = TensorSpec::f32(weight.shape().clone());
        let fold = move || {
            let mut weight = weight.tensor()?;
            let per_channel = weight.shape().elements() / channels.max(1);
            for (c, row) in weight.data_mut().chunks_exact_mut(per_channel.max(1)).enumerate() {
                row.iter_mut().for_each(|w| *w = (f64::from(*w) * scales[c]) as f32);
            }
            Ok::<_, Error>(weight)
        };
        // Where no weight can overflow, none is unpacked to look.
        if !safe {
            self.check_finite(&format!("{conv}.weight` with `{bn}"), &fold()?)?;
        }
        self.check_finite(&format!("{conv}.bias` with `{bn}"), &bias)?;
        let weight = Constant::made(spec, move || Ok(fold()?.into()));
        Ok(Folded { weight, bias: bias.into() })
    }

    /// Refuses what overflowed when tensors of the file, each finite, were put together.
    ///
    /// # Errors
    /// [`Error::Weights`] that names `tensor`.
    pub(super) fn check_finite(&self, name: &str, tensor: &Tensor) -> Result<()> {
        match tensor.data().iter().position(|v| !v.is_finite()) {
            None => Ok(()),
            Some(at) => {
                let got = tensor.data()[at];
                Err(self.fail(format!(
                    "tensor `{name}`: expected finite values when folded, got {got} at {at}"
                )))
            }
        }
    }

    /// Takes a layer's weight and bias as they are.
    ///
    /// # Errors
    /// As [`Weights::take`].
    pub fn take_biased(&mut self, layer: &str, shape: impl Into<Shape>) -> Result<Folded> {
        let weight = self.take_packed(&format!("{layer}.weight"), shape)?;
        let bias = self.take(&format!("{layer}.bias"), [weight.shape().0[0]])?;
        let spec = TensorSpec::f32(weight.shape().clone());
        let weight = Constant::made(spec, move || Ok(weight.tensor()?.into()));
        Ok(Folded { weight, bias: bias.into() })
    }

    /// Passes over the tensors whose names begin so.
    pub(super) fn leave(&mut self, prefix: &str) {
        if let Source::File(left) = &mut self.tensors {
            left.retain(|name, _| !name.starts_with(prefix));
        }
    }

    /// Refuses tensors that the network has no place for.
    ///
    /// # Errors
    /// [`Error::Weights`] that names the first and counts them.
    pub fn finish(&self) -> Result<()> {
        let Source::File(left) = &self.tensors else { return Ok(()) };
        match left.keys().next() {
            None => Ok(()),
            Some(name) => {
                let count = left.len();
                let text =
                    format!("tensor `{name}`: expected none of this name ({count} such tensors)");
                Err(self.fail(text))
            }
        }
    }
}

/// Looks at what a safetensors file says of its length before anything is read of it: 8 bytes with
/// the header's, little-endian, then the header.
fn check_length(bytes: &[u8]) -> Result<(), String> {
    if bytes.len() as u64 > MAX_FILE {
        return Err(format!("expected at most {MAX_FILE} bytes, got {}", bytes.len()));
    }
    let header = bytes.first_chunk().map(|length| u64::from_le_bytes(*length));
    match header {
        Some(length) if length > MAX_HEADER => {
            let all = bytes.len();
            Err(format!(
                "not a whole safetensors file: expected a header of at most {MAX_HEADER} bytes, \
                 got {length} in a file of {all}"
            ))
        }
        _ => Ok(()),
    }
}

/// Middle and spread of an untrained vector, by the end of its name. As a training starts: each
/// residual block near the identity, each gate open.
const VECTORS: [(&str, f32, f32); 5] = [
    ("running_var", 1.0, 0.5),
    ("bn2.weight", 0.3, 0.1),
    ("weight", 1.0, 0.2),
    ("channel.fc2.bias", 1.0, 0.1),
    ("spatial.bn.bias", 2.0, 0.1),
];

/// Weights with variance 2 / fan-in (He et al. 2015), and vectors as in [`VECTORS`]. An element is a
/// hash of its tensor's name, its place and the seed, so that any language can make it.
fn random_tensor(name: &str, shape: Shape, seed: u32) -> Tensor {
    // FNV-1a of the name.
    let key = name
        .bytes()
        .fold(0x811c_9dc5 ^ seed, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    let fan_in: usize = shape.0.iter().skip(1).product();
    let (middle, spread) = match shape.rank() {
        1 => VECTORS
            .iter()
            .find(|(end, ..)| name.ends_with(end))
            .map_or((0.0, 0.1), |(_, middle, spread)| (*middle, *spread)),
        _ => (0.0, (6.0 / fan_in as f32).sqrt()),
    };
    Tensor::from_fn(shape, |i| {
        let hash = mix(key.wrapping_add((i as u32).wrapping_mul(0x9e37_79b9)));
        middle + spread * ((hash >> 8) as f32 / (1 << 23) as f32 - 1.0)
    })
}

/// Ettinger and Wellons' lowbias32: every bit of the result depends on every bit of `x`.
fn mix(x: u32) -> u32 {
    let x = (x ^ x >> 16).wrapping_mul(0x7feb_352d);
    let x = (x ^ x >> 15).wrapping_mul(0x846c_a68b);
    x ^ x >> 16
}
