//! Writing: data to stdout, messages to stderr, files to folders.

use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::exit::{Exit, Failure};
use super::names::shown;
use super::printable::printable;
use super::stdout;

/// A folder's own name, after which what is written of it is called, also where the path ends with `.` or `..`.
pub(super) fn folder_name(path: &Path) -> String {
    let name = |path: &Path| path.file_name().map(shown);
    name(path).or_else(|| name(&path.canonicalize().ok()?)).unwrap_or_default()
}

/// Writes a line for people to stdout.
///
/// # Errors
/// [`Exit::Output`] if it cannot be written, also if stdout was closed from the start; a reader
/// that went away, as `head` does, ends the program quietly with [`Exit::Pipe`].
pub(super) fn line(text: impl Display) -> Result<(), Failure> {
    text_out(format!("{}\n", printable(text)).as_bytes())
}

/// Writes a text to stdout as it is.
///
/// # Errors
/// As [`line`].
pub(super) fn text_out(text: &[u8]) -> Result<(), Failure> {
    to_stdout(|| {
        let mut stdout = std::io::stdout().lock();
        stdout.write_all(text).and_then(|()| stdout.flush())
    })
}

/// Runs what writes to stdout.
///
/// # Errors
/// As [`line`].
pub(super) fn to_stdout(write: impl FnOnce() -> std::io::Result<()>) -> Result<(), Failure> {
    if stdout::was_closed() {
        return Err(Failure::new(Exit::Output, "stdout: closed, nothing can be written"));
    }
    write().map_err(|e| match e.kind() {
        ErrorKind::BrokenPipe => Failure { exit: Exit::Pipe, message: None },
        _ => Failure::new(Exit::Output, format!("stdout: {e}")),
    })
}

/// A bar of so many steps; nothing where stderr is no terminal.
pub(super) fn bar(steps: u64, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template);
    ProgressBar::new(steps).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Counts what goes by, of so many if that is known; nothing where stderr is no terminal, nor where stdout is one,
/// as what is printed there shows how far it is.
pub(super) fn counter(steps: Option<u64>, things: &str) -> ProgressBar {
    if std::io::stdout().is_terminal() {
        return ProgressBar::hidden();
    }
    match steps {
        Some(steps) => {
            bar(steps, &format!("{{pos}}/{{len}} {things} {{wide_bar}} {{per_sec}}, {{eta}} left"))
        }
        None => bar(0, &format!("{{spinner}} {{pos}} {things}, {{per_sec}}")),
    }
}

/// A number of things, in words.
pub(super) fn count(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}

/// Writes a JSON value as one line to stdout; JSON escapes what it must by itself.
///
/// # Errors
/// As [`line`].
pub(super) fn json_line(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value)
        .map_err(|e| Failure::new(Exit::Output, format!("stdout: {e}")))?;
    text_out(format!("{text}\n").as_bytes())
}
