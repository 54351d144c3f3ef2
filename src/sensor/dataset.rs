//! Data sets of simulated pictures with COCO labels.
//!
//! A folder holds `images/000000.png` and so on, `labels/000000.json` with what was drawn, and
//! `annotations.json` once all is there. Each scene's seed is a hash of the data set's seed and
//! the picture's number, so data sets of different seeds share no scene: splits are kept apart by
//! giving each its own seed. A picture depends on its scene's seed and the kinds asked for alone,
//! not on threads, order or the number of pictures. Another kind of processor may round a
//! transform otherwise and change single levels.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use image::ExtendedColorType;
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::render::{Label, Rendered, Renderer};
use super::scene::Mix;
use super::snaps::Kind;
use super::{Error, PICTURE_PX};

/// Pictures that a worker takes at a time, to make its plans and buffers rarely.
const CHUNK: usize = 8;

/// What to simulate.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Folder to write to; made if missing, continued if begun.
    pub out: PathBuf,
    /// Number of pictures.
    pub count: usize,
    /// Seed of the data set.
    pub seed: u64,
    /// Which snaps the pictures show.
    pub mix: Mix,
}

/// What [`simulate`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Summary {
    /// Pictures rendered by this call.
    pub rendered: usize,
    /// Pictures that were there already.
    pub kept: usize,
    /// Labelled snaps in the whole data set.
    pub snaps: usize,
}

/// What a folder was made with; another call must ask for the same.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Origin {
    seed: u64,
    kind: Mix,
    simulator: u32,
}

/// Raised when the same seed would give another picture.
const SIMULATOR: u32 = 2;

#[derive(Serialize, Deserialize)]
struct Sidecar {
    scene_seed: u64,
    snaps: Vec<Label>,
}

/// Seed of the scene with this number in a data set: SplitMix64's finaliser over both.
pub fn scene_seed(seed: u64, index: u64) -> u64 {
    let mix = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    mix(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)).wrapping_add(index))
}

/// Renders what is missing of a data set, then writes `annotations.json`.
///
/// Pictures are spread over rayon's current pool. `progress` is called from any thread, not
/// always in order, with the number of pictures done and the number in all. A call with fewer
/// pictures than are there labels the first ones.
///
/// # Errors
/// [`Error::OtherDataset`] if the folder was made with another seed or kind; [`Error::Io`],
/// [`Error::Image`] or [`Error::Content`] for files; [`Error::NoScene`] from the renderer.
pub fn simulate(
    settings: &Settings,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Summary, Error> {
    let images = settings.out.join("images");
    let labels = settings.out.join("labels");
    for folder in [&images, &labels] {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
    }
    check_origin(settings)?;

    let missing: Vec<usize> = (0..settings.count)
        .filter(|i| !(image_path(&images, *i).exists() && label_path(&labels, *i).exists()))
        .collect();
    let kept = settings.count - missing.len();
    let done = AtomicUsize::new(kept);
    progress(kept, settings.count);
    missing.par_chunks(CHUNK).try_for_each_init(Renderer::new, |renderer, chunk| {
        for &i in chunk {
            let scene_seed = scene_seed(settings.seed, i as u64);
            let Rendered { picture, labels: snaps } = renderer.render(scene_seed, settings.mix)?;
            let sidecar = Sidecar { scene_seed, snaps };
            write_json(&label_path(&labels, i), &sidecar)?;
            write_picture(&image_path(&images, i), picture.as_raw())?;
            progress(1 + done.fetch_add(1, Ordering::Relaxed), settings.count);
        }
        Ok(())
    })?;
    let snaps = write_annotations(settings, &labels)?;
    Ok(Summary { rendered: missing.len(), kept, snaps })
}

fn image_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("{index:06}.png"))
}

fn label_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("{index:06}.json"))
}

fn check_origin(settings: &Settings) -> Result<(), Error> {
    let path = settings.out.join("origin.json");
    let wanted = Origin { seed: settings.seed, kind: settings.mix, simulator: SIMULATOR };
    let other = |expected: &Origin, found: String| Error::OtherDataset {
        path: settings.out.clone(),
        expected: show(expected),
        found,
    };
    if !path.exists() {
        let images = settings.out.join("images");
        let is_empty = fs::read_dir(&images).is_ok_and(|mut files| files.next().is_none());
        if settings.out.join("annotations.json").exists() || images.exists() && !is_empty {
            return Err(other(&wanted, "another program".into()));
        }
        return write_json(&path, &wanted);
    }
    let found: Origin = read_json(&path)?;
    if found == wanted {
        return Ok(());
    }
    Err(other(&wanted, show(&found)))
}

