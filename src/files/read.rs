//! Reading a file that somebody else wrote: a regular one, of a size that was looked at first.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

use super::kind;

/// Opens the regular file at `path`; with its length in bytes.
///
/// # Errors
/// What the system says; [`ErrorKind::InvalidInput`] for what is no regular file, which is not
/// opened.
pub fn open(path: &Path) -> Result<(File, u64)> {
    check(&std::fs::metadata(path)?)?;
    open_file(path)
}

/// [`open`] that also takes a pipe that this process has open already, such as `/dev/stdin` or what
/// a shell puts for `<(command)`; its length is 0.
///
/// # Errors
/// As [`open`].
#[cfg(feature = "picture")]
pub fn open_or_pipe(path: &Path) -> Result<(File, u64)> {
    #[cfg(unix)]
    if std::os::unix::fs::FileTypeExt::is_fifo(&std::fs::metadata(path)?.file_type())
        && is_own_descriptor(path)
    {
        return Ok((File::open(path)?, 0));
    }
    open(path)
}

/// Whether the path names one of this process's descriptors. To open another pipe would wait for
/// its other end.
#[cfg(all(unix, feature = "picture"))]
fn is_own_descriptor(path: &Path) -> bool {
    let mut path = path.to_path_buf();
    let folders = ["/dev/fd", "/proc/self/fd"].map(std::fs::canonicalize);
    // As many links as systems follow.
    for _ in 0..40 {
        let folder = path.parent().and_then(|folder| folder.canonicalize().ok());
        if folder.is_some_and(|f| folders.iter().flatten().any(|own| *own == f)) {
            return true;
        }
        match path.read_link() {
            Ok(target) => path = path.parent().unwrap_or(Path::new("")).join(target),
            Err(_) => return false,
        }
    }
    false
}

fn open_file(path: &Path) -> Result<(File, u64)> {
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

/// The bytes of the regular file at `path`, `limit` at most.
///
/// # Errors
/// As [`open`]; [`ErrorKind::FileTooLarge`] for a longer file, of which nothing is read.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let (file, length) = open(path)?;
    read_open(&file, length, limit)
}

/// [`read`] of a file that [`open`] opened, from where it stands.
///
/// # Errors
/// As [`read`].
pub fn read_open(file: &File, length: u64, limit: u64) -> Result<Vec<u8>> {
    check_length(length, limit)?;
    let mut bytes = Vec::with_capacity(length as usize);
    // It may grow meanwhile.
    file.take(limit + 1).read_to_end(&mut bytes)?;
    check_length(bytes.len() as u64, limit)?;
    Ok(bytes)
}

/// A file's bytes as text, without the byte order mark that some editors put before it.
///
/// # Errors
/// [`ErrorKind::InvalidData`] for what is no UTF-8; UTF-16 is named, since a shell may write it unasked.
pub fn text(bytes: &[u8]) -> Result<&str> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    std::str::from_utf8(bytes).map_err(|e| {
        let got = match bytes {
            [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => "UTF-16".to_owned(),
            _ => format!("something else from byte {} on", e.valid_up_to()),
        };
        Error::new(ErrorKind::InvalidData, format!("expected text in UTF-8, got {got}"))
    })
}

fn check(metadata: &Metadata) -> Result<()> {
    match kind(metadata.file_type()) {
        None => Ok(()),
        Some(got) => {
            Err(Error::new(ErrorKind::InvalidInput, format!("expected a file, got {got}")))
        }
    }
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

    #[test]
    fn text_is_utf_8_with_or_without_a_mark() {
        assert_eq!(text(b"{}").expect("text"), "{}");
        assert_eq!(text("\u{feff}µ".as_bytes()).expect("text"), "µ");
        for (bytes, got) in [
            (&b"\xff\xfe{\0}\0"[..], "UTF-16"),
            (b"\xfe\xff\0{\0}", "UTF-16"),
            (b"ab\xff", "something else from byte 2 on"),
        ] {
            let message = text(bytes).expect_err("no text").to_string();
            assert_eq!(message, format!("expected text in UTF-8, got {got}"));
        }
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
        let paths =
            [(Path::new("/dev/zero"), "a device"), (&socket, "a socket"), (&pipe, "a named pipe")];
        for (path, kind) in paths {
            let message = read(path, u64::MAX - 1).expect_err("no file").to_string();
            assert_eq!(message, format!("expected a file, got {kind}"));
        }
    }
}
