//! Writing files: whole under their name, or not at all.
//!
//! Everything that the program writes goes through here. A file is written under a random name in
//! its folder, synced and renamed into place, so neither a full disk nor a crash leaves a part of
//! it under its name. What has the name already is replaced if it is a regular file that may be
//! written; links are not followed, and folders, links, pipes and devices stay as they are.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::kind;

/// Names of files that are not yet whole begin and end so; a run that is killed leaves one.
const UNFINISHED: [&str; 2] = [".smr-gpu-", ".unfinished"];

/// Why a file was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// By this name or another, the file is one that must stay.
    #[error("{path}: expected a file that is no input or other output of this run, got one")]
    Spared {
        /// The output.
        path: PathBuf,
    },
    /// Something has the name that no output replaces.
    #[error("{path}: expected a free name or a file to replace, got {found}")]
    NotReplaceable {
        /// The output.
        path: PathBuf,
        /// What has its name.
        found: &'static str,
    },
    /// The system refused.
    #[error("{path}: cannot write: {source}")]
    Io {
        /// The output.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// The outputs of a command: they replace none of the files that it spares, nor one another.
#[derive(Debug, Default)]
pub struct Outputs {
    spared: HashSet<FileId>,
}

impl Outputs {
    /// Outputs that replace none of these files, whatever names lead to them. A file that is not
    /// there needs no care.
    pub fn sparing<P: AsRef<Path>>(files: impl IntoIterator<Item = P>) -> Self {
        let spared = files.into_iter().filter_map(|file| FileId::of(file.as_ref()).ok());
        Self { spared: spared.collect() }
    }

    /// Spares one more file.
    pub fn spare(&mut self, file: &Path) {
        self.spared.extend(FileId::of(file).ok());
    }

    /// Whether [`write`](Self::write) may write here: before the work whose result it writes.
    ///
    /// # Errors
    /// As [`write`](Self::write), but for what only writing shows.
    pub fn check(&self, path: &Path) -> Result<(), Error> {
        if FileId::of(path).is_ok_and(|id| self.spared.contains(&id)) {
            return Err(Error::Spared { path: path.to_owned() });
        }
        check(path)
    }

    /// Whether [`write`](Self::write) may write all of these, one after the other.
    ///
    /// # Errors
    /// As [`check`](Self::check), also for the second of two that are one file.
    pub fn check_all<P: AsRef<Path>>(
        &self,
        paths: impl IntoIterator<Item = P>,
    ) -> Result<(), Error> {
        let mut names = HashSet::new();
        for path in paths {
            let path = path.as_ref();
            self.check(path)?;
            // As far as names tell: what is not there yet has no other identity.
            if !names.insert(std::path::absolute(path).unwrap_or_else(|_| path.to_owned())) {
                return Err(Error::Spared { path: path.to_owned() });
            }
        }
        Ok(())
    }

    /// Writes a file, or leaves what was there; from then on it is spared.
    ///
    /// # Errors
    /// [`Error::Spared`] for a file that is spared, [`Error::NotReplaceable`] for a folder, a link, a
    /// pipe, a device or a read-only file, and [`Error::Io`].
    pub fn write(&mut self, path: &Path, bytes: &[u8]) -> Result<(), Error> {
        self.check(path)?;
        write(path, bytes)?;
        self.spare(path);
        Ok(())
    }

    /// Begins a file that is written bit by bit, and has its name once it is [finished](Self::finish).
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn create(&self, path: &Path) -> Result<Unfinished, Error> {
        self.check(path)?;
        Unfinished::create(path)
    }

    /// Gives a file its name; from then on it is spared.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn finish(&mut self, file: Unfinished) -> Result<(), Error> {
        let path = file.path.clone();
        self.check(&path)?;
        file.finish()?;
        self.spare(&path);
        Ok(())
    }
}

/// A file that has not its name yet. It is removed when it is dropped before it has.
#[derive(Debug)]
pub struct Unfinished {
    path: PathBuf,
    file: BufWriter<NamedTempFile<File>>,
}

impl Unfinished {
    fn create(path: &Path) -> Result<Self, Error> {
        let replaced = replaced(path)?;
        let failed = |source| Error::Io { path: path.to_owned(), source };
        let file = unfinished(folder_of(path)).map_err(failed)?;
        if let Some(replaced) = replaced {
            file.as_file().set_permissions(replaced.permissions()).map_err(failed)?;
        }
        Ok(Self { path: path.to_owned(), file: BufWriter::new(file) })
    }

    /// The name that it is to have.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The name that it has, for another program that writes it.
    pub fn own_path(&self) -> &Path {
        self.file.get_ref().path()
    }

