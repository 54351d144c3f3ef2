//! Frames in memory: which part of them is gel, at which scale, and how that is known.
//!
//! | file | what it holds |
//! |---|---|
//! | `rect` | parts of pictures |
//! | `pixel_format` | how a camera's pixels lie in memory |
//! | `scale` | millimetres of a pixel, the part that is gel, and how each is known |
//! | `frame` | a picture in memory |
//! | `view` | what a frame shows: its gel, its scale, what of it the network sees |

pub(crate) mod frame;
pub(crate) mod pixel_format;
pub(crate) mod rect;
pub(crate) mod scale;
pub(crate) mod view;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use frame::Frame;
pub use pixel_format::PixelFormat;
pub use rect::Rect;
pub use scale::{Gel, Origin, Scale};

use serde::{Deserialize, Serialize};

use crate::engine::shape::MAX_PIXELS;
use crate::error::{Error, Result};
use crate::files;
use crate::sensor::scale::MM_PER_PIXEL;

/// Shortest and longest field of view in millimetres along the gel's longer side: what the weights are
/// trained for.
pub const FIELD_MM: [f32; 2] = [10.0, 60.0];
/// Distortions of a lens that is meant to take pictures; from −1/3 on they would fold back at the corners.
const DISTORTION: [f32; 2] = [-0.3, 0.5];
/// Greatest coefficient of a light: real ones are below 1.
const MOST_CHANGE: f64 = 1000.0;
/// Longest side of a frame.
const MAX_SIDE: u32 = 65_535;
/// Shapes count as equal when their ratios of width to height differ by at most this share: what
/// rounding to whole pixels does to a frame of a hundred.
const SAME_SHAPE: f64 = 0.01;
/// Largest sensor file in bytes.
const MAX_FILE: u64 = 1 << 20;

/// What a sensor's pictures show: how much gel, and where in them.
///
/// It sets two things. Positions come in millimetres on its gel. And the network, which knows
/// snaps at one scale, gets its input at that scale: as many pixels as the gel's size asks for, width
/// and height apart.
///
/// As a file it is JSON with the fields of [`Sensor`], of which only `name` must be there:
///
/// ```
/// let text = r#"{
///     "name": "bench 3",
///     "frame": [640, 480],
///     "gel": { "x": 40, "y": 0, "width": 560, "height": 480 },
///     "mm_per_pixel": 0.032,
///     "distortion": -0.02
/// }"#;
/// let sensor = smr_gpu::Sensor::parse(text).unwrap();
/// assert_eq!(sensor.frame, Some([640, 480]));
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// What it is called in messages.
    pub name: String,
    /// Width and height of its frames in pixels; `None` for frames of any size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<[u32; 2]>,
    /// The part of the frame that shows the gel; `None` for all of it. Needs `frame`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gel: Option<Rect>,
    /// Millimetres on the undeformed gel for a pixel of the frame; `None` if nobody knows: then 40 mm are
    /// assumed along the gel's shorter side ([`Origin::Assumed`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mm_per_pixel: Option<f32>,
    /// Frames of other sizes that it gives besides: its camera's raw ones, say. Need `frame`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_frames: Vec<SensorFrame>,
    /// The lens' radial distortion κ: a place at the distance r from the frame's middle, in half
    /// diagonals, shows what a pinhole would show at r (1 + κ r²).
    #[serde(default)]
    pub distortion: f32,
    /// Dots printed on the gel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub markers: Option<Markers>,
    /// The picture of a frame without contact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<PathBuf>,
    /// That frame itself, which [`Sensor::open`] reads.
    #[serde(skip)]
    pub reference_frame: Option<Arc<Frame<'static>>>,
    /// How slopes of the gel change its brightness: for the simulator, from `smr-gpu calibrate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// How well simulated presses of a ball agree with real ones: from `smr-gpu calibrate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<Agreement>,
}

/// A sensor's frames of one size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorFrame {
    /// Width and height in pixels.
    pub frame: [u32; 2],
    /// The part that shows the gel; `None` for all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gel: Option<Rect>,
    /// Millimetres on the undeformed gel for a pixel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mm_per_pixel: Option<f32>,
}

impl SensorFrame {
    /// Its gel.
    fn window(&self) -> Rect {
        let [width, height] = self.frame;
        self.gel.unwrap_or(Rect { x: 0, y: 0, width, height })
    }
}

