//! Messages for people, on stderr.

use std::fmt::Display;
use std::io::Write;
use std::sync::atomic::{AtomicU8, Ordering};

use super::printable::printable;

/// How much is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub(super) enum Level {
    /// What went wrong.
    Quiet,
    /// Remarks too.
    Usual,
    /// What helps to find out where time goes, too.
    Verbose,
}

static LEVEL: AtomicU8 = AtomicU8::new(Level::Usual as u8);

/// Sets how much is told from here on.
pub(super) fn set_level(level: Level) {
    LEVEL.store(level as u8, Ordering::Relaxed);
}

fn is_told(level: Level) -> bool {
    level as u8 <= LEVEL.load(Ordering::Relaxed)
}

/// Tells the user what went wrong, in one line on stderr.
pub(super) fn tell(message: impl Display) {
    // If stderr is gone, nobody is left to be told.
    let _ = writeln!(std::io::stderr(), "smr-gpu: {}", printable(message));
}

/// Tells what is good to know, unless with `--quiet`.
pub(super) fn remark(message: impl Display) {
    if is_told(Level::Usual) {
        tell(message);
    }
}

/// Tells what only `--verbose` asks for.
pub(super) fn detail(message: impl Display) {
    if is_told(Level::Verbose) {
        tell(message);
    }
}
