//! COCO annotations: which pictures there are, and what they show.
//!
//! [`parse`] takes bytes and opens no file; [`Picture::find_in`] looks for a picture's. What pycocotools would pass over in silence, a box
//! outside its picture or an id that two things share, is refused by name; what it defines, crowds
//! and areas, is kept for [`crate::evaluation::metrics`].

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt::Display;
use std::path::{Component, Path, PathBuf};

use serde::de::{Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::Value;
use serde_path_to_error::Segment;

use crate::engine::shape::MAX_PIXELS;
use crate::evaluation::metrics::Truth;
use crate::files;
use crate::sensor::frame::Frame;
use crate::sensor::rect::Rect;
use crate::sensor::scale::{Gel, Scale};

/// How far a box may reach past its picture, in pixels: tools round.
const MARGIN: f64 = 1.0;

/// What is wrong with annotations.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: expected {expected}, got {got}")]
pub struct Error {
    /// Which entry.
    pub place: String,
    /// What may stand there.
    pub expected: String,
    /// What stands there.
    pub got: String,
}

impl Error {
    fn new(place: impl Display, expected: impl Display, got: impl Display) -> Self {
        Self { place: place.to_string(), expected: expected.to_string(), got: got.to_string() }
    }
}

/// Something that a label says beside the box.
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    /// Yes or no.
    Flag(bool),
    /// A number, in the unit that its name ends in.
    Number(f64),
    /// A word.
    Text(String),
}

/// What labels say beside boxes, by name.
pub type Attributes = BTreeMap<String, Attribute>;

impl Attribute {
    /// What is neither a flag, a number nor a word says nothing.
    fn of(value: &Value) -> Option<Self> {
        match value {
            Value::Bool(flag) => Some(Self::Flag(*flag)),
            Value::Number(number) => number.as_f64().map(Self::Number),
            Value::String(text) => Some(Self::Text(text.clone())),
            _ => None,
        }
    }

    /// The number, if it is one.
    pub fn number(&self) -> Option<f64> {
        if let Self::Number(number) = self { Some(*number) } else { None }
    }
}

/// Labelled pictures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dataset {
    /// Names of the categories, no two of them alike but for capitals. Tools list some that no
    /// annotation uses.
    pub categories: Vec<String>,
    /// The pictures by rising id, the order in which pycocotools takes them.
    pub pictures: Vec<Picture>,
}

/// A picture and what it shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Its id.
    pub id: u64,
    /// Its file, below the folder of the annotations: no part of it leads up or elsewhere. Links
    /// are the file system's.
    pub file: PathBuf,
    /// Width and height in pixels, where they are stated.
    pub size: Option<(u32, u32)>,
    /// Millimetres on the gel for a pixel, where they are stated.
    pub mm_per_pixel: Option<f32>,
    /// The part that shows the gel, where it is stated.
    pub gel: Option<Rect>,
    /// Under which conditions it was taken, by the names that `smr-gpu simulate` writes.
    pub conditions: Attributes,
    /// What it shows.
    pub labels: Vec<Label>,
}

/// A thing in a picture, or a crowd of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// The annotation, for messages.
    name: String,
    /// Position in [`Dataset::categories`].
    pub category: usize,
    /// Where it is, in pixels of the picture.
    pub truth: Truth,
    /// What is known of it besides, where it is stated: those of `whole`, `visible`, `depth_mm`,
    /// `slots`, `hole_mm`, `wall`, `on_side` and `yaw_deg`, as `smr-gpu simulate` writes them.
    pub attributes: Attributes,
}

#[derive(Deserialize)]
struct Coco {
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
    categories: Vec<CocoCategory>,
}

/// A whole number from 0. Some tools write it as 5.0.
#[derive(Clone, Copy)]
struct Whole(u64);

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        /// From here on doubles no longer hold every whole number.
        const MOST: f64 = (1u64 << 53) as f64;
        struct Wanted;
        impl Visitor<'_> for Wanted {
            type Value = Whole;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("a whole number from 0")
            }

            fn visit_u64<E>(self, value: u64) -> Result<Whole, E> {
                Ok(Whole(value))
            }

            fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Whole, E> {
                match (0.0..MOST).contains(&value) && value.fract() == 0.0 {
                    true => Ok(Whole(value as u64)),
                    false => Err(E::invalid_value(Unexpected::Float(value), &self)),
                }
            }
        }
        from.deserialize_u64(Wanted)
    }
}

