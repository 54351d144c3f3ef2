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

use std::collections::{BTreeSet, HashSet};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use image::ExtendedColorType;
use image::ImageEncoder;
use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::ser::{CompactFormatter, Formatter};

use super::conditions::{Conditions, Distribution};
use super::distractors::Part;
use super::forced::Forced;
use super::label::Label;
use super::raster::Raster;
use super::relief::Relief;
use super::render::{Rendered, Renderer, Request};
use super::scene::{Mix, Negative, NegativeShape, scene_seed};
use super::snaps::Kind;
use super::{Error, on_threads};
use crate::files::{self, Shard, Sharing};
use crate::sensor::Sensor;
use crate::sensor::rect::Rect;

/// Least number of pictures that a worker takes, to make its plans and buffers rarely.
const CHUNK: usize = 8;
/// Held by the run that writes to the folder; its process's number stands inside.
const LOCK: &str = ".simulate.lock";
const ORIGIN: &str = "origin.json";
const ANNOTATIONS: &str = "annotations.json";
const IMAGES: &str = "images";
const LABELS: &str = "labels";
/// Longest file that an earlier run left to be read, in bytes: a label has some thousands.
const MAX_JSON: u64 = 1 << 24;

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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor: Option<Sensor>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    press: bool,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    classes: Vec<OwnClass>,
    /// Digests of shapes that are no snaps; names of kinds that are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    negatives: Vec<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    negatives_alone: bool,
}

/// A class of one's own, as a folder was made with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct OwnClass {
    name: String,
    /// Of its heights; none for A and B.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    digest: Option<String>,
}

impl Origin {
    fn of(settings: &Settings) -> Self {
        let Request { mix, conditions, part, forced, sensor, press, own } = &settings.request;
        let class = |kind: &Kind| OwnClass {
            name: kind.name().to_owned(),
            digest: match kind {
                Kind::Own(part) => Some(digest(&part.relief)),
                Kind::A | Kind::B => None,
            },
        };
        Self {
            seed: settings.seed,
            kind: *mix,
            simulator: simulator(*conditions),
            conditions: *conditions,
            part: *part,
            forced: forced.clone(),
            sensor: sensor.as_ref().map(|given| given.sensor().clone()),
            press: *press,
            classes: own.classes.iter().map(class).collect(),
            negatives: own
                .negatives
                .iter()
                .map(|Negative { shape, pressed, .. }| match (shape, pressed) {
                    (NegativeShape::Snap(kind), _) => kind.name().to_owned(),
                    (NegativeShape::Relief(relief), None) => digest(relief),
                    (NegativeShape::Relief(relief), Some(pressed)) => {
                        format!("{}, from {:.2} mm", digest(relief), pressed.least_mm)
                    }
                })
                .collect(),
            negatives_alone: own.negatives_alone,
        }
    }
}

fn digest(relief: &Relief) -> String {
    format!("{:016x}", relief.digest())
}

