//! What an earlier run left in a folder, and who may write to it.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::Deserialize;

use super::super::Error;
use super::super::scene::scene_seed;
use super::json::{MAX_JSON, parse, read_json};
use super::origin::{Origin, other_sensor, show};
use super::{
    ANNOTATIONS, IMAGES, LABELS, ORIGIN, Progress, Settings, Sidecar, Step, image_path, label_name,
    label_path,
};
use crate::files::{self, Sharing};

/// Held by the run that writes to the folder; its process's number stands inside.
const LOCK: &str = ".simulate.lock";

/// What labels of every version have.
#[derive(Deserialize)]
struct AnyLabel {
    scene_seed: u64,
}

/// Takes the folder for this process, a shard with others.
pub(super) fn lock(settings: &Settings) -> Result<files::Held, Error> {
    let sharing = match settings.shard {
        None => Sharing::Alone,
        Some(_) => Sharing::WithOthers,
    };
    match files::lock(&settings.out.join(LOCK), sharing)? {
        files::Lock::Held(held) => Ok(held),
        files::Lock::Busy(holder) => Err(Error::Busy { path: settings.out.clone(), holder }),
    }
}

/// Whether the folder holds a data set of these settings; if not, nothing there may have a name
/// that a data set's files have.
pub(super) fn check_origin(settings: &Settings) -> Result<bool, Error> {
    let path = settings.out.join(ORIGIN);
    let wanted = Origin::of(settings);
    let other = |found: String| Error::OtherDataset {
        path: settings.out.clone(),
        expected: show(&wanted),
        found,
    };
    // Annotations are written at the very end.
    for file in [&path, &settings.out.join(ANNOTATIONS)] {
        files::check(file)?;
    }
    for folder in [settings.images(), settings.labels()] {
        // Pictures would go to wherever it leads.
        if fs::symlink_metadata(&folder).is_ok_and(|found| found.is_symlink()) {
            let (expected, found) = ("a folder of its own".into(), "a symbolic link".into());
            return Err(Error::Content { path: folder, expected, found });
        }
    }
    // Looked at first: another shard writes its origin before all else.
    let stranger = stranger(settings)?;
    if is_there(&path)? {
        let found: Origin = read_json(&path)?;
        return match found == wanted {
            true => Ok(true),
            false => Err(other(show(&found) + &other_sensor(&found, &wanted))),
        };
    }
    match stranger {
        Some(name) => Err(other(format!("another program ({name})"))),
        None => Ok(false),
    }
}

/// The name of something in the folder that would be another program's if no data set were there.
fn stranger(settings: &Settings) -> Result<Option<&'static str>, Error> {
    if is_there(&settings.out.join(ANNOTATIONS))? {
        return Ok(Some(ANNOTATIONS));
    }
    for name in [IMAGES, LABELS] {
        let folder = settings.out.join(name);
        let is_empty = match fs::read_dir(&folder) {
            Ok(mut entries) => entries.next().is_none(),
            Err(e) if e.kind() == ErrorKind::NotFound => !is_there(&folder)?,
            Err(e) => return Err(Error::io(&folder)(e)),
        };
        if !is_empty {
            return Ok(Some(name));
        }
    }
    Ok(None)
}

/// Whether something has this name, also a link to nothing.
fn is_there(path: &Path) -> Result<bool, Error> {
    match fs::symlink_metadata(path) {
        Ok(_) => Ok(true),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(false),
        Err(e) => Err(Error::io(path)(e)),
    }
}

/// Numbers of the pictures asked for that an earlier run finished. Only what is there costs time.
pub(super) fn whole_pictures(
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<HashSet<usize>, Error> {
    let (images, labels) = (settings.images(), settings.labels());
    let entries = match fs::read_dir(&labels) {
        Ok(entries) => entries,
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(HashSet::new()),
        Err(e) => return Err(Error::io(&labels)(e)),
    };
    let names: Vec<_> = entries
        .map(|entry| Ok(entry?.file_name()))
        .collect::<io::Result<_>>()
        .map_err(Error::io(&labels))?;
    let is_wanted = |i: &usize| *i < settings.count && settings.takes(*i);
    let labelled: Vec<usize> =
        names.iter().filter_map(|n| label_index(n)).filter(is_wanted).collect();
    let done = AtomicUsize::new(0);
    let is_whole = |&i: &usize| {
        let whole = is_whole(settings, &image_path(&images, i), &label_path(&labels, i), i);
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        progress(Progress { step: Step::Check, done, all: labelled.len() });
        whole.map(|whole| whole.then_some(i)).transpose()
    };
    labelled.par_iter().filter_map(is_whole).collect()
}

/// Whether a picture and its label are as an earlier run wrote them.
fn is_whole(settings: &Settings, image: &Path, label: &Path, index: usize) -> Result<bool, Error> {
    // Neither is written over if it is not.
    files::check(label)?;
    files::check(image)?;
    let text = files::read(label, MAX_JSON).map_err(Error::io(label))?;
    // A crash of an early version, which did not sync, may have left it empty.
    if text.is_empty() {
        return Ok(false);
    }
    let AnyLabel { scene_seed: found } = parse(label, &text)?;
    let expected = scene_seed(settings.seed, index as u64);
    if found != expected {
        return Err(Error::Content {
            path: label.to_owned(),
            expected: format!("the scene seed {expected}"),
            found: found.to_string(),
        });
    }
    // What an early version wrote lacks something, and is made again.
    let Ok(sidecar) = serde_json::from_slice::<Sidecar>(&text) else { return Ok(false) };
    match fs::metadata(image) {
        Ok(found) => Ok(sidecar.picture_bytes == found.len()),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(false),
        Err(e) => Err(Error::io(image)(e)),
    }
}

/// The number of the picture whose label has this name.
fn label_index(name: &OsStr) -> Option<usize> {
    let index = name.to_str()?.strip_suffix(".json")?.parse().ok()?;
    (*name == *label_name(index)).then_some(index)
}
