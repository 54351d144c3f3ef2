//! The library's errors as the exceptions of `smr_gpu.errors`, with their fields as attributes.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use smr_gpu::Error;

/// The exception for an error of the library.
pub fn raised(py: Python<'_>, error: Error) -> PyErr {
    exception(py, error).unwrap_or_else(|e| e)
}

fn exception(py: Python<'_>, error: Error) -> PyResult<PyErr> {
    let message = error.to_string();
    let fields = PyDict::new(py);
    /// Sets each named field, and gives the class's name.
    macro_rules! with {
        ($class:literal $(, $field:ident)*) => {{
            $(fields.set_item(stringify!($field), $field)?;)*
            $class
        }};
    }
    let class = match error {
        Error::Tensor { op, tensor, expected, got } => {
            with!("TensorError", op, tensor, expected, got)
        }
        Error::Param { op, param, expected, got } => {
            with!("ParamError", op, param, expected, got)
        }
        Error::Capacity { what, needed, available } => {
            with!("CapacityError", what, needed, available)
        }
        Error::Shader { file, line, .. } => with!("ShaderError", file, line),
        Error::NoAdapter { wanted, found } => with!("NoAdapterError", wanted, found),
        Error::Device { adapter, .. } => with!("DeviceError", adapter),
        Error::DeviceLost(_) => "DeviceLostError",
        Error::Timeout { stage, seconds } => with!("TimeoutError", stage, seconds),
        Error::Driver { stage, .. } => with!("DriverError", stage),
        Error::Weights { file, .. } => with!("WeightsError", file),
        Error::NoWeights { name, searched } => with!("NoWeightsError", name, searched),
        Error::Sensor { sensor, .. } => with!("SensorError", sensor),
        Error::Scale { width, height, .. } => with!("ScaleError", width, height),
        Error::File { file, .. } => with!("FileError", file),
        Error::Picture { file, .. } => with!("PictureError", file),
        Error::NotFinite { stage, count } => with!("NotFiniteError", stage, count),
        Error::Overflow { stage, count, precision } => {
            with!("OverflowError", stage, count, precision)
        }
        _ => "Error",
    };
    new(py, class, message, Some(&fields))
}

/// The exception for a detector in a forked process.
pub fn forked(py: Python<'_>, owner: u32, own: u32) -> PyErr {
    let message = format!(
        "process {own}: expected the process that built the detector, {owner}, got one forked from it, without \
         its threads; use the start method `spawn`, or build the first detector after the fork"
    );
    new(py, "ForkError", message, None).unwrap_or_else(|e| e)
}

fn new(
    py: Python<'_>,
    class: &str,
    message: String,
    fields: Option<&Bound<'_, PyDict>>,
) -> PyResult<PyErr> {
    let class = py.import("smr_gpu.errors")?.getattr(class)?;
    Ok(PyErr::from_value(class.call((message,), fields)?))
}
