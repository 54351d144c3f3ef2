//! What `detect` and `compare` are pointed at: files, folders, patterns, stdin, videos, cameras, network streams.

pub(super) mod frame;
mod queue;
pub(super) mod reader;
mod video;

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};

use image::DynamicImage;
use smr_gpu::picture::{self, ENDINGS, has_ending};

use super::exit::{Exit, Failure};
use super::message::tell;
use super::names::{base64, shown};
use super::printable::printable;

/// One picture to read, or frames one after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Source {
    File(PathBuf),
    Stdin,
    /// A file that ffmpeg reads.
    Video(PathBuf),
    /// What ffmpeg opens by its name: a camera, a stream of a network.
    Live(OsString),
}

/// Endings of videos' names, in small letters.
const VIDEO_ENDINGS: [&str; 17] = [
    "mp4", "m4v", "mov", "mkv", "webm", "avi", "mpg", "mpeg", "ts", "mts", "wmv", "flv", "3gp",
    "ogv", "mjpg", "mjpeg", "y4m",
];
/// How the names of Linux's cameras begin.
const CAMERA: &str = "/dev/video";
/// Characters of a `#` and a frame's number in a table.
const NUMBER: usize = 5;

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => f.pad(&shown(path.as_os_str())),
            Self::Video(path) => f.pad(&shown(path.as_os_str())),
            Self::Live(name) => f.pad(&without_password(&shown(name))),
            Self::Stdin => f.pad("-"),
        }
    }
}

impl From<&Path> for Source {
    fn from(argument: &Path) -> Self {
        let text = argument.to_string_lossy();
        let ending = argument.extension().map(|e| e.to_string_lossy().to_lowercase());
        if text == "-" {
            Self::Stdin
        } else if text.starts_with(CAMERA) || scheme(&text).is_some() {
            Self::Live(argument.into())
        } else if ending.is_some_and(|e| VIDEO_ENDINGS.contains(&e.as_str())) {
            Self::Video(argument.into())
        } else {
            Self::File(argument.into())
        }
    }
}

/// The protocol of a network stream's name.
fn scheme(text: &str) -> Option<&str> {
    let (scheme, _) = text.split_once("://")?;
    let is_one = scheme.len() > 1 && scheme.chars().all(|c| c.is_ascii_alphanumeric() || c == '+');
    is_one.then_some(scheme)
}

/// The name of a network stream without the user's name and password in it.
fn without_password(text: &str) -> String {
    let shown = scheme(text).and_then(|scheme| {
        let rest = &text[scheme.len() + 3..];
        let host = rest.find(['/', '?', '#']).unwrap_or(rest.len());
        let (_, host_and_rest) = rest.split_at(rest[..host].rfind('@')?);
        Some(format!("{scheme}://…{host_and_rest}"))
    });
    shown.unwrap_or_else(|| text.to_owned())
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
            Self::Video(_) | Self::Live(_) => return Err("expected a picture, got a video".into()),
        };
        result.map_err(|e| e.to_string())
    }

    /// [`base64`] of the file's name.
    pub fn base64(&self) -> Option<String> {
        match self {
            Self::File(path) | Self::Video(path) => base64(path.as_os_str()),
            Self::Live(name) => base64(name),
            Self::Stdin => None,
        }
    }

    /// The file that is read, which no output may replace.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) | Self::Video(path) => Some(path),
            // Where this is a file, it is as much an input.
            Self::Stdin => Some(Path::new("/dev/stdin")),
            Self::Live(_) => None,
        }
    }

    /// What files that are made of it are called, before its frame's number, where no other is called so.
    fn stem(&self) -> String {
        let stem = match self {
            Self::File(path) | Self::Video(path) => path.file_stem().map(shown),
            Self::Stdin => Some("stdin".into()),
            Self::Live(_) => {
                let name = self.to_string();
                let name = name.rsplit_once("://").map_or(&name[..], |(_, name)| name);
                let plain = |c: char| if c.is_alphanumeric() || "-.".contains(c) { c } else { '_' };
                Some(name.trim_matches(['/', '…', '@']).chars().map(plain).collect())
            }
        };
        stem.filter(|stem| !stem.is_empty()).unwrap_or_else(|| "picture".into())
    }
}

/// Each source with its name for files that are made of it: its stem, with a number where one before it has that.
/// So a name says nothing of what was found in others.
fn named(sources: Vec<Source>) -> impl Iterator<Item = (Source, String)> {
    let (mut taken, mut numbers) = (HashSet::new(), HashMap::<_, u32>::new());
    sources.into_iter().map(move |source| {
        let stem = source.stem();
        let number = numbers.entry(stem.clone()).or_default();
        loop {
            *number += 1;
            let name = match *number {
                1 => stem.clone(),
                n => format!("{stem}-{n}"),
            };
            if taken.insert(name.clone()) {
                return (source, name);
            }
        }
    })
}

