//! What `detect` and `compare` are pointed at: files, folders, patterns, stdin.

use std::fmt;
use std::path::{Path, PathBuf};

use image::DynamicImage;
use smr_gpu::picture::{self, ENDINGS, has_ending};

use super::exit::{Exit, Failure};
use super::message::tell;
use super::names::{base64, shown};
use super::printable::printable;

/// One picture to read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Source {
    File(PathBuf),
    Stdin,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => f.pad(&shown(path.as_os_str())),
            Self::Stdin => f.pad("-"),
        }
    }
}

impl From<&Path> for Source {
    fn from(argument: &Path) -> Self {
        match argument == Path::new("-") {
            true => Self::Stdin,
            false => Self::File(argument.into()),
        }
    }
}

impl Source {
    /// Reads its PNG, JPEG, BMP or TIFF picture and turns it upright as its orientation says.
    ///
    /// # Errors
    /// What was expected and what came, without the picture's name.
    pub fn picture(&self) -> Result<DynamicImage, String> {
        let result = match self {
            Self::File(path) => picture::read(path),
            Self::Stdin => picture::read_from(std::io::stdin().lock()),
        };
        result.map_err(|e| e.to_string())
    }

    /// [`base64`] of the file's name.
    pub fn base64(&self) -> Option<String> {
        match self {
            Self::File(path) => base64(path.as_os_str()),
            Self::Stdin => None,
        }
    }
}

/// What all of a command's arguments name. What cannot be read is told; then the exit code is
/// [`Exit::Inputs`].
///
/// # Errors
/// [`Exit::Usage`] if stdin is named more than once.
pub(super) fn expand_all(arguments: &[PathBuf]) -> Result<(Vec<Source>, Exit), Failure> {
    let mut exit = Exit::Done;
    let mut sources = Vec::new();
    for found in arguments.iter().flat_map(|argument| expand(argument)) {
        match found {
            Ok(source) => sources.push(source),
            Err(message) => {
                tell(message);
                exit = Exit::Inputs;
            }
        }
    }
    if sources.iter().filter(|s| **s == Source::Stdin).count() > 1 {
        return Err(Failure::usage("`-`: expected once, got it several times"));
    }
    Ok((sources, exit))
}

/// Characters of the column of a table that names the sources; longer names push their line.
pub(super) fn column_width(sources: &[Source]) -> usize {
    let longest = sources.iter().map(|s| printable(s).chars().count()).max();
    longest.unwrap_or(0).clamp(4, 48)
}

/// The pictures that an argument names: a file itself, a folder's pictures sorted by name, what a
/// pattern matches, or stdin for `-`. What cannot be listed is a line that names it.
fn expand(argument: &Path) -> Vec<Result<Source, String>> {
    let source = Source::from(argument);
    if source == Source::Stdin {
        return vec![Ok(source)];
    }
    if argument.is_dir() {
        return folder(argument);
    }
    // A link that leads nowhere is there, too.
    let is_there = argument.symlink_metadata().is_ok();
    let text = shown(argument.as_os_str());
    if !is_there && text.contains(['*', '?', '[']) {
        return match argument.to_str() {
            Some(text) => pattern(text),
            None => vec![Err(format!("{text}: expected a pattern in UTF-8, got another"))],
        };
    }
    // Reading tells why a file cannot be read.
    vec![Ok(source)]
}

fn folder(path: &Path) -> Vec<Result<Source, String>> {
    let failed = |e: std::io::Error| Err(format!("{}: {e}", path.display()));
    let entries = match std::fs::read_dir(path) {
        Ok(entries) => entries,
        Err(e) => return vec![failed(e)],
    };
    let mut files = Vec::new();
    let mut failures = Vec::new();
    for entry in entries {
        match entry {
            Ok(entry) => files.push(entry.path()),
            Err(e) => failures.push(failed(e)),
        }
    }
    // Reading tells what is wrong with one that is no file.
    files.retain(|file| has_ending(file) && !file.is_dir());
    if files.is_empty() && failures.is_empty() {
        let endings = ENDINGS.join(", ");
        return vec![Err(format!(
            "{}: expected a folder with pictures ({endings}), found none",
            path.display()
        ))];
    }
    files.sort();
    files.into_iter().map(|file| Ok(Source::File(file))).chain(failures).collect()
}

fn pattern(text: &str) -> Vec<Result<Source, String>> {
    let paths = match glob::glob(text) {
        Ok(paths) => paths,
        Err(e) => return vec![Err(format!("{text}: not a pattern: {e}"))],
    };
    let mut sources = Vec::new();
    for path in paths {
        match path {
            Ok(path) if path.is_dir() => sources.extend(folder(&path)),
            Ok(path) => sources.push(Ok(Source::File(path))),
            Err(e) => sources.push(Err(format!("{text}: {e}"))),
        }
    }
    if sources.is_empty() {
        let message = format!("{text}: expected a pattern that matches files, it matches none");
        sources.push(Err(message));
    }
    sources
}