#[derive(Deserialize)]
struct CocoImage {
    id: Whole,
    file_name: String,
    width: Option<Whole>,
    height: Option<Whole>,
    mm_per_pixel: Option<f32>,
    /// What other tools call so may be anything.
    gel: Option<Value>,
    /// What other tools call so may be anything.
    conditions: Option<Value>,
}

#[derive(Deserialize)]
struct CocoAnnotation {
    id: Option<Whole>,
    image_id: Whole,
    category_id: Whole,
    /// Left, top, width, height in pixels.
    bbox: [f64; 4],
    area: Option<f64>,
    iscrowd: Option<Value>,
    whole: Option<Value>,
    visible: Option<Value>,
    depth_mm: Option<Value>,
    slots: Option<Value>,
    hole_mm: Option<Value>,
    wall: Option<Value>,
    on_side: Option<Value>,
    yaw_deg: Option<Value>,
}

impl CocoAnnotation {
    fn attributes(&self) -> Attributes {
        let named = [
            ("whole", &self.whole),
            ("visible", &self.visible),
            ("depth_mm", &self.depth_mm),
            ("slots", &self.slots),
            ("hole_mm", &self.hole_mm),
            ("wall", &self.wall),
            ("on_side", &self.on_side),
            ("yaw_deg", &self.yaw_deg),
        ];
        let stated = named
            .into_iter()
            .filter_map(|(name, value)| Some((name.to_owned(), Attribute::of(value.as_ref()?)?)));
        stated.collect()
    }
}

#[derive(Deserialize)]
struct CocoCategory {
    id: Whole,
    name: String,
}

/// Reads the bytes of an annotations file.
///
/// # Errors
/// [`Error`] for what is no COCO JSON; without pictures; ids, files or names of categories that two
/// share; ids that nothing has; files outside the folder; sizes past [`MAX_PIXELS`]; boxes that are
/// empty, inside out, not finite or outside their picture; areas and crowds that are none.
pub fn parse(bytes: &[u8]) -> Result<Dataset, Error> {
    let text = files::text(bytes).map_err(|e| Error::new("annotations", "COCO's JSON", e))?;
    let coco: Coco = serde_json::from_str(text).map_err(|e| named(text, &e))?;
    if coco.images.is_empty() {
        return Err(Error::new("images", "at least one", "none"));
    }
    let (category_of, categories) = categories(coco.categories)?;
    let mut pictures = pictures(coco.images)?;
    let place_of: HashMap<u64, usize> =
        pictures.iter().enumerate().map(|(place, p)| (p.id, place)).collect();
    let mut ids = HashSet::new();
    for (index, annotation) in coco.annotations.into_iter().enumerate() {
        let name = match annotation.id {
            Some(Whole(id)) => format!("annotation {id}"),
            None => format!("annotation at position {index}"),
        };
        if annotation.id.is_some_and(|Whole(id)| !ids.insert(id)) {
            return Err(Error::new(name, "each id once", "it twice"));
        }
        let CocoAnnotation { image_id: Whole(image_id), category_id: Whole(category_id), .. } =
            annotation;
        let category = category_of.get(&category_id).copied();
        let category = category
            .ok_or_else(|| Error::new(&name, "the category_id of a category", category_id))?;
        let picture = place_of.get(&image_id).and_then(|place| pictures.get_mut(*place));
        let picture =
            picture.ok_or_else(|| Error::new(&name, "the image_id of an image", image_id))?;
        let truth = truth(&name, &annotation)?;
        let attributes = annotation.attributes();
        picture.labels.push(Label { name, category, truth, attributes });
    }
    for picture in &pictures {
        match picture.size {
            Some((width, height)) => picture.check_boxes(width, height)?,
            // The first corner is known to lie outside without the size.
            None => picture.check_boxes(u32::MAX, u32::MAX)?,
        }
    }
    Ok(Dataset { categories, pictures })
}

