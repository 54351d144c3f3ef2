//! Opening a file that is one.

use std::fs::{File, FileType, Metadata, OpenOptions};
use std::path::Path;

use super::Error;

/// The file and its length in bytes.
///
/// # Errors
/// [`Error::NotAFile`] for what only looks like a file; it is not opened.
pub(super) fn open(path: &Path) -> Result<(File, u64), Error> {
    check(&std::fs::metadata(path)?)?;
    let mut options = OpenOptions::new();
    options.read(true);
    // If a pipe took the file's place since, opening it does not wait for a writer.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(
        &mut options,
        rustix::fs::OFlags::NONBLOCK.union(rustix::fs::OFlags::NOCTTY).bits() as i32,
    );
    let file = options.open(path)?;
    let metadata = file.metadata()?;
    check(&metadata)?;
    Ok((file, metadata.len()))
}

fn check(metadata: &Metadata) -> Result<(), Error> {
    match metadata.is_file() {
        true => Ok(()),
        false => Err(Error::NotAFile(kind(metadata.file_type()))),
    }
}

fn kind(of: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if of.is_fifo() {
            return "a pipe";
        }
        if of.is_socket() {
            return "a socket";
        }
        if of.is_char_device() || of.is_block_device() {
            return "a device";
        }
    }
    match of.is_dir() {
        true => "a folder",
        false => "something else",
    }
}