/// How slopes of the gel change its brightness.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Of red, green and blue: change over the flat gel's brightness for each of nx, ny, nx², nx·ny,
    /// ny² of the surface's normal n, by position as coefficients of 1, x, y, x², x·y, y². Where the gel
    /// grows deeper along x, nx is above 0. Position is from the frame's middle, in halves of its width.
    pub channels: [[[f64; 6]; 5]; 3],
}

impl Light {
    /// With nine digits behind the point: more than a fit knows, and JSON keeps them to the bit.
    pub fn rounded(self) -> Self {
        let round = |value: f64| (value * 1e9).round() / 1e9;
        Self { channels: self.channels.map(|channel| channel.map(|row| row.map(round))) }
    }
}

/// Mean absolute differences between simulated presses of a ball and real ones, in 8-bit levels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Agreement {
    /// How many presses.
    pub presses: usize,
    /// Of the untouched gel, nothing drawn.
    pub background: f64,
    /// Of simulated presses, by fits that had not seen them.
    pub held_out: f64,
}

/// Dots printed on a gel, on a square grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Markers {
    /// From dot to dot in millimetres.
    pub pitch_mm: f32,
    /// Of a dot in millimetres.
    pub diameter_mm: f32,
}

/// The lens that drew a frame, in the frame's pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    /// Where its axis meets the frame: the middle of the sensor's whole frame.
    pub axis: [f32; 2],
    /// Half of that frame's diagonal.
    pub half_diagonal: f32,
    /// See [`Sensor::distortion`].
    pub distortion: f32,
}

impl Lens {
    /// That of a frame of this size, whose upper left corner is at `origin`.
    pub fn of(origin: [f64; 2], size: [f64; 2], distortion: f32) -> Self {
        let axis = [0, 1].map(|i| (origin[i] + size[i] / 2.0) as f32);
        Self { axis, half_diagonal: (size[0].hypot(size[1]) / 2.0) as f32, distortion }
    }
}

/// What a sensor says of a frame of some size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sensed {
    /// The part that shows the gel.
    pub gel: Rect,
    /// `None` where the sensor has none.
    pub scale: Option<Scale>,
    pub lens: Lens,
}

impl Sensor {
    /// Names that [`Sensor::named`] knows.
    pub const NAMES: [&str; 4] = ["paper", "gelsight-mini", "digit", "plain"];

    /// The paper's: the central 1000 × 1000 pixels of 1920 × 1200 show 40 × 40 mm.
    pub fn paper() -> Self {
        Self {
            frame: Some([1920, 1200]),
            gel: Some(Rect { x: 460, y: 100, width: 1000, height: 1000 }),
            mm_per_pixel: Some(0.04),
            ..Self::plain().called("paper")
        }
    }

    /// GelSight Mini's frames as its software gives them, 320 × 240 pixels of 0.0634 mm, and those of its
    /// camera, 3280 × 2464, of which the software cuts 15 % off each border.
    pub fn gelsight_mini() -> Self {
        let (x, y, width, height) = (492, 370, 2296, 1724);
        let raw = SensorFrame {
            frame: [3280, 2464],
            gel: Some(Rect { x, y, width, height }),
            mm_per_pixel: Some(0.0634 * 320.0 / width as f32),
        };
        Self {
            frame: Some([320, 240]),
            mm_per_pixel: Some(0.0634),
            other_frames: vec![raw],
            ..Self::plain().called("gelsight-mini")
        }
    }

    /// DIGIT's frames as its interface gives them, upright or as its camera does: 320 pixels along the 19 mm
    /// of gel that its makers state (Lambeta et al. 2020).
    pub fn digit() -> Self {
        let frame = |frame| SensorFrame { frame, gel: None, mm_per_pixel: Some(19.0 / 320.0) };
        let others = [[320, 240], [480, 640], [640, 480]].map(|size| {
            let finer = size[0].max(size[1]) as f32 / 320.0;
            SensorFrame { mm_per_pixel: Some(19.0 / 320.0 / finer), ..frame(size) }
        });
        let SensorFrame { frame, mm_per_pixel, .. } = frame([240, 320]);
        let (frame, other_frames) = (Some(frame), others.to_vec());
        Self { frame, mm_per_pixel, other_frames, ..Self::plain().called("digit") }
    }

