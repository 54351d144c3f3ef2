//! Which kernel runs what.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::engine::digest::fnv1a;
use crate::engine::kernels::{self, Kernel, Work};
use crate::error::{Error, Result};

/// Which kernel runs an operation on given shapes. What it does not name, it leaves to the order in
/// which the kernels prefer themselves.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KernelChoice {
    /// Kernel by operation and shapes, as [`KernelChoice::key`] writes them.
    pub by_shape: BTreeMap<String, String>,
    /// Kernels that run whatever they fit.
    pub forced: Vec<String>,
}

impl KernelChoice {
    /// The choice that forces one kernel wherever it fits.
    ///
    /// # Errors
    /// [`Error::Param`] for a kernel that does not exist.
    pub fn force(id: &str) -> Result<Self> {
        match kernels::find(id) {
            Some(_) => Ok(Self { forced: vec![id.into()], ..Self::default() }),
            None => {
                let known: Vec<_> = kernels::all().map(|k| k.id()).collect();
                Err(Error::param("choice", "kernel", known.join(", "), format!("`{id}`")))
            }
        }
    }

    /// A kernel that it names and that its operation does not have, and for what.
    pub fn unknown(&self) -> Option<(&str, &str)> {
        let is_of = |op: &str, kernel: &str| kernels::named(op).iter().any(|k| k.id() == kernel);
        let by_shape = self.by_shape.iter().map(|(key, kernel)| (key.as_str(), kernel.as_str()));
        let mut by_shape = by_shape
            .filter(|(key, kernel)| !is_of(key.split(' ').next().unwrap_or_default(), kernel));
        let mut forced = self.forced.iter().filter(|id| kernels::find(id).is_none());
        by_shape.next().or_else(|| forced.next().map(|id| ("all that it fits", id.as_str())))
    }

    /// A number that tells choices apart; equal bits are promised for one choice on one device.
    pub fn digest(&self) -> u64 {
        let pairs = self.by_shape.iter().flat_map(|(key, kernel)| [key, kernel]);
        fnv1a(pairs.chain(&self.forced).flat_map(|text| text.bytes().chain([0])))
    }

    /// An operation with its parameters and shapes, and the precision where that is not f32. One for all
    /// batches: a picture's bits must not depend on those beside it.
    pub fn key(work: &Work) -> String {
        let settings = work.op.settings();
        let settings = settings.iter().map(|(name, value)| format!("{name}={value}"));
        let shapes = work.inputs.iter().map(ToString::to_string);
        let words = settings.chain(shapes).collect::<Vec<_>>().join(" ");
        let precision = if work.precision.is_half() { " f16" } else { "" };
        format!("{} {words}{precision}", work.op.name())
    }

    /// The kernel for `work`.
    ///
    /// # Errors
    /// [`Error::Tensor`] where none fits.
    pub fn kernel(&self, work: &Work) -> Result<&'static dyn Kernel> {
        let fitting = || kernels::of(work.op).map(|all| all.iter().filter(|k| k.fits(work)));
        if let Some(kernel) = fitting()?.find(|k| self.forced.iter().any(|id| id == k.id())) {
            return Ok(*kernel);
        }
        if let Some(id) = self.by_shape.get(&Self::key(work))
            && let Some(kernel) = fitting()?.find(|k| k.id() == id)
        {
            return Ok(*kernel);
        }
        let mut fitting = fitting()?;
        let none = || Error::tensor(work.op.name(), "kernels", "one that fits", "none");
        let preferred = fitting.find(|k| k.preferred(work)).copied();
        preferred.or_else(|| fitting_last(work)).ok_or_else(none)
    }
}

/// The last kernel that fits: the plainest.
fn fitting_last(work: &Work) -> Option<&'static dyn Kernel> {
    kernels::of(work.op).ok()?.iter().rfind(|k| k.fits(work)).copied()
}