    /// Adds bytes at the end.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let written = self.file.write_all(bytes);
        written.map_err(|source| Error::Io { path: self.path.clone(), source })
    }

    fn finish(self) -> Result<(), Error> {
        let Self { path, file } = self;
        replaced(&path)?;
        let failed = |source| Error::Io { path: path.clone(), source };
        let file = file.into_inner().map_err(|e| failed(e.into_error()))?;
        file.as_file().sync_all().map_err(failed)?;
        file.persist(&path).map_err(|e| failed(e.error))?;
        sync_folder(folder_of(&path)).map_err(failed)
    }
}

/// Whether [`write()`] may write here.
///
/// # Errors
/// As [`write()`], but for what only writing shows.
pub fn check(path: &Path) -> Result<(), Error> {
    replaced(path).map(drop)
}

/// Writes a file, or leaves what was there.
///
/// # Errors
/// [`Error::NotReplaceable`] for a folder, a link, a pipe, a device or a read-only file, and
/// [`Error::Io`].
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut file = Unfinished::create(path)?;
    file.write(bytes)?;
    file.finish()
}

pub(super) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// A new file of a random name, with the mode of any new file. It is removed when it is dropped before it has
/// its own name.
pub(super) fn unfinished(folder: &Path) -> io::Result<NamedTempFile<File>> {
    let [prefix, suffix] = UNFINISHED;
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix).suffix(suffix).make_in(folder, |path| File::create_new(path))
}

/// The file that an output of this name replaces.
fn replaced(path: &Path) -> Result<Option<Metadata>, Error> {
    let found = match fs::symlink_metadata(path) {
        Ok(found) => found,
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(Error::Io { path: path.to_owned(), source }),
    };
    let refused = match kind(found.file_type()) {
        Some(other) => other,
        None if found.permissions().readonly() => "a read-only file",
        None => return Ok(Some(found)),
    };
    Err(Error::NotReplaceable { path: path.to_owned(), found: refused })
}

/// Makes the names in a folder last. Where a folder cannot be read or synced, the system decides.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(windows) {
        return Ok(());
    }
    match File::open(folder).and_then(|f| f.sync_all()) {
        Err(e)
            if matches!(
                e.kind(),
                ErrorKind::PermissionDenied | ErrorKind::InvalidInput | ErrorKind::Unsupported
            ) =>
        {
            Ok(())
        }
        other => other,
    }
}

/// Removes what killed runs left unfinished in a folder where nobody else writes now.
///
/// # Errors
/// [`Error::Io`] that names the file.
pub fn remove_unfinished(folder: &Path) -> Result<(), Error> {
    let failed = |path: &Path, source| Error::Io { path: path.to_owned(), source };
    for entry in fs::read_dir(folder).map_err(|e| failed(folder, e))? {
        let entry = entry.map_err(|e| failed(folder, e))?;
        let is_file = entry.file_type().is_ok_and(|t| t.is_file());
        if is_file && is_unfinished(&entry.file_name()) {
            fs::remove_file(entry.path()).map_err(|e| failed(&entry.path(), e))?;
        }
    }
    Ok(())
}

fn is_unfinished(name: &OsStr) -> bool {
    let [prefix, suffix] = UNFINISHED;
    name.to_str().is_some_and(|name| name.starts_with(prefix) && name.ends_with(suffix))
}

/// What tells a file from others, whatever its names: hard links share it, and links lead to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct FileId {
    device: u64,
    index: u64,
}

impl FileId {
    #[cfg(unix)]
    pub fn of(path: &Path) -> io::Result<Self> {
        fs::metadata(path).map(|found| Self::told(&found))
    }

    #[cfg(unix)]
    pub fn of_open(file: &File) -> io::Result<Self> {
        file.metadata().map(|found| Self::told(&found))
    }

    #[cfg(unix)]
    fn told(found: &Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        Self { device: found.dev(), index: found.ino() }
    }

    #[cfg(windows)]
    pub fn of(path: &Path) -> io::Result<Self> {
        Self::told(winapi_util::Handle::from_path_any(path)?)
    }

    #[cfg(windows)]
    pub fn of_open(file: &File) -> io::Result<Self> {
        Self::told(winapi_util::HandleRef::from_file(file))
    }

