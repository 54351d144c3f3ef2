//! Reading a file that somebody else wrote: a regular one, of a size that was looked at first.

use std::fs::{File, Metadata};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// The bytes of the regular file at `path`, `limit` at most.
///
/// # Errors
/// What the system says; in words for a folder, a pipe, a device or a socket, which is not opened
/// (a pipe would wait for a writer, a device may never end), and for a longer file, of which
/// nothing is read.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    check(&std::fs::metadata(path)?, limit)?;
    let file = File::open(path)?;
    // Another may stand there by now.
    let metadata = file.metadata()?;
    check(&metadata, limit)?;
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    // It may also grow meanwhile.
    file.take(limit + 1).read_to_end(&mut bytes)?;
    check_length(bytes.len() as u64, limit)?;
    Ok(bytes)
}

fn check(metadata: &Metadata, limit: u64) -> Result<()> {
    let kind = metadata.file_type();
    if !kind.is_file() {
        let got = if kind.is_dir() { "a folder" } else { "a pipe, device or socket" };
        return Err(Error::new(ErrorKind::InvalidInput, format!("expected a file, got {got}")));
    }
    check_length(metadata.len(), limit)
}

fn check_length(length: u64, limit: u64) -> Result<()> {
    match length <= limit {
        true => Ok(()),
        false => {
            let message = format!("expected at most {limit} bytes, got {length}");
            Err(Error::new(ErrorKind::FileTooLarge, message))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_looked_at_before_reading() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        std::fs::write(&path, "12345").expect("written");
        assert_eq!(read(&path, 5).expect("five bytes"), b"12345");
        let message = read(&path, 4).expect_err("too long").to_string();
        assert_eq!(message, "expected at most 4 bytes, got 5");
        // A hole of 1 TiB: no memory holds it.
        let file = File::create(&path).expect("created");
        if file.set_len(1 << 40).is_ok() {
            let message = read(&path, 1 << 20).expect_err("too long").to_string();
            assert!(message.ends_with("got 1099511627776"), "{message}");
        }
        let message = read(folder.path(), 5).expect_err("a folder").to_string();
        assert_eq!(message, "expected a file, got a folder");
        assert!(read(&folder.path().join("gone"), 5).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn pipes_devices_and_sockets_are_not_opened() {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).expect("bound");
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo");
        assert!(made.success());
        for path in [Path::new("/dev/zero"), &socket, &pipe] {
            let message = read(path, u64::MAX - 1).expect_err("no file").to_string();
            assert_eq!(message, "expected a file, got a pipe, device or socket");
        }
    }
}
