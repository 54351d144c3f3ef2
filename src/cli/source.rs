//! What `detect` is pointed at: files, folders, patterns, stdin.

use std::fmt;
use std::path::{Path, PathBuf};

/// Endings of the picture files that are taken from a folder.
const ENDINGS: [&str; 6] = ["png", "jpg", "jpeg", "bmp", "tif", "tiff"];

/// One picture to read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Source {
    File(PathBuf),
    Stdin,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
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

/// The pictures that an argument names: a file itself, a folder's pictures sorted by name, what a
/// pattern matches, or stdin for `-`.
///
/// # Errors
/// A line that names the argument, if there is nothing.
pub(super) fn expand(argument: &Path) -> Result<Vec<Source>, String> {
    let source = Source::from(argument);
    if source == Source::Stdin {
        return Ok(vec![source]);
    }
    if argument.is_dir() {
        return folder(argument);
    }
    let text = argument.to_string_lossy();
    if !argument.exists() && text.contains(['*', '?', '[']) {
        return pattern(&text);
    }
    // Reading tells why a file cannot be read.
    Ok(vec![source])
}

fn folder(path: &Path) -> Result<Vec<Source>, String> {
    let failed = |e: std::io::Error| format!("{}: {e}", path.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let ending = file.extension().map(|e| e.to_string_lossy().to_lowercase());
        if ending.is_some_and(|e| ENDINGS.contains(&e.as_str())) && file.is_file() {
            files.push(file);
        }
    }
    if files.is_empty() {
        let endings = ENDINGS.join(", ");
        return Err(format!(
            "{}: expected a folder with pictures ({endings}), found none",
            path.display()
        ));
    }
    files.sort();
    Ok(files.into_iter().map(Source::File).collect())
}

fn pattern(text: &str) -> Result<Vec<Source>, String> {
    let paths = glob::glob(text).map_err(|e| format!("{text}: not a pattern: {e}"))?;
    let mut sources = Vec::new();
    for path in paths {
        let path = path.map_err(|e| format!("{text}: {e}"))?;
        match path.is_dir() {
            true => sources.extend(folder(&path)?),
            false => sources.push(Source::File(path)),
        }
    }
    if sources.is_empty() {
        return Err(format!("{text}: expected a pattern that matches files, it matches none"));
    }
    Ok(sources)
}
