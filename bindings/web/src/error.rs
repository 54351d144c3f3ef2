//! The library's errors as JavaScript's `Error`, whose `name` says which of them it is.

use smr_gpu::Error;

/// What JavaScript catches.
pub type Thrown = js_sys::Error;

/// An error of the library for JavaScript.
pub fn thrown(error: Error) -> Thrown {
    let thrown = js_sys::Error::new(&error.to_string());
    thrown.set_name(name(&error));
    thrown
}

fn name(error: &Error) -> &'static str {
    match error {
        Error::Tensor { .. } => "Tensor",
        Error::Param { .. } => "Param",
        Error::Capacity { .. } => "Capacity",
        Error::Shader { .. } => "Shader",
        Error::NoAdapter { .. } => "NoAdapter",
        Error::Device { .. } => "Device",
        Error::DeviceLost(_) => "DeviceLost",
        Error::Timeout { .. } => "Timeout",
        Error::Driver { .. } => "Driver",
        Error::Weights { .. } => "Weights",
        Error::NoWeights { .. } => "NoWeights",
        Error::Sensor { .. } => "Sensor",
        Error::Scale { .. } => "Scale",
        Error::Picture { .. } => "Picture",
        Error::NotFinite { .. } => "NotFinite",
        Error::Overflow { .. } => "Overflow",
        _ => "Internal",
    }
}