fn show(origin: &Origin) -> String {
    let kind = match origin.kind {
        Mix::A => "a",
        Mix::B => "b",
        Mix::Mixed => "mixed",
        Mix::None => "none",
    };
    format!("seed {}, kind {kind}, simulator {}", origin.seed, origin.simulator)
}

/// Writes under another name, then renames: a file is whole or not there.
fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), Error>,
) -> Result<(), Error> {
    let unfinished = path.with_extension("unfinished");
    let mut file = BufWriter::new(File::create(&unfinished).map_err(Error::io(&unfinished))?);
    write(&mut file)?;
    file.flush().map_err(Error::io(&unfinished))?;
    drop(file);
    fs::rename(&unfinished, path).map_err(Error::io(path))
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    write_whole(path, |file| {
        serde_json::to_writer(file, value).map_err(|e| Error::io(path)(e.into()))
    })
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let text = fs::read(path).map_err(Error::io(path))?;
    serde_json::from_slice(&text).map_err(|e| Error::Content {
        path: path.to_owned(),
        expected: "what an earlier run wrote".to_owned(),
        found: e.to_string(),
    })
}

fn write_picture(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_whole(path, |file| {
        PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Sub)
            .write_image(bytes, PICTURE_PX as u32, PICTURE_PX as u32, ExtendedColorType::Rgb8)
            .map_err(Error::image(path))
    })
}

#[derive(Serialize)]
struct Coco {
    info: CocoInfo,
    categories: [CocoCategory; 2],
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
}

#[derive(Serialize)]
struct CocoInfo {
    description: &'static str,
    seed: u64,
    kind: Mix,
    simulator: u32,
}

#[derive(Serialize)]
struct CocoCategory {
    id: u32,
    name: &'static str,
    supercategory: &'static str,
}

#[derive(Serialize)]
struct CocoImage {
    id: usize,
    file_name: String,
    width: usize,
    height: usize,
    /// As text: 64 bits do not fit a JSON number everywhere.
    scene_seed: String,
}

#[derive(Serialize)]
struct CocoAnnotation {
    id: usize,
    image_id: usize,
    category_id: u32,
    /// `x, y, width, height` in pixels.
    bbox: [f64; 4],
    /// The box's area in square pixels.
    area: f64,
    iscrowd: u32,
    kind: &'static str,
    yaw_deg: f64,
    depth_mm: f64,
    center_mm: [f64; 2],
    contact_area_px: f64,
}

/// Rounds to a thousandth, which is less than the labels' error.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

fn write_annotations(settings: &Settings, labels: &Path) -> Result<usize, Error> {
    let mut coco = Coco {
        info: CocoInfo {
            description: "simulated tactile pictures of snap joints",
            seed: settings.seed,
            kind: settings.mix,
            simulator: SIMULATOR,
        },
        categories: [Kind::A, Kind::B].map(|kind| CocoCategory {
            id: kind.category_id(),
            name: kind.name(),
            supercategory: "snap",
        }),
        images: Vec::with_capacity(settings.count),
        annotations: Vec::new(),
    };
    for id in 0..settings.count {
        let sidecar: Sidecar = read_json(&label_path(labels, id))?;
        coco.images.push(CocoImage {
            id,
            file_name: format!("{id:06}.png"),
            width: PICTURE_PX,
            height: PICTURE_PX,
            scene_seed: sidecar.scene_seed.to_string(),
        });
        for snap in sidecar.snaps {
            let [x0, y0, x1, y1] = snap.pixel_box;
            coco.annotations.push(CocoAnnotation {
                id: coco.annotations.len() + 1,
                image_id: id,
                category_id: snap.kind.category_id(),
                bbox: [x0, y0, x1 - x0, y1 - y0].map(rounded),
                area: rounded((x1 - x0) * (y1 - y0)),
                iscrowd: 0,
                kind: snap.kind.name(),
                yaw_deg: rounded(snap.yaw_deg),
                depth_mm: rounded(snap.depth_mm),
                center_mm: snap.center_mm.map(rounded),
                contact_area_px: rounded(snap.area_px),
            });
        }
    }
    write_json(&settings.out.join("annotations.json"), &coco)?;
    Ok(coco.annotations.len())
}
