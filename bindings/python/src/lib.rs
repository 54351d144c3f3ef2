//! The library `smr_gpu` for Python: what the package in `python/smr_gpu` stands on.
//!
//! | file | what it holds |
//! |---|---|
//! | `errors` | the library's errors as Python's exceptions |
//! | `process` | values that a forked process must not touch |
//! | `picture` | pictures that Python gives, as frames |
//! | `options` | a detector's options, as the library's configuration |
//! | `found` | what a detector finds, as a dictionary |
//! | `detector` | the detector, streams and cameras |

mod detector;
mod errors;
mod found;
mod options;
mod picture;
mod process;

/// The compiled part of the package `smr_gpu`; unstable.
#[pyo3::pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use crate::detector::{Camera, Detector, Stream};
}
