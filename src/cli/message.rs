//! Messages for people, on stderr.

use std::fmt::Display;
use std::io::Write;

use super::printable::printable;

/// Tells the user something on stderr, in one line.
pub(super) fn tell(message: impl Display) {
    // If stderr is gone, nobody is left to be told.
    let _ = writeln!(std::io::stderr(), "smr-gpu: {}", printable(message));
}