    #[cfg(windows)]
    fn told(handle: impl winapi_util::AsHandleRef) -> io::Result<Self> {
        let found = winapi_util::file::information(handle)?;
        Ok(Self { device: found.volume_serial_number(), index: found.file_index() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names and contents of a folder.
    fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
        let mut found: Vec<_> = fs::read_dir(folder)
            .expect("a folder")
            .map(|entry| {
                let entry = entry.expect("an entry");
                let name = entry.file_name().into_string().expect("UTF-8");
                (name, fs::read(entry.path()).expect("a file"))
            })
            .collect();
        found.sort();
        found
    }

    #[test]
    fn a_file_that_is_not_finished_leaves_what_was_there() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x");
        let torn = || {
            let mut file = Unfinished::create(&path).expect("begun");
            file.write(&[7; 1 << 20]).expect("a part");
            assert!(file.own_path().exists() && file.own_path() != path);
        };
        torn();
        assert_eq!(contents(folder.path()), []);
        let nowhere = folder.path().join("gone").join("x");
        let error = Unfinished::create(&nowhere).expect_err("no folder");
        assert!(error.to_string().starts_with(&format!("{}: cannot write", nowhere.display())));

        write(&path, b"whole").expect("written");
        torn();
        let panics = std::panic::AssertUnwindSafe(|| {
            let mut file = Unfinished::create(&path).expect("begun");
            file.write(b"a part").expect("a part");
            panic!("in the middle")
        });
        std::panic::catch_unwind(panics).expect_err("a panic");
        assert_eq!(contents(folder.path()), [("x".to_owned(), b"whole".to_vec())]);
        write(&path, b"new").expect("replaced");
        assert_eq!(contents(folder.path()), [("x".to_owned(), b"new".to_vec())]);
    }

    #[test]
    fn what_killed_runs_left_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in [".smr-gpu-AbCdEf.unfinished", "x.unfinished", ".smr-gpu-notes"] {
            fs::write(folder.path().join(name), name).expect("written");
        }
        fs::create_dir(folder.path().join(".smr-gpu-folder.unfinished")).expect("created");
        remove_unfinished(folder.path()).expect("removed");
        fs::remove_dir(folder.path().join(".smr-gpu-folder.unfinished")).expect("it stayed");
        let left: Vec<_> = contents(folder.path()).into_iter().map(|(name, _)| name).collect();
        assert_eq!(left, [".smr-gpu-notes", "x.unfinished"]);
    }

    #[cfg(unix)]
    #[test]
    fn only_regular_files_that_are_no_inputs_are_replaced() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::write(path("input"), "input").expect("written");
        fs::write(path("other"), "other").expect("written");
        fs::hard_link(path("input"), path("hard")).expect("linked");
        symlink("input", path("soft")).expect("linked");
        symlink("other", path("elsewhere")).expect("linked");
        symlink("nothing", path("dangling")).expect("linked");
        fs::create_dir(path("folder")).expect("created");
        fs::write(path("locked"), "locked").expect("written");
        let mut locked = fs::metadata(path("locked")).expect("a file").permissions();
        locked.set_readonly(true);
        fs::set_permissions(path("locked"), locked).expect("set");
        let made = std::process::Command::new("mkfifo").arg(path("pipe")).status();
        assert!(made.expect("mkfifo").success());

        let mut outputs = Outputs::sparing([path("input"), path("gone")]);
        for name in ["input", "hard", "soft"] {
            let error = outputs.write(&path(name), b"lost").expect_err(name);
            assert!(matches!(error, Error::Spared { .. }), "{name}: {error}");
        }
        for (name, phrase) in [
            ("elsewhere", "got a symbolic link"),
            ("dangling", "got a symbolic link"),
            ("folder", "got a folder"),
            ("pipe", "got a named pipe"),
            ("locked", "got a read-only file"),
        ] {
            let error = outputs.write(&path(name), b"lost").expect_err(name).to_string();
            assert!(error.ends_with(phrase), "{error}");
        }
        let error = check(Path::new("/dev/null")).expect_err("a device").to_string();
        assert_eq!(error, "/dev/null: expected a free name or a file to replace, got a device");
        assert_eq!(fs::read(path("input")).expect("kept"), b"input");
        assert_eq!(fs::read(path("other")).expect("kept"), b"other");
        outputs.check_all([path("other"), path("gone")]).expect("two files");
        let error = outputs.check_all([path("gone"), path("gone")]).expect_err("one file");
        assert!(matches!(error, Error::Spared { .. }), "{error}");
        outputs.write(&path("other"), b"new").expect("replaced");
        let mut begun = outputs.create(&path("gone")).expect("begun");
        begun.write(b"new").expect("written");
        outputs.finish(begun).expect("written");
        let error = outputs.write(&path("gone"), b"lost").expect_err("written before");
        assert!(matches!(error, Error::Spared { .. }), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_any_new_file_or_of_the_one_replaced() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let mode = |name: &str| {
            fs::metadata(folder.path().join(name)).expect("a file").permissions().mode()
        };
        fs::write(folder.path().join("usual"), "").expect("written");
        write(&folder.path().join("ours"), b"").expect("written");
        assert_eq!(mode("ours"), mode("usual"));
        let private = fs::Permissions::from_mode(0o600);
        fs::set_permissions(folder.path().join("ours"), private).expect("set");
        write(&folder.path().join("ours"), b"new").expect("written");
        assert_eq!(mode("ours") & 0o777, 0o600);
    }
}