/// What all of a command's arguments name. What cannot be read is told; then the exit code is
/// [`Exit::Inputs`]. Of folders within folders only where it goes `deep`.
///
/// # Errors
/// [`Exit::Usage`] if stdin is named more than once.
pub(super) fn expand_all(
    arguments: &[PathBuf],
    deep: bool,
) -> Result<(Vec<Source>, Exit), Failure> {
    let mut exit = Exit::Done;
    let mut sources = Vec::new();
    for found in arguments.iter().flat_map(|argument| expand(argument, deep)) {
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
    let longest = sources.iter().map(|source| {
        let number = if matches!(source, Source::File(_)) { 0 } else { NUMBER };
        printable(source).chars().count() + number
    });
    let longest = longest.max();
    longest.unwrap_or(0).clamp(4, 48)
}

/// The pictures that an argument names: a file itself, a folder's pictures sorted by name, what a
/// pattern matches, or stdin for `-`. What cannot be listed is a line that names it.
fn expand(argument: &Path, deep: bool) -> Vec<Result<Source, String>> {
    if argument.is_dir() {
        return folder(argument, deep);
    }
    let source = Source::from(argument);
    if let Source::Stdin | Source::Live(_) = source {
        return vec![Ok(source)];
    }
    // A link that leads nowhere is there, too.
    let is_there = argument.symlink_metadata().is_ok();
    let text = shown(argument.as_os_str());
    if !is_there && text.contains(['*', '?', '[']) {
        return match argument.to_str() {
            Some(text) => pattern(text, deep),
            None => vec![Err(format!("{text}: expected a pattern in UTF-8, got another"))],
        };
    }
    // Reading tells why a file cannot be read.
    vec![Ok(source)]
}

fn folder(path: &Path, deep: bool) -> Vec<Result<Source, String>> {
    let (files, failures) = files_of(path, deep);
    if files.is_empty() && failures.is_empty() {
        let endings = ENDINGS.join(", ");
        return vec![Err(format!(
            "{}: expected a folder with pictures ({endings}), found none",
            path.display()
        ))];
    }
    files
        .into_iter()
        .map(|file| Ok(Source::File(file)))
        .chain(failures.into_iter().map(Err))
        .collect()
}

/// A folder's pictures by name, those of its folders behind them, and what could not be listed.
fn files_of(path: &Path, deep: bool) -> (Vec<PathBuf>, Vec<String>) {
    let failed = |e: std::io::Error| format!("{}: {e}", path.display());
    let entries = match std::fs::read_dir(path) {
        Ok(entries) => entries,
        Err(e) => return (Vec::new(), vec![failed(e)]),
    };
    let (mut files, mut folders, mut failures) = (Vec::new(), Vec::new(), Vec::new());
    for entry in entries {
        match entry {
            // A link to a folder may lead back up.
            Ok(entry) if entry.file_type().is_ok_and(|kind| kind.is_dir()) => {
                folders.push(entry.path())
            }
            Ok(entry) => files.push(entry.path()),
            Err(e) => failures.push(failed(e)),
        }
    }
    // Reading tells what is wrong with one that is no file.
    files.retain(|file| has_ending(file) && !file.is_dir());
    files.sort();
    folders.sort();
    for below in folders.iter().filter(|_| deep) {
        let (more, failed) = files_of(below, deep);
        files.extend(more);
        failures.extend(failed);
    }
    (files, failures)
}

fn pattern(text: &str, deep: bool) -> Vec<Result<Source, String>> {
    let paths = match glob::glob(text) {
        Ok(paths) => paths,
        Err(e) => return vec![Err(format!("{text}: not a pattern: {e}"))],
    };
    let mut sources = Vec::new();
    for path in paths {
        match path {
            Ok(path) if path.is_dir() => sources.extend(folder(&path, deep)),
            Ok(path) => sources.push(Ok(Source::from(path.as_path()))),
            Err(e) => sources.push(Err(format!("{text}: {e}"))),
        }
    }
    if sources.is_empty() {
        let message = format!("{text}: expected a pattern that matches files, it matches none");
        sources.push(Err(message));
    }
    sources
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_reads_them() {
        let of = |name: &str| Source::from(Path::new(name));
        assert_eq!(of("a/b.MP4"), Source::Video("a/b.MP4".into()));
        for name in ["/dev/video0", "rtsp://camera/1", "http://host/x.png"] {
            assert_eq!(of(name), Source::Live(name.into()));
        }
        for name in ["x.png", "x", "c://x.png", "a b://x", "/dev/null"] {
            assert_eq!(of(name), Source::File(name.into()), "{name}");
        }
    }

    #[test]
    fn no_two_sources_give_their_files_one_name() {
        let of = |names: &[&str]| {
            let sources = names.iter().map(|name| Source::from(Path::new(name))).collect();
            named(sources).map(|(_, name)| name).collect::<Vec<_>>()
        };
        let names = ["a/x.png", "b/x.jpg", "x-2.png", "x.mp4", "-", "stdin.png"];
        assert_eq!(of(&names), ["x", "x-2", "x-2-2", "x-3", "stdin", "stdin-2"]);
    }

    #[test]
    fn passwords_are_not_shown() {
        let shown = |name: &str| Source::Live(name.into()).to_string();
        assert_eq!(shown("rtsp://me:s3@cret@host:554/a@b"), "rtsp://…@host:554/a@b");
        assert_eq!(shown("rtsp://host/a@b"), "rtsp://host/a@b");
        assert_eq!(
            Source::Live("rtsp://me:x@host:554/live one".into()).stem(),
            "host_554_live_one"
        );
        assert_eq!(Source::Live("/dev/video0".into()).stem(), "dev_video0");
    }
}
