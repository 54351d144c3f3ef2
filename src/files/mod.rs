//! Files: reading those that somebody else wrote, and writing the program's own.
//!
//! Everything that is read from a path or written to one goes through here. What only looks like a
//! file (a folder, a pipe, a device, a socket) is named and refused, not opened: a pipe would wait
//! for its other end, a device may never end. Pipes that are open already do serve for pictures.
//! Several runs share a list of files by [`Shard`]s.

#[cfg(feature = "simulator")]
mod lock;
mod read;
#[cfg(feature = "simulator")]
mod shard;
#[cfg(feature = "simulator")]
mod write;

#[cfg(feature = "simulator")]
pub use lock::{Held, Lock, Sharing, lock};
#[cfg(feature = "picture")]
pub use read::open_or_pipe;
pub use read::{open, read, read_open, text};
#[cfg(feature = "simulator")]
pub use shard::{NoShard, Shard};
#[cfg(feature = "simulator")]
pub use write::{Error, Outputs, Unfinished, check, remove_unfinished, write};

use std::fs::FileType;

/// What a thing is if it is no regular file.
fn kind(of: FileType) -> Option<&'static str> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if of.is_fifo() {
            return Some("a named pipe");
        }
        if of.is_char_device() || of.is_block_device() {
            return Some("a device");
        }
        if of.is_socket() {
            return Some("a socket");
        }
    }
    match of {
        of if of.is_symlink() => Some("a symbolic link"),
        of if of.is_dir() => Some("a folder"),
        of if of.is_file() => None,
        _ => Some("something else"),
    }
}
