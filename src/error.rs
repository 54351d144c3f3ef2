//! The library's error: what stage or tensor failed, what was expected, what came.

use std::path::PathBuf;

/// Everything that can go wrong in the library.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A tensor has another shape or element type than an operation takes.
    #[error("{op}: tensor `{tensor}`: expected {expected}, got {got}")]
    Tensor {
        /// The operation that refused the tensor.
        op: String,
        /// The tensor's name.
        tensor: String,
        /// What the operation takes.
        expected: String,
        /// What came.
        got: String,
    },
    /// A parameter is out of its range.
    #[error("{op}: parameter `{param}`: expected {expected}, got {got}")]
    Param {
        /// The operation or option that refused the value.
        op: String,
        /// The parameter's name.
        param: String,
        /// The allowed values.
        expected: String,
        /// What came.
        got: String,
    },
    /// A fixed capacity is too small; nothing was dropped silently.
    #[error("{what}: needs {needed}, but only {available} are available")]
    Capacity {
        /// What ran out.
        what: String,
        /// How much was needed.
        needed: u64,
        /// How much there is.
        available: u64,
    },
    /// A shader does not compile or does not match what Rust binds to it.
    #[error("wgsl/{file}:{line}: {message}")]
    Shader {
        /// File name under `wgsl/`.
        file: String,
        /// Line in that file, from 1; 0 where the fault has no line.
        line: u32,
        /// The compiler's words.
        message: String,
    },
    /// No adapter matches the request.
    #[error("no GPU adapter for `{wanted}`: {found}")]
    NoAdapter {
        /// The adapter asked for.
        wanted: String,
        /// What was found instead.
        found: String,
    },
    /// The adapter refused to open a device with the limits the shaders need.
    #[error("adapter `{adapter}` cannot open a device: {message}")]
    Device {
        /// The adapter's name.
        adapter: String,
        /// The driver's words, with required and actual limits.
        message: String,
    },
    /// The device was lost; the detector must be built anew.
    #[error("the GPU device was lost: {0}")]
    DeviceLost(String),
    /// The device did not finish in time.
    #[error("the device did not finish {stage} within {seconds} s")]
    Timeout {
        /// What was waited for.
        stage: String,
        /// The limit.
        seconds: f64,
    },
    /// The driver reported a validation, memory or internal error.
    #[error("{stage}: the GPU driver reports: {message}")]
    Driver {
        /// What was being done.
        stage: String,
        /// The driver's words.
        message: String,
    },
    /// A weight file is damaged or does not fit the network.
    #[error("weights {file}: {message}")]
    Weights {
        /// The file, or a name for weights that came from memory.
        file: PathBuf,
        /// What is wrong, with the tensor's name where one is to blame.
        message: String,
    },
    /// No weights have the name that was asked for.
    #[error(
        "weights: expected `{name}` in one of {}; got none; `smr-gpu weights add FILE --name {name}` adds it",
        listed(.searched)
    )]
    NoWeights {
        /// The name.
        name: String,
        /// The files that could have been it, the nearest first.
        searched: Vec<PathBuf>,
    },
    /// A sensor file is damaged, or a frame cannot be the sensor's.
    #[error("sensor `{sensor}`: {message}")]
    Sensor {
        /// The sensor's name, or its file.
        sensor: String,
        /// What is wrong.
        message: String,
    },
    /// A frame cannot have the scale or the gel that is said of it, or nobody says its scale.
    #[error("{width} × {height} pixels: {message}")]
    Scale {
        /// Width of the frame.
        width: u32,
        /// Height of the frame.
        height: u32,
        /// What is wrong.
        message: String,
    },
    /// A file of another kind cannot be used.
    #[error("{file}: {message}")]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// A picture cannot be used.
    #[error("{file}: {message}")]
    Picture {
        /// The picture's file or name.
        file: String,
        /// What is wrong with it.
        message: String,
    },
    /// The network produced a value that is not a number or is infinite.
    #[error("{stage}: {count} values are not finite")]
    NotFinite {
        /// The tensor's name.
        stage: String,
        /// How many values.
        count: u64,
    },
    /// A device produced such values where the reference, whose sums are in f64, did not.
    #[error(
        "{stage}: {count} values are not finite in {precision}; the reference hides it, in f64"
    )]
    Overflow {
        /// The tensor's name.
        stage: String,
        /// How many values.
        count: u64,
        /// How the device stores maps and weights.
        precision: String,
    },
}

/// Result with the library's [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

fn listed(paths: &[PathBuf]) -> String {
    let paths: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
    paths.join(", ")
}

impl Error {
    /// An [`Error::Tensor`] from anything that prints.
    pub fn tensor(
        op: &str,
        tensor: &str,
        expected: impl std::fmt::Display,
        got: impl std::fmt::Display,
    ) -> Self {
        Self::Tensor {
            op: op.into(),
            tensor: tensor.into(),
            expected: expected.to_string(),
            got: got.to_string(),
        }
    }

    /// An [`Error::Param`] from anything that prints.
    pub fn param(
        op: &str,
        param: &str,
        expected: impl std::fmt::Display,
        got: impl std::fmt::Display,
    ) -> Self {
        Self::Param {
            op: op.into(),
            param: param.into(),
            expected: expected.to_string(),
            got: got.to_string(),
        }
    }
}
