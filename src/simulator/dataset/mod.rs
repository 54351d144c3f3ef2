//! Data sets of simulated pictures with COCO labels.
//!
//! A folder holds `origin.json` with what it was made from, `images/000000.png` and so on,
//! `labels/000000.json` with what was drawn and how large the picture's file is, and
//! `annotations.json` once all is there. A label is written after its picture: where both are
//! there and the size is right, the picture is whole. One run at a time writes to a folder, or several
//! shards: they hold a lock on `.simulate.lock`.
//!
//! Each scene's seed is a hash of the data set's seed and the picture's number, so data sets of
//! different seeds share no scene: splits are kept apart by giving each its own seed. A picture
//! depends on its scene's seed and the request alone, not on threads, order or the number of
//! pictures. Another kind of processor may round a transform otherwise and change single levels.

mod json;
mod origin;

mod annotations;
mod begun;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use image::ExtendedColorType;
use image::ImageEncoder;
use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::conditions::Conditions;
use super::label::Label;
use super::raster::Raster;
use super::render::{Rendered, Renderer, Request};
use super::scene::scene_seed;
use super::{Error, on_threads};
use crate::files::{self, Shard};
use annotations::write_annotations;
use begun::{check_origin, lock, whole_pictures};
use json::{write_json, write_rounded};
use origin::Origin;

/// Least number of pictures that a worker takes, to make its plans and buffers rarely.
const CHUNK: usize = 8;
const ORIGIN: &str = "origin.json";
const ANNOTATIONS: &str = "annotations.json";
const IMAGES: &str = "images";
const LABELS: &str = "labels";

/// What to simulate.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Folder to write to; made if missing, continued if begun.
    pub out: PathBuf,
    /// Number of pictures.
    pub count: usize,
    /// Seed of the data set.
    pub seed: u64,
    /// What the pictures show, and under which conditions.
    pub request: Request,
    /// The pictures that this call takes, without `annotations.json`; `None` for all.
    pub shard: Option<Shard>,
}

/// What [`simulate`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Summary {
    /// Pictures rendered by this call.
    pub rendered: usize,
    /// Pictures that were there already.
    pub kept: usize,
    /// Labelled snaps in the whole data set; `None` of a shard.
    pub snaps: Option<usize>,
}

/// How far [`simulate`] is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// What it does.
    pub step: Step,
    /// How many pictures have been through this step.
    pub done: usize,
    /// Of how many.
    pub all: usize,
}

/// What [`simulate`] does, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Looks at pictures of an earlier run.
    Check,
    /// Renders those that are missing.
    Render,
}

#[derive(Serialize, Deserialize)]
struct Sidecar {
    scene_seed: u64,
    frame: Raster,
    conditions: Conditions,
    /// Size of the picture's file.
    picture_bytes: u64,
    snaps: Vec<Label>,
}

/// Renders what is missing of a data set, then writes `annotations.json`.
///
/// Shards of one data set may write to a folder together, or to folders whose files are put together later; a
/// call without one then renders what is missing and writes `annotations.json`.
///
/// Pictures are spread over rayon's current pool, or over one of its own. `progress` is called from any thread, not
/// always in order. A call with fewer pictures than are there labels the first ones. Nothing is
/// written before all that is there has been checked.
///
/// # Errors
/// [`Error::OtherDataset`] if the folder was made with another seed or request, or by something else;
/// [`Error::Busy`] while another run writes to it; [`Error::Io`], [`Error::Image`],
/// [`Error::Content`] or [`Error::Write`] for files; [`Error::NoScene`] from the renderer.
pub fn simulate(
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, Error> {
    on_threads(|| simulate_here(settings, progress))
}

fn simulate_here(
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, Error> {
    // Before the folder is made or locked: what is not ours stays as it is.
    check_origin(settings)?;
    fs::create_dir_all(&settings.out).map_err(Error::io(&settings.out))?;
    let _lock = lock(settings)?;
    // Another run may have begun it since.
    let is_begun = check_origin(settings)?;
    let whole = whole_pictures(settings, progress)?;

    if !is_begun {
        write_json(&settings.out.join(ORIGIN), &Origin::of(settings))?;
    }
    let (images, labels) = (settings.images(), settings.labels());
    for folder in [&images, &labels] {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
    }
    // A shard leaves what others have begun.
    for folder in [&settings.out, &images, &labels].into_iter().filter(|_| settings.shard.is_none())
    {
        files::remove_unfinished(folder)?;
    }
    let (kept, all) = (whole.len(), settings.own_count());
    let done = AtomicUsize::new(kept);
    progress(Progress { step: Step::Render, done: kept, all });
    let missing = |i: &usize| settings.takes(*i) && !whole.contains(i);
    let missing = (0..settings.count).into_par_iter().with_min_len(CHUNK).filter(missing);
    missing.try_for_each_init(Renderer::new, |renderer, i| {
        let scene_seed = scene_seed(settings.seed, i as u64);
        let rendered = match settings.request.press {
            true => renderer.press(settings.seed, i, scene_seed, &settings.request),
            false => renderer.render(scene_seed, &settings.request)?,
        };
        let Rendered { picture, frame, conditions, labels: snaps } = rendered;
        let image = image_path(&images, i);
        let png = encode(&image, &picture)?;
        files::write(&image, &png)?;
        let picture_bytes = png.len() as u64;
        let sidecar = Sidecar { scene_seed, frame, conditions, picture_bytes, snaps };
        write_rounded(&label_path(&labels, i), &sidecar)?;
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        progress(Progress { step: Step::Render, done, all });
        Ok::<(), Error>(())
    })?;
    let snaps = match settings.shard {
        None => Some(write_annotations(settings, &labels)?),
        Some(_) => None,
    };
    Ok(Summary { rendered: all - kept, kept, snaps })
}

impl Settings {
    fn images(&self) -> PathBuf {
        self.out.join(IMAGES)
    }

    fn labels(&self) -> PathBuf {
        self.out.join(LABELS)
    }

    fn takes(&self, index: usize) -> bool {
        self.shard.is_none_or(|shard| shard.takes(index as u64))
    }

    /// How many pictures are this call's.
    fn own_count(&self) -> usize {
        self.shard.map_or(self.count, |shard| shard.share(self.count as u64) as usize)
    }
}

fn image_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("{index:06}.png"))
}

fn label_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(label_name(index))
}

fn label_name(index: usize) -> String {
    format!("{index:06}.json")
}

/// The picture as PNG; `path` is for messages.
fn encode(path: &Path, picture: &RgbImage) -> Result<Vec<u8>, Error> {
    let (width, height) = picture.dimensions();
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub)
        .write_image(picture.as_raw(), width, height, ExtendedColorType::Rgb8)
        .map_err(Error::image(path))?;
    Ok(png)
}
