//! Locks on folders: a file that one process at a time holds, with its number inside, or several that share it.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read, Write};
use std::path::Path;

use super::write::{Error, FileId, check, unfinished};
use super::{open, write};

/// Longest lock in bytes: a process's number.
const LONGEST: u64 = 16;

/// A lock that is held until this is dropped.
#[derive(Debug)]
pub struct Held(File);

impl Drop for Held {
    /// Closing is not enough: a process that is being started has this one's files too, until it is a program of
    /// its own.
    fn drop(&mut self) {
        // Where that fails the lock ends with the file.
        let _ = self.0.unlock();
    }
}

/// Whether a lock was to be had.
#[derive(Debug)]
pub enum Lock {
    /// It is.
    Held(Held),
    /// Another holds it: the process, if that can be told, which it cannot of several.
    Busy(Option<u32>),
}

/// With whom a lock is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// With nobody.
    Alone,
    /// With others that share it.
    WithOthers,
}

/// Takes the lock at `path` for this process.
///
/// What has that name already is only read: a lock that an earlier run left gives its name to a new file,
/// and what is no lock stays.
///
/// # Errors
/// [`Error::NotReplaceable`] for what is no lock, and [`Error::Io`].
pub fn lock(path: &Path, sharing: Sharing) -> Result<Lock, Error> {
    let failed = |source| Error::Io { path: path.to_owned(), source };
    loop {
        check(path)?;
        let earlier = match open(path) {
            Ok((file, _)) => Some(file),
            Err(e) if e.kind() == ErrorKind::NotFound => None,
            Err(e) => return Err(failed(e)),
        };
        if let Some(file) = &earlier {
            let taken = match sharing {
                Sharing::Alone => file.try_lock(),
                Sharing::WithOthers => file.try_lock_shared(),
            };
            // Windows lets nobody read what another has locked.
            let mut text = String::new();
            let read = file.take(LONGEST).read_to_string(&mut text);
            let number = read.ok().and_then(|_| text.trim().parse().ok());
            match taken {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    // Those that share it did not write it.
                    let is_shared = file.try_lock_shared().is_ok();
                    return Ok(Lock::Busy(number.filter(|_| !is_shared)));
                }
                Err(TryLockError::Error(e)) => return Err(failed(e)),
            }
            // Another run may have given the name to its own since.
            if !FileId::of(path).is_ok_and(|now| FileId::of_open(file).is_ok_and(|id| id == now)) {
                continue;
            }
            // A run that was killed early leaves an empty one.
            if number.is_none() && !text.is_empty() {
                let found = "a file that is no lock of an earlier run";
                return Err(Error::NotReplaceable { path: path.to_owned(), found });
            }
        }
        let earlier = match (earlier, sharing) {
            // Others hold it by the name that it has.
            (Some(earlier), Sharing::WithOthers) => return Ok(Lock::Held(Held(earlier))),
            (earlier, _) => earlier,
        };
        // Locked before it has its name: nobody can come between.
        let mut own = unfinished(write::folder_of(path)).map_err(failed)?;
        writeln!(own, "{}", std::process::id()).map_err(failed)?;
        match sharing {
            Sharing::Alone => own.as_file().lock(),
            Sharing::WithOthers => own.as_file().lock_shared(),
        }
        .map_err(failed)?;
        let named = match &earlier {
            // Windows renames over no file that is open.
            Some(_) if cfg!(windows) => {
                drop(earlier);
                own.persist(path)
            }
            Some(_) => own.persist(path),
            None => own.persist_noclobber(path),
        };
        match named {
            Ok(file) => return Ok(Lock::Held(Held(file))),
            // Another was faster, and swept away what was unfinished.
            Err(e) if matches!(e.error.kind(), ErrorKind::AlreadyExists | ErrorKind::NotFound) => {}
            Err(e) => return Err(failed(e.error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn held(path: &Path, sharing: Sharing) -> Held {
        match lock(path, sharing).expect("a lock") {
            Lock::Held(held) => held,
            busy @ Lock::Busy(_) => panic!("{busy:?}"),
        }
    }

    #[test]
    fn one_at_a_time_holds_a_lock_and_an_earlier_one_is_taken_over() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        let this = std::process::id();
        for left in [None, Some(""), Some("4194304\n")] {
            if let Some(left) = left {
                fs::write(&path, left).expect("written");
            }
            let file = held(&path, Sharing::Alone);
            assert_eq!(fs::read_to_string(&path).expect("a lock"), format!("{this}\n"));
            for sharing in [Sharing::Alone, Sharing::WithOthers] {
                let busy = lock(&path, sharing);
                assert!(matches!(busy, Ok(Lock::Busy(Some(id))) if id == this), "{busy:?}");
            }
            drop(file);
        }
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1);
    }

    #[test]
    fn several_share_a_lock_until_the_last_has_gone() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        for left in [false, true] {
            if left {
                fs::write(&path, "4194304\n").expect("written");
            }
            let shared = [(); 2].map(|()| held(&path, Sharing::WithOthers));
            for file in shared {
                // Who they are is not told: the number is an earlier run's.
                assert!(matches!(lock(&path, Sharing::Alone), Ok(Lock::Busy(None))));
                drop(file);
            }
            drop(held(&path, Sharing::Alone));
        }
    }

    /// Whatever names it has.
    #[test]
    fn a_file_that_is_no_lock_is_not_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let [path, notes] = ["lock", "notes"].map(|name| folder.path().join(name));
        for text in ["notes", "12 months", "-1", "123456789012345678901"] {
            fs::write(&notes, text).expect("written");
            fs::hard_link(&notes, &path).expect("linked");
            let message = lock(&path, Sharing::Alone).expect_err(text).to_string();
            assert!(message.ends_with("got a file that is no lock of an earlier run"), "{message}");
            assert_eq!(fs::read_to_string(&notes).expect("kept"), text);
            assert_eq!(fs::read_to_string(&path).expect("kept"), text);
            fs::remove_file(&path).expect("removed");
        }
        // What looks like one is given up for its name alone.
        fs::write(&notes, "42").expect("written");
        fs::hard_link(&notes, &path).expect("linked");
        drop(held(&path, Sharing::Alone));
        assert_eq!(fs::read_to_string(&notes).expect("kept"), "42");
    }
}
