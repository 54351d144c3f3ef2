//! The kernels that were measured to be fastest on an adapter, as a file keeps them.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::engine::gpu::Gpu;
use crate::engine::lower::KernelChoice;
use crate::error::{Error, Result};
use crate::files;

/// Longest file with a choice: that of the network has some 10 kB.
const MAX_FILE: u64 = 1 << 20;

/// What a choice was measured on; on another it says nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// The adapter's name.
    pub adapter: String,
    /// Its driver, with the version.
    pub driver: String,
    /// This crate's version.
    pub version: String,
}

impl Place {
    /// Where `gpu` is.
    pub fn of(gpu: &Gpu) -> Self {
        let info = gpu.info();
        Self {
            adapter: info.name.clone(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().into(),
            version: env!("CARGO_PKG_VERSION").into(),
        }
    }

    /// A name for its file: letters, digits and `-`.
    pub fn file_name(&self) -> String {
        let text = format!("{} {} {}", self.adapter, self.driver, self.version).to_lowercase();
        let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
        format!("{}.json", words.collect::<Vec<_>>().join("-"))
    }
}

/// A choice and where it was measured, as a file holds them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tuned {
    /// Where.
    pub place: Place,
    /// What was fastest.
    #[serde(rename = "choice")]
    pub kernels: KernelChoice,
}

impl Tuned {
    /// Reads the choice for `gpu`.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is damaged, measured elsewhere, or names kernels that there are not.
    pub fn read(path: &Path, gpu: &Gpu) -> Result<Self> {
        let fail = |message: String| Error::File { file: path.to_owned(), message };
        let bytes = files::read(path, MAX_FILE).map_err(|e| fail(e.to_string()))?;
        let tuned = Self::parse(&bytes).map_err(fail)?;
        if let Some((key, kernel)) = tuned.kernels.unknown() {
            let got = format!("the unknown kernel `{kernel}` for `{key}`");
            return Err(fail(format!("expected a choice of kernels, got {got}")));
        }
        let Place { adapter, driver, version } = &tuned.place;
        match tuned.place == Place::of(gpu) {
            true => Ok(tuned),
            false => Err(fail(format!(
                "expected a choice of kernels, got one of {adapter} ({driver}) in version {version}"
            ))),
        }
    }

    /// Reads the bytes of a choice's file, wherever it was measured.
    ///
    /// # Errors
    /// In words.
    pub fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let text = files::text(bytes).map_err(|e| e.to_string())?;
        serde_json::from_str(text)
            .map_err(|e| format!("expected a choice of kernels, got an error: {e}"))
    }

    /// With what `earlier` says of shapes that this does not name: those of another network, or of another
    /// size of its input.
    pub fn beside(mut self, earlier: Self) -> Self {
        let own = std::mem::replace(&mut self.kernels.by_shape, earlier.kernels.by_shape);
        self.kernels.by_shape.extend(own);
        self
    }

    /// The file's text.
    pub fn to_json(&self) -> String {
        // A map of texts always is.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }
}
