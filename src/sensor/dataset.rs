//! Data sets of simulated pictures with COCO labels.
//!
//! A folder holds `images/000000.png` and so on, `labels/000000.json` with what was drawn, and
//! `annotations.json` once all is there. Each scene's seed is a hash of the data set's seed and
//! the picture's number, so data sets of different seeds share no scene: splits are kept apart by
//! giving each its own seed. A picture depends on its scene's seed and the request alone,
//! not on threads, order or the number of pictures. Another kind of processor may round a
//! transform otherwise and change single levels.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use image::ExtendedColorType;
use image::ImageEncoder;
use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Error;
use super::conditions::{Conditions, Distribution, Forced};
use super::distractors::Part;
use super::frame::Frame;
use super::render::{Label, Rendered, Renderer, Request};
use super::scene::Mix;
use super::snaps::Kind;

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
    /// What the pictures show, and under which conditions.
    pub request: Request,
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Origin {
    seed: u64,
    kind: Mix,
    simulator: u32,
    #[serde(default)]
    conditions: Distribution,
    #[serde(default)]
    part: Option<Part>,
    #[serde(default)]
    forced: Forced,
}

impl Origin {
    fn of(settings: &Settings) -> Self {
        let Request { mix, conditions, part, forced } = &settings.request;
        Self {
            seed: settings.seed,
            kind: *mix,
            simulator: simulator(*conditions),
            conditions: *conditions,
            part: *part,
            forced: forced.clone(),
        }
    }
}

/// Raised when the same seed would give another picture.
fn simulator(conditions: Distribution) -> u32 {
    match conditions {
        Distribution::Plain => 2,
        Distribution::Wide => 3,
    }
}

#[derive(Serialize, Deserialize)]
struct Sidecar {
    scene_seed: u64,
    frame: Frame,
    conditions: Conditions,
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
/// [`Error::OtherDataset`] if the folder was made with another seed or request; [`Error::Io`],
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
            let Rendered { picture, frame, conditions, labels: snaps } =
                renderer.render(scene_seed, &settings.request)?;
            let sidecar = Sidecar { scene_seed, frame, conditions, snaps };
            write_json(&label_path(&labels, i), &sidecar)?;
            write_picture(&image_path(&images, i), &picture)?;
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
    let wanted = Origin::of(settings);
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
    let mut text = format!("seed {}, kind {kind}, simulator {}", origin.seed, origin.simulator);
    if origin.conditions == Distribution::Wide {
        text += ", wide conditions";
    }
    if let Some(part) = origin.part {
        text += &format!(", part {part:?}").to_lowercase();
    }
    if origin.forced != Forced::default() {
        text += &format!(", forced {}", origin.forced);
    }
    text
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

fn write_picture(path: &Path, picture: &RgbImage) -> Result<(), Error> {
    let (width, height) = picture.dimensions();
    write_whole(path, |file| {
        PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Sub)
            .write_image(picture.as_raw(), width, height, ExtendedColorType::Rgb8)
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
    #[serde(flatten)]
    origin: Origin,
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
    mm_per_pixel: f64,
    conditions: Conditions,
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
    /// Direction in which A's barbed tip points; none for B.
    yaw_deg: Option<f64>,
    depth_mm: f64,
    center_mm: [f64; 2],
    contact_area_px: f64,
    whole: bool,
    visible: f64,
    slots: Option<u32>,
    hole_mm: Option<f64>,
    wall: bool,
    on_side: bool,
}

/// Rounds to a thousandth, which is less than the labels' error.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

fn write_annotations(settings: &Settings, labels: &Path) -> Result<usize, Error> {
    let mut coco = Coco {
        info: CocoInfo {
            description: "simulated tactile pictures of snap joints",
            origin: Origin::of(settings),
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
            width: sidecar.frame.width,
            height: sidecar.frame.height,
            scene_seed: sidecar.scene_seed.to_string(),
            mm_per_pixel: sidecar.frame.mm_per_pixel,
            conditions: sidecar.conditions,
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
                yaw_deg: snap.yaw_deg.map(rounded),
                depth_mm: rounded(snap.depth_mm),
                center_mm: snap.center_mm.map(rounded),
                contact_area_px: rounded(snap.area_px),
                whole: snap.whole,
                visible: rounded(snap.visible),
                slots: snap.slots,
                hole_mm: snap.hole_mm.map(rounded),
                wall: snap.wall,
                on_side: snap.on_side,
            });
        }
    }
    write_json(&settings.out.join("annotations.json"), &coco)?;
    Ok(coco.annotations.len())
}