/// `error` of reading this text, with the entry and the field that it is about, if it is about one.
fn named(text: &str, error: &serde_json::Error) -> Error {
    let failed = |place: String| Error::new(place, "COCO's JSON", format!("an error: {error}"));
    if !error.is_data() {
        return failed("annotations".into());
    }
    // Once more from the start: keeping the place takes time that sound files need not spend.
    let mut reader = serde_json::Deserializer::from_str(text);
    let read = serde_path_to_error::deserialize::<_, Coco>(&mut reader);
    let path = read.err().map(|e| e.path().clone());
    let mut path = path.iter().flatten();
    let (Some(Segment::Map { key }), Some(Segment::Seq { index })) = (path.next(), path.next())
    else {
        return failed("annotations".into());
    };
    let one = match key.as_str() {
        "categories" => "category",
        list => list.trim_end_matches('s'),
    };
    let id = serde_json::from_str::<Value>(text).map(|all| all[key][index]["id"].clone());
    let mut place = match id {
        Ok(Value::Null) | Err(_) => format!("{one} at position {index}"),
        Ok(id) => format!("{one} {id}"),
    };
    if let Some(Segment::Map { key }) = path.next() {
        place += &format!(": {key}");
    }
    failed(place)
}

/// The categories' names, and the position of each id among them.
fn categories(categories: Vec<CocoCategory>) -> Result<(HashMap<u64, usize>, Vec<String>), Error> {
    let (mut place_of, mut names, mut known) = (HashMap::new(), Vec::new(), HashSet::new());
    for CocoCategory { id: Whole(id), name } in categories {
        if place_of.insert(id, names.len()).is_some() {
            return Err(Error::new(format!("category {id}"), "each id once", "it twice"));
        }
        if !known.insert(name.to_lowercase()) {
            let place = format!("category {id}");
            return Err(Error::new(place, "each name once", format!("`{name}` twice")));
        }
        names.push(name);
    }
    Ok((place_of, names))
}

/// The pictures by rising id, without labels so far.
fn pictures(images: Vec<CocoImage>) -> Result<Vec<Picture>, Error> {
    let mut pictures = Vec::with_capacity(images.len());
    let mut owner_of: HashMap<PathBuf, u64> = HashMap::new();
    for image in images {
        let CocoImage { id: Whole(id), file_name, width, height, mm_per_pixel, gel, conditions } =
            image;
        let name = format!("image {id}");
        let file = below(&file_name).ok_or_else(|| {
            Error::new(&name, "a file_name inside the folder", format!("`{file_name}`"))
        })?;
        if let Some(other) = owner_of.insert(file.clone(), id).filter(|other| *other != id) {
            let got = format!("`{file_name}`, which is image {other}'s");
            return Err(Error::new(name, "a file_name of its own", got));
        }
        let size = width.zip(height).map(|(Whole(w), Whole(h))| {
            let sides = u32::try_from(w).ok().zip(u32::try_from(h).ok());
            let fits = |(w, h): &(u32, u32)| {
                (1..=MAX_PIXELS as u64).contains(&(u64::from(*w) * u64::from(*h)))
            };
            sides.filter(fits).ok_or_else(|| {
                Error::new(&name, format!("1 to {MAX_PIXELS} pixels"), format!("{w} × {h}"))
            })
        });
        let size = size.transpose()?;
        let gel = gel.map(|value| {
            let rect = serde_json::from_value::<Rect>(value.clone()).ok();
            let (w, h) = size.unwrap_or((u32::MAX, u32::MAX));
            rect.filter(|rect| rect.is_in(w, h)).ok_or_else(|| {
                let expected = "a gel of x, y, width and height in pixels inside the picture";
                Error::new(&name, expected, value)
            })
        });
        let gel = gel.transpose()?;
        let conditions = conditions.as_ref().and_then(Value::as_object).into_iter().flatten();
        let conditions = conditions
            .filter_map(|(name, value)| Some((name.clone(), Attribute::of(value)?)))
            .collect();
        let labels = Vec::new();
        pictures.push(Picture { id, file, size, mm_per_pixel, gel, conditions, labels });
    }
    pictures.sort_by_key(|p| p.id);
    match pictures.windows(2).find(|pair| pair[0].id == pair[1].id) {
        Some(pair) => Err(Error::new(format!("image {}", pair[0].id), "each id once", "it twice")),
        None => Ok(pictures),
    }
}

