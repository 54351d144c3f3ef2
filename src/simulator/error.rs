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
    /// A picture could not be read.
    #[error("{path}: {source}")]
    Picture {
        /// The picture.
        path: PathBuf,
        /// What was expected and what came.
        source: crate::picture::Error,
    },
    /// A picture could not be encoded.
    #[error("{path}: {source}")]
    Image {
        /// The picture.
        path: PathBuf,
        /// What the encoder said.
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
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] crate::files::Error),
    /// Another run writes to the data set.
    #[error(
        "{path}: expected a data set that no other run writes to, got one that {} writes to",
        .holder.map_or("another process".to_owned(), |id| format!("process {id}"))
    )]
    Busy {
        /// The data set's folder.
        path: PathBuf,
        /// The process that runs it, if it can be told.
        holder: Option<u32>,
    },
    /// A ball or its scale that cannot be.
    #[error("{what}: expected {least} to {most}, got {value}")]
    Ball {
        /// What of it.
        what: &'static str,
        /// The least it may be.
        least: f64,
        /// The most it may be.
        most: f64,
        /// What it is.
        value: f64,
    },
    /// A sensor that cannot be, or that cannot be simulated.
    #[error(transparent)]
    Sensor(#[from] crate::error::Error),
    /// A part's file does not hold a part that can be pressed.
    #[error("{path}: {source}")]
    Part {
        /// The CAD file or height map.
        path: PathBuf,
        /// What was expected and what came.
        source: super::relief::Error,
    },
    /// Presses do not determine a sensor.
    #[error(
        "{path}: expected presses that determine the {expected} coefficients of each channel, got \
         {pixels} pixels that determine {found}"
    )]
    Undetermined {
        /// The folder of the presses.
        path: PathBuf,
        /// Coefficients of a channel.
        expected: usize,
        /// The fewest that a channel's observations determine in any fit.
        found: usize,
        /// Pixels that all presses show.
        pixels: usize,
    },
    /// A fitted sensor is no better than drawing nothing.
    #[error(
        "expected simulated presses nearer to the real ones than the untouched background, L1 \
         {background:.2}; got {held_out:.2}"
    )]
    PoorFit {
        /// Mean absolute difference of the untouched background from the presses.
        background: f64,
        /// The same of simulated presses.
        held_out: f64,
    },
    /// No scene could be found that follows the rules.
    #[error(
        "expected a scene that shows all of its snaps, got none in {attempts} attempts (its seed is \
         {seed}): what is forced may leave them no room"
    )]
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
