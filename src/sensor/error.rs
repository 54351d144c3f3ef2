use std::path::{Path, PathBuf};

/// What can go wrong while simulating or calibrating a sensor.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A picture could not be decoded or encoded.
    #[error("{path}: {source}")]
    Image {
        /// The picture.
        path: PathBuf,
        /// What the codec said.
        source: image::ImageError,
    },
    /// A file does not hold what it should.
    #[error("{path}: expected {expected}, found {found}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What it should hold.
        expected: String,
        /// What it holds.
        found: String,
    },
    /// A data set was begun with other settings.
    #[error("{path} was made by {found}, not by {expected}; choose another folder")]
    OtherDataset {
        /// The data set's folder.
        path: PathBuf,
        /// The settings asked for.
        expected: String,
        /// The settings found.
        found: String,
    },
    /// No scene could be found that follows the rules.
    #[error("no valid scene for seed {seed} in {attempts} attempts")]
    NoScene {
        /// The scene's seed.
        seed: u64,
        /// Scenes drawn and refused.
        attempts: u32,
    },
}

impl Error {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    pub(crate) fn image(path: &Path) -> impl FnOnce(image::ImageError) -> Self {
        let path = path.to_owned();
        move |source| Self::Image { path, source }
    }
}