/// A file's path below the folder, without `.`; `None` if it leads up or elsewhere, or nowhere.
fn below(file_name: &str) -> Option<PathBuf> {
    let mut path = PathBuf::new();
    for part in Path::new(file_name).components() {
        match part {
            Component::Normal(name) => path.push(name),
            Component::CurDir => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    (!path.as_os_str().is_empty()).then_some(path)
}

/// The truth that an annotation states.
fn truth(name: &str, annotation: &CocoAnnotation) -> Result<Truth, Error> {
    let [x, y, width, height] = annotation.bbox;
    let bbox = [x, y, x + width, y + height];
    let is_box = width > 0.0 && height > 0.0 && bbox[2] > x && bbox[3] > y;
    if !is_box || !bbox.iter().all(|side| side.is_finite()) {
        let expected = "a bbox of finite numbers with width and height above 0";
        return Err(Error::new(name, expected, format!("{:?}", annotation.bbox)));
    }
    let area = annotation.area.unwrap_or(width * height);
    if !(area >= 0.0 && area.is_finite()) {
        return Err(Error::new(name, "an area from 0", area));
    }
    let crowd = match annotation.iscrowd.as_ref() {
        None => false,
        Some(value) => match value.as_bool().or(value.as_f64().and_then(flag)) {
            Some(crowd) => crowd,
            None => return Err(Error::new(name, "an iscrowd of 0 or 1", value)),
        },
    };
    Ok(Truth { bbox, area, crowd, ignored: false })
}

fn flag(number: f64) -> Option<bool> {
    match number {
        0.0 => Some(false),
        1.0 => Some(true),
        _ => None,
    }
}

impl Dataset {
    /// The same, with categories that are a network's `classes`, whatever their capitals. Those that no
    /// label has may be none of them.
    ///
    /// # Errors
    /// [`Error`] that names a label's category that is no class.
    pub fn of_classes(mut self, classes: &[String]) -> Result<Self, Error> {
        let class_of = |name: &String| {
            classes.iter().position(|class| class.to_lowercase() == name.to_lowercase())
        };
        let class_of: Vec<Option<usize>> = self.categories.iter().map(class_of).collect();
        for label in self.pictures.iter_mut().flat_map(|picture| &mut picture.labels) {
            let class = class_of[label.category].ok_or_else(|| {
                let expected = format!("one of the weights' {}", classes.join(", "));
                Error::new("category", expected, format!("`{}`", self.categories[label.category]))
            })?;
            label.category = class;
        }
        Ok(Self { categories: classes.to_vec(), ..self })
    }
}

impl Picture {
    /// The frame with the scale and the gel that its label states.
    pub fn state<'a>(&self, mut frame: Frame<'a>) -> Frame<'a> {
        frame.scale = self.mm_per_pixel.map(Scale::label);
        frame.gel = self.gel.map(Gel::Part);
        frame
    }

    /// Where its file is, in `folder` or `images` there; where there is none, what was looked for last.
    pub fn find_in(&self, folder: &Path) -> PathBuf {
        let images = folder.join("images");
        let windows = self.file_of_windows();
        let names = std::iter::once(&self.file).chain(&windows);
        let mut files = names.flat_map(|name| [folder.join(name), images.join(name)]);
        files.find(|file| file.exists()).unwrap_or_else(|| images.join(&self.file))
    }

    /// [`Picture::file`] as Windows means it, with backslashes between folders: for where no file has the name
    /// as it stands. `None` if there are no backslashes, or if it would lead out of the folder.
    pub fn file_of_windows(&self) -> Option<PathBuf> {
        let name = self.file.to_str().filter(|name| name.contains('\\'))?;
        below(&name.replace('\\', "/"))
    }

    /// Checks the picture's true size: against the stated one, and whether all boxes lie inside.
    ///
    /// # Errors
    /// [`Error`] that names the picture or the annotation.
    pub fn check_size(&self, width: u32, height: u32) -> Result<(), Error> {
        match self.size {
            Some((w, h)) if (w, h) != (width, height) => {
                let (expected, got) =
                    (format!("{w} × {h} pixels as labelled"), format!("{width} × {height}"));
                Err(Error::new(format!("image {}", self.id), expected, got))
            }
            _ => self.check_boxes(width, height),
        }
    }

    fn check_boxes(&self, width: u32, height: u32) -> Result<(), Error> {
        let [right, bottom] = [width, height].map(|side| f64::from(side) + MARGIN);
        for Label { name, truth: Truth { bbox: [x1, y1, x2, y2], .. }, .. } in &self.labels {
            let inside = *x1 >= -MARGIN && *y1 >= -MARGIN && *x2 <= right && *y2 <= bottom;
            if !inside {
                let expected = match width {
                    u32::MAX => "a bbox inside its picture".into(),
                    _ => format!("a bbox inside its {width} × {height} pixels"),
                };
                let got = format!("{x1}, {y1} to {x2}, {y2}");
                return Err(Error::new(name, expected, got));
            }
        }
        Ok(())
    }
}