/// Raised when the same seed would give another picture.
fn simulator(conditions: Distribution) -> u32 {
    match conditions {
        Distribution::Plain => 3,
        Distribution::Wide => 5,
    }
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

/// What labels of every version have.
#[derive(Deserialize)]
struct AnyLabel {
    scene_seed: u64,
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

/// The number of the picture whose label has this name.
fn label_index(name: &OsStr) -> Option<usize> {
    let index = name.to_str()?.strip_suffix(".json")?.parse().ok()?;
    (*name == *label_name(index)).then_some(index)
}

/// Takes the folder for this process, a shard with others, until the file is dropped.
fn lock(settings: &Settings) -> Result<File, Error> {
    let sharing = match settings.shard {
        None => Sharing::Alone,
        Some(_) => Sharing::WithOthers,
    };
    match files::lock(&settings.out.join(LOCK), sharing)? {
        files::Lock::Held(file) => Ok(file),
        files::Lock::Busy(holder) => Err(Error::Busy { path: settings.out.clone(), holder }),
    }
}

/// Whether the folder holds a data set of these settings; if not, nothing there may have a name
/// that a data set's files have.
fn check_origin(settings: &Settings) -> Result<bool, Error> {
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
fn whole_pictures(
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

fn show(origin: &Origin) -> String {
    let kind = match origin.kind {
        Mix::A => "a",
        Mix::B => "b",
        Mix::Mixed => "mixed",
        Mix::None => "none",
        Mix::Bare => "bare",
    };
    let mut text = format!("seed {}, kind {kind}, simulator {}", origin.seed, origin.simulator);
    if origin.conditions == Distribution::Wide {
        text += ", wide conditions";
    }
    if origin.press {
        text += ", a press";
    }
    if let Some(part) = origin.part {
        text += &format!(", part {part:?}").to_lowercase();
    }
    if origin.forced != Forced::default() {
        text += &format!(", forced {}", origin.forced);
    }
    if let Some(sensor) = &origin.sensor {
        text += &format!(", sensor {}", sensor.name);
    }
    text
}

/// In what a sensor differs from one of the same name, in words; else nothing.
fn other_sensor(found: &Origin, wanted: &Origin) -> String {
    let (Some(found), Some(wanted)) = (&found.sensor, &wanted.sensor) else {
        return String::new();
    };
    let [found, wanted] =
        [found, wanted].map(|sensor| serde_json::to_value(sensor).unwrap_or_default());
    if found["name"] != wanted["name"] || found == wanted {
        return String::new();
    }
    let keys = [&found, &wanted].into_iter().filter_map(|sensor| sensor.as_object());
    let keys: BTreeSet<&String> = keys.flat_map(|fields| fields.keys()).collect();
    let differing = keys.into_iter().filter(|key| found[key.as_str()] != wanted[key.as_str()]);
    let differing: Vec<&str> = differing.map(String::as_str).collect();
    format!(" with another {}", differing.join(" and "))
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_vec(value).map_err(|e| Error::io(path)(e.into()))?;
    Ok(files::write(path, &text)?)
}

/// [`write_json`] with ten digits of each number, less than anything there is known to.
fn write_rounded(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    Ok(files::write(path, &rounded_json(value).map_err(|e| Error::io(path)(e.into()))?)?)
}

fn rounded_json(value: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut text = Vec::new();
    value.serialize(&mut serde_json::Serializer::with_formatter(&mut text, Digits))?;
    Ok(text)
}

/// Ten digits: how transforms and the system's functions round beyond them depends on the machine, on whether it
/// fuses multiply-adds for one.
struct Digits;

impl Formatter for Digits {
    fn write_f64<W: ?Sized + io::Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        let value = format!("{value:.9e}").parse().unwrap_or(value);
        CompactFormatter.write_f64(writer, value)
    }
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    parse(path, &files::read(path, MAX_JSON).map_err(Error::io(path))?)
}

fn parse<T: DeserializeOwned>(path: &Path, text: &[u8]) -> Result<T, Error> {
    serde_json::from_slice(text).map_err(|e| Error::Content {
        path: path.to_owned(),
        expected: "what an earlier run wrote".to_owned(),
        found: e.to_string(),
    })
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

#[derive(Serialize)]
struct Coco {
    info: CocoInfo,
    categories: Vec<CocoCategory>,
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
    name: String,
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
    /// Of a given sensor; a housing that was drawn is not told.
    gel: Rect,
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
    kind: String,
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
    let own = &settings.request.own.classes;
    let classes = if own.is_empty() { &[Kind::A, Kind::B][..] } else { own };
    let names: Vec<String> = classes.iter().map(|kind| kind.name().to_owned()).collect();
    let mut coco = Coco {
        info: CocoInfo {
            description: "simulated tactile pictures of snap joints",
            origin: Origin::of(settings),
        },
        categories: (1..)
            .zip(&names)
            .map(|(id, name)| CocoCategory { id, name: name.clone(), supercategory: "snap" })
            .collect(),
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
            gel: match &settings.request.sensor {
                Some(given) => given.gel(),
                None => {
                    let [width, height] = [sidecar.frame.width, sidecar.frame.height];
                    Rect { x: 0, y: 0, width: width as u32, height: height as u32 }
                }
            },
            conditions: sidecar.conditions,
        });
        for snap in sidecar.snaps {
            let [x0, y0, x1, y1] = snap.pixel_box;
            let at = names.iter().position(|name| *name == snap.kind);
            let at = at.ok_or_else(|| Error::Content {
                path: label_path(labels, id),
                expected: format!("snaps of {}", names.join(", ")),
                found: snap.kind.clone(),
            })?;
            let category_id = at as u32 + 1;
            coco.annotations.push(CocoAnnotation {
                id: coco.annotations.len() + 1,
                image_id: id,
                category_id,
                bbox: [x0, y0, x1 - x0, y1 - y0].map(rounded),
                area: rounded((x1 - x0) * (y1 - y0)),
                iscrowd: 0,
                kind: snap.kind,
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
    write_rounded(&settings.out.join(ANNOTATIONS), &coco)?;
    Ok(coco.annotations.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With and without fused multiply-adds a sum may differ in its last bits.
    #[test]
    fn labels_do_not_have_the_last_bits_of_their_numbers() {
        let area = 1234.5678;
        let written = |area_px: f64| {
            let label = Label {
                kind: "A".to_owned(),
                pixel_box: [0.1 + 0.2, 1e-12, 640.0, area_px / 10.0],
                area_px,
                yaw_deg: Some(area_px / 100.0),
                depth_mm: 1.0 / 3.0,
                center_mm: [-area_px, 0.0],
                whole: true,
                visible: 1.0,
                slots: None,
                hole_mm: None,
                wall: false,
                on_side: false,
            };
            String::from_utf8(rounded_json(&label).expect("JSON")).expect("text")
        };
        let text = written(area);
        assert!(text.contains("[0.3,1e-12,640.0,123.45678],\"area_px\":1234.5678,"), "{text}");
        assert!(
            text.contains("\"depth_mm\":0.3333333333,\"center_mm\":[-1234.5678,0.0]"),
            "{text}"
        );
        let fused = f64::from_bits(area.to_bits() + 3);
        assert_ne!(fused, area);
        assert_eq!(written(fused), text);
    }
}