    /// Frames of any size, all of them gel, of which the shorter side is assumed to have 40 mm; set
    /// `mm_per_pixel` for a known scale.
    pub fn plain() -> Self {
        Self {
            name: "plain".into(),
            frame: None,
            gel: None,
            mm_per_pixel: None,
            other_frames: Vec::new(),
            distortion: 0.0,
            markers: None,
            reference: None,
            reference_frame: None,
            light: None,
            agreement: None,
        }
    }

    fn called(mut self, name: &str) -> Self {
        self.name = name.into();
        self
    }

    /// The sensor that goes by this name.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "paper" => Self::paper(),
            "gelsight-mini" => Self::gelsight_mini(),
            "digit" => Self::digit(),
            "plain" => Self::plain(),
            _ => return None,
        })
    }

    /// The sensor of this name, or else of this file.
    ///
    /// # Errors
    /// [`Error::Param`] for what is neither a name nor a file, and as [`open`](Self::open).
    pub fn find(text: &str) -> Result<Self> {
        match Self::named(text) {
            Some(sensor) => Ok(sensor),
            None if Path::new(text).exists() => Self::open(Path::new(text)),
            None => {
                let expected = format!("{} or a file", Self::NAMES.join(", "));
                Err(Error::param("detect", "sensor", expected, format!("`{text}`")))
            }
        }
    }

    /// Reads a sensor file and the reference frame that it names, relative to the file's folder.
    ///
    /// # Errors
    /// [`Error::Sensor`] for a file that cannot be read, is not JSON with these fields, or holds what
    /// [`Sensor::check`] refuses; for a reference frame that cannot be read, for which the feature `picture`
    /// is needed, or that has another size than `frame`.
    pub fn open(path: &Path) -> Result<Self> {
        let fail = |message: String| Error::Sensor { sensor: path.display().to_string(), message };
        let bytes = files::read(path, MAX_FILE).map_err(|e| fail(e.to_string()))?;
        let text = files::text(&bytes).map_err(|e| fail(e.to_string()))?;
        let mut sensor = Self::parse(text).map_err(|e| match e {
            Error::Sensor { message, .. } => fail(message),
            other => other,
        })?;
        if let (Some(reference), Some(folder)) = (&mut sensor.reference, path.parent()) {
            *reference = folder.join(&*reference);
            let read = read_reference(reference, sensor.frame);
            let about = |e: String| fail(format!("reference {}: {e}", reference.display()));
            sensor.reference_frame = Some(Arc::new(read.map_err(about)?));
        }
        Ok(sensor)
    }

    /// Reads a sensor from JSON.
    ///
    /// # Errors
    /// [`Error::Sensor`] for what is not JSON with these fields, or what [`Sensor::check`] refuses.
    pub fn parse(text: &str) -> Result<Self> {
        let fail = |e: serde_json::Error| Error::Sensor {
            sensor: "sensor".into(),
            message: e.to_string(),
        };
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let sensor: Self = serde_json::from_str(text).map_err(fail)?;
        sensor.check()?;
        Ok(sensor)
    }

    /// Checks every value against its range; NaN is in none.
    ///
    /// # Errors
    /// [`Error::Sensor`] that names the first that is out of it.
    pub fn check(&self) -> Result<()> {
        let range = |name: &str, value: f32, [least, most]: [f32; 2]| {
            let fits = (least..=most).contains(&value);
            self.expect(fits, || format!("{name}: expected {least} to {most}, got {value}"))
        };
        for [width, height] in self.frames().map(|own| own.frame) {
            let fits = [width, height].iter().all(|side| (1..=MAX_SIDE).contains(side));
            let got = || format!("frame: expected sides of 1 to {MAX_SIDE}, got {width}, {height}");
            self.expect(fits, got)?;
            let pixels = u64::from(width) * u64::from(height);
            self.expect(pixels <= MAX_PIXELS as u64, || {
                format!("frame: expected at most {MAX_PIXELS} pixels, got {width} × {height}")
            })?;
        }
        self.expect(self.gel.is_none() || self.frame.is_some(), || {
            "gel: expected `frame` beside it, got none".into()
        })?;
        for SensorFrame { frame: [width, height], gel, .. } in self.frames() {
            let outside = gel.filter(|gel| !gel.is_in(width, height));
            self.expect(outside.is_none(), || {
                let got = outside.map(|gel| gel.to_string()).unwrap_or_default();
                format!("gel: expected a part of {width} × {height} pixels, got {got}")
            })?;
        }
        let others = self.other_frames.is_empty() || self.frame.is_some();
        self.expect(others, || "other_frames: expected `frame` beside it, got none".into())?;
        let mut scales = self.other_frames.iter().map(|own| own.mm_per_pixel);
        scales
            .try_for_each(|mm| mm.map_or(Ok(()), |mm| range("other_frames", mm, MM_PER_PIXEL)))?;
        if let Some(mm) = self.mm_per_pixel {
            range("mm_per_pixel", mm, MM_PER_PIXEL)?;
        }
        range("distortion", self.distortion, DISTORTION)?;
        if let Some(Markers { pitch_mm, diameter_mm }) = self.markers {
            range("markers: pitch_mm", pitch_mm, [0.1, FIELD_MM[1]])?;
            range("markers: diameter_mm", diameter_mm, [0.01, pitch_mm])?;
        }
        if let Some(light) = &self.light {
            let values = light.channels.as_flattened().as_flattened();
            let odd = values.iter().find(|v| !(-MOST_CHANGE..=MOST_CHANGE).contains(*v));
            self.expect(odd.is_none(), || {
                let got = odd.copied().unwrap_or(f64::NAN);
                format!(
                    "light: expected coefficients of -{MOST_CHANGE} to {MOST_CHANGE}, got {got}"
                )
            })?;
        }
        // The fields are known before any frame is.
        for own in self.frames() {
            let Some(mm) = own.mm_per_pixel else { continue };
            let window = own.window();
            let pixels = window.width.max(window.height);
            let ([least, most], field) = (FIELD_MM, pixels as f32 * mm);
            // Rounded to whole pixels, a field at the end of the range may lie a hair past it.
            self.expect((least * 0.999..=most * 1.001).contains(&field), || {
                format!(
                    "expected a field of {least} to {most} mm along the gel's longer side, got \
                     {field:.3} mm: {pixels} pixels of {mm:.5} mm"
                )
            })?;
        }
        Ok(())
    }

    fn expect(&self, fits: bool, message: impl FnOnce() -> String) -> Result<()> {
        if fits { Ok(()) } else { Err(self.fail(message())) }
    }

    fn fail(&self, message: String) -> Error {
        Error::Sensor { sensor: self.name.clone(), message }
    }

    /// Its frames: the one that it is described by, and the others.
    fn frames(&self) -> impl Iterator<Item = SensorFrame> {
        let (gel, mm_per_pixel) = (self.gel, self.mm_per_pixel);
        let own = self.frame.map(|frame| SensorFrame { frame, gel, mm_per_pixel });
        own.into_iter().chain(self.other_frames.iter().copied())
    }

    /// Whether frames of this width and height are its own, not scaled ones.
    pub(crate) fn takes(&self, size: [u32; 2]) -> bool {
        self.frames().any(|own| own.frame == size)
    }

    /// What it says of a frame of this width and height.
    ///
    /// One of its own sizes is that frame. Others of a frame's shape are taken for scaled ones, and those of
    /// the gel's shape for the gel alone.
    ///
    /// # Errors
    /// [`Error::Sensor`] for a frame of another shape.
    pub(crate) fn sense(&self, size: [u32; 2]) -> Result<Sensed> {
        let [width, height] = size;
        let scaled = |mm: Option<f32>, times: f64, from| {
            mm.map(|mm| Scale { mm_per_pixel: (f64::from(mm) / times) as f32, from })
        };
        let Some(main) = self.frames().next() else {
            let (gel, lens) = (Rect { x: 0, y: 0, width, height }, self.lens(size, None));
            return Ok(Sensed { gel, scale: scaled(self.mm_per_pixel, 1.0, Origin::Sensor), lens });
        };
        let of_shape: Vec<_> = self.frames().filter(|own| same_shape(size, own.frame)).collect();
        let exact = of_shape.iter().find(|own| own.frame == size);
        if let Some(own) = exact.or(of_shape.first()) {
            let times = [0, 1].map(|axis| f64::from(size[axis]) / f64::from(own.frame[axis]));
            // Of a scaled frame nobody knows which of several it was.
            let from = match exact.is_some() || of_shape.len() == 1 {
                true => Origin::Sensor,
                false => Origin::Assumed,
            };
            let scale = scaled(own.mm_per_pixel, times[0], from);
            let lens = self.lens(size, Some(own));
            return Ok(Sensed { gel: own.window().scaled(times, size), scale, lens });
        }
        let gel = main.window();
        if !same_shape(size, [gel.width, gel.height]) {
            let shapes: Vec<_> = self.frames().map(|own| own.frame).collect();
            let shapes: Vec<_> = shapes.iter().map(|[w, h]| format!("{w} × {h}")).collect();
            return Err(self.fail(format!(
                "expected frames of the shape of {} pixels, or of its gel's {} × {}; got {width} × {height}",
                shapes.join(" or "),
                gel.width,
                gel.height
            )));
        }
        let times = f64::from(width) / f64::from(gel.width);
        let origin = [gel.x, gel.y].map(|at| -f64::from(at) * times);
        let whole = main.frame.map(|side| f64::from(side) * times);
        let scale = scaled(main.mm_per_pixel, times, Origin::Sensor);
        let lens = Lens::of(origin, whole, self.distortion);
        Ok(Sensed { gel: Rect { x: 0, y: 0, width, height }, scale, lens })
    }

    /// The lens in a frame of this size, which is `own`, scaled.
    fn lens(&self, size: [u32; 2], own: Option<&SensorFrame>) -> Lens {
        let lens = Lens::of([0.0; 2], size.map(f64::from), self.distortion);
        // The distortion is stated in half diagonals of the frame that describes the sensor.
        let diagonal = |[w, h]: [u32; 2]| f64::from(w).hypot(f64::from(h));
        let main = self.frames().next();
        let longer = main.zip(own).map_or(1.0, |(main, own)| {
            let mm = main.mm_per_pixel.zip(own.mm_per_pixel);
            let finer = mm.map_or(1.0, |(main, own)| f64::from(main) / f64::from(own));
            finer * diagonal(main.frame) / diagonal(own.frame)
        });
        Lens { half_diagonal: (f64::from(lens.half_diagonal) * longer) as f32, ..lens }
    }

    /// The part of this sensor's frames of size `other` that shows what this part of a frame with
    /// this gel does; `None` for what they do not show, and for a sensor without a size of its own.
    pub(crate) fn same_part(&self, gel: Rect, part: Rect, other: [u32; 2]) -> Option<Rect> {
        self.frame?;
        let there = self.sense(other).ok()?.gel;
        let side = |from: [u32; 2], part: [u32; 2], to: [u32; 2], all: u32| {
            let times = f64::from(to[1]) / f64::from(from[1]);
            let edge =
                |at: u32| (f64::from(to[0]) + (f64::from(at) - f64::from(from[0])) * times).round();
            let (first, end) = (edge(part[0]), edge(part[0] + part[1]));
            let rounding = SAME_SHAPE * f64::from(all);
            let shown = first >= -rounding && end <= f64::from(all) + rounding;
            let (first, end) = (first.max(0.0) as u32, (end as u32).min(all));
            (shown && first < end).then(|| (first, end - first))
        };
        let across = |r: Rect| [r.x, r.width];
        let along = |r: Rect| [r.y, r.height];
        let (x, width) = side(across(gel), across(part), across(there), other[0])?;
        let (y, height) = side(along(gel), along(part), along(there), other[1])?;
        Some(Rect { x, y, width, height })
    }
}

/// The picture of an untouched gel.
///
/// # Errors
/// In words.
#[cfg(feature = "picture")]
fn read_reference(file: &Path, size: Option<[u32; 2]>) -> Result<Frame<'static>, String> {
    let picture = crate::picture::read(file).map_err(|e| e.to_string())?.into_rgb8();
    let (width, height) = picture.dimensions();
    match size.filter(|size| *size != [width, height]) {
        Some([w, h]) => {
            Err(format!("expected {w} × {h} pixels as the sensor's frames, got {width} × {height}"))
        }
        None => Ok(Frame::new(picture.into_raw(), width, height, PixelFormat::Rgb8)),
    }
}

#[cfg(not(feature = "picture"))]
fn read_reference(_: &Path, _: Option<[u32; 2]>) -> Result<Frame<'static>, String> {
    Err("expected the feature `picture`, which reads it".into())
}

fn same_shape([w, h]: [u32; 2], [other_w, other_h]: [u32; 2]) -> bool {
    let (across, along) = (f64::from(w) * f64::from(other_h), f64::from(h) * f64::from(other_w));
    (across - along).abs() <= SAME_SHAPE * across.max(along)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(x: u32, y: u32, width: u32, height: u32) -> Rect {
        Rect { x, y, width, height }
    }

    /// The gel, the millimetres a pixel and where they are from.
    fn sensed(sensor: &Sensor, size: [u32; 2]) -> (Rect, f32, Origin) {
        let Sensed { gel, scale, .. } = sensor.sense(size).expect("a frame of its shape");
        let Scale { mm_per_pixel, from } = scale.expect("a scale");
        (gel, mm_per_pixel, from)
    }

    #[test]
    fn a_sensor_is_found_by_its_name_or_file() {
        assert_eq!(Sensor::find("digit").expect("a name"), Sensor::digit());
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("own.json");
        std::fs::write(&file, r#"{"name": "own"}"#).expect("written");
        let found = Sensor::find(&file.to_string_lossy()).expect("a file");
        assert_eq!(found, Sensor::plain().called("own"));
        let message = Sensor::find("nobody").expect_err("an error").to_string();
        let want = "detect: parameter `sensor`: expected paper, gelsight-mini, digit, plain or a file, got \
                    `nobody`";
        assert_eq!(message, want);
    }

    #[test]
    fn the_papers_frames() {
        let paper = Sensor::paper();
        paper.check().expect("a sound sensor");
        let from = Origin::Sensor;
        assert_eq!(sensed(&paper, [1920, 1200]), (rect(460, 100, 1000, 1000), 0.04, from));
        // Half as many pixels, and the gel alone at a quarter.
        assert_eq!(sensed(&paper, [960, 600]), (rect(230, 50, 500, 500), 0.08, from));
        assert_eq!(sensed(&paper, [250, 250]), (rect(0, 0, 250, 250), 0.16, from));
        let message = paper.sense([640, 480]).expect_err("an error").to_string();
        let want = "sensor `paper`: expected frames of the shape of 1920 × 1200 pixels, or of its gel's \
                    1000 × 1000; got 640 × 480";
        assert_eq!(message, want);
    }

    /// The software of GelSight Mini keeps 70 % of its camera's frame along each side and scales that to 320 × 240.
    #[test]
    fn raw_frames_have_a_gel_and_a_scale_of_their_own() {
        let mini = Sensor::gelsight_mini();
        assert_eq!(sensed(&mini, [320, 240]), (rect(0, 0, 320, 240), 0.0634, Origin::Sensor));
        let (gel, raw, from) = sensed(&mini, [3280, 2464]);
        assert_eq!((gel, from), (rect(492, 370, 2296, 1724), Origin::Sensor));
        let [across, along] = [gel.width, gel.height].map(|side| side as f32 * raw);
        assert!(
            (across - 20.288).abs() < 0.01 && (along - 15.216).abs() < 0.03,
            "{across} {along}"
        );
        // One or the other, scaled.
        assert_eq!(sensed(&mini, [640, 480]), (rect(0, 0, 640, 480), 0.0317, Origin::Assumed));
        let digit = Sensor::digit();
        for (size, mm) in
            [([240, 320], 0.059375), ([320, 240], 0.059375), ([480, 640], 0.029_687_5)]
        {
            let gel = rect(0, 0, size[0], size[1]);
            assert_eq!(sensed(&digit, size), (gel, mm, Origin::Sensor), "{size:?}");
        }
    }

    /// Half of the diagonal of the frame that describes the sensor is as long on the gel in each of its frames.
    #[test]
    fn a_lens_is_one_in_all_frames() {
        let text = r#"{ "name": "lens", "frame": [300, 400], "mm_per_pixel": 0.05, "distortion": -0.1,
            "other_frames": [{ "frame": [1000, 800], "mm_per_pixel": 0.025,
                "gel": { "x": 200, "y": 0, "width": 600, "height": 800 } }] }"#;
        let sensor = Sensor::parse(text).expect("a sensor");
        let lens = |size| sensor.sense(size).expect("a frame").lens;
        let own = lens([300, 400]);
        assert_eq!((own.axis, own.half_diagonal), ([150.0, 200.0], 250.0));
        let raw = lens([1000, 800]);
        assert_eq!((raw.axis, raw.half_diagonal), ([500.0, 400.0], 500.0));
        assert_eq!(lens([500, 400]).half_diagonal, 250.0);
    }

    #[test]
    fn frames_of_two_sizes_show_the_same_in_these_parts() {
        let paper = Sensor::paper();
        let same = |size, crop: Option<Rect>, other| {
            let gel = paper.sense(size).expect("a frame").gel;
            paper.same_part(gel, crop.unwrap_or(gel), other)
        };
        // Half as many pixels, the gel alone at half, and a part of that.
        assert_eq!(same([960, 600], None, [1920, 1200]), Some(rect(460, 100, 1000, 1000)));
        assert_eq!(same([500, 500], None, [1920, 1200]), Some(rect(460, 100, 1000, 1000)));
        let part = Some(rect(10, 20, 300, 200));
        assert_eq!(same([500, 500], part, [1920, 1200]), Some(rect(480, 140, 600, 400)));
        // The gel alone does not show what is beside it.
        assert_eq!(same([1920, 1200], None, [500, 500]), Some(rect(0, 0, 500, 500)));
        assert_eq!(same([1920, 1200], Some(rect(300, 100, 1000, 1000)), [500, 500]), None);
        assert_eq!(same([1920, 1200], None, [640, 480]), None);
        let whole = rect(0, 0, 100, 100);
        assert_eq!(Sensor::plain().same_part(whole, whole, [200, 200]), None);
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        let refused = |text: &str| Sensor::parse(text).expect_err("an error").to_string();
        for (text, want) in [
            (
                r#"{ "name": "a", "frame": [0, 9] }"#,
                "sensor `a`: frame: expected sides of 1 to 65535, got 0, 9",
            ),
            (
                r#"{ "name": "a", "frame": [65535, 65535] }"#,
                "sensor `a`: frame: expected at most 33554432 pixels, got 65535 × 65535",
            ),
            (
                r#"{ "name": "a", "mm_per_pixel": 1.5 }"#,
                "sensor `a`: mm_per_pixel: expected 0.0005 to 1, got 1.5",
            ),
            (
                r#"{ "name": "a", "distortion": 3 }"#,
                "sensor `a`: distortion: expected -0.3 to 0.5, got 3",
            ),
            (
                r#"{ "name": "a", "frame": [100, 80], "mm_per_pixel": 0.7 }"#,
                "sensor `a`: expected a field of 10 to 60 mm along the gel's longer side, got 70.000 mm: \
                 100 pixels of 0.70000 mm",
            ),
            (
                r#"{ "name": "a", "frame": [100, 80], "gel": { "x": 90, "y": 0, "width": 11, "height": 9 } }"#,
                "sensor `a`: gel: expected a part of 100 × 80 pixels, got 11 × 9 at (90, 0)",
            ),
            (
                r#"{ "name": "a", "gel": { "x": 0, "y": 0, "width": 1, "height": 1 } }"#,
                "sensor `a`: gel: expected `frame` beside it, got none",
            ),
            (
                r#"{ "name": "a", "other_frames": [{ "frame": [9, 9] }] }"#,
                "sensor `a`: other_frames: expected `frame` beside it, got none",
            ),
            (
                r#"{ "name": "a", "frame": [9, 9], "other_frames": [{ "frame": [9, 0] }] }"#,
                "sensor `a`: frame: expected sides of 1 to 65535, got 9, 0",
            ),
            (
                r#"{ "name": "a", "markers": { "pitch_mm": 2, "diameter_mm": 3 } }"#,
                "sensor `a`: markers: diameter_mm: expected 0.01 to 2, got 3",
            ),
        ] {
            assert_eq!(refused(text), want);
        }
        assert!(refused("{}").contains("missing field `name`"));
        assert!(refused(r#"{ "name": "a", "scale": 2 }"#).contains("unknown field `scale`"));
    }

    #[test]
    fn the_built_in_sensors_have_names() {
        for name in Sensor::NAMES {
            let sensor = Sensor::named(name).expect("a sensor");
            assert_eq!(sensor.name, name);
            sensor.check().expect("a sound sensor");
            let text = serde_json::to_string(&sensor).expect("JSON");
            assert_eq!(Sensor::parse(&text).expect("a sensor"), sensor);
        }
        assert_eq!(Sensor::named("Paper"), None);
    }
}
