//! What a sensor's pictures show: how much gel, and where in them.
//!
//! A [`Sensor`] sets two things. Positions come in millimetres on its gel. And the network, which knows
//! snaps at one scale, gets its input at that scale: as many pixels as the gel's size asks for, width
//! and height apart.
//!
//! As a file it is JSON with the fields of [`Sensor`], of which only `name` must be there:
//!
//! ```
//! let text = r#"{
//!     "name": "bench 3",
//!     "frame": [640, 480],
//!     "gel": { "x": 40, "y": 0, "width": 560, "height": 480 },
//!     "mm_per_pixel": 0.032,
//!     "distortion": -0.02
//! }"#;
//! let sensor = smr_gpu::Sensor::parse(text).unwrap();
//! assert_eq!(sensor.frame, Some([640, 480]));
//! ```

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::files;
use crate::frame::Rect;
use crate::model::{MAX_PIXELS, PAPER_MM};

/// Shortest and longest field of view in millimetres along the gel's longer side: what the weights are
/// trained for.
pub const FIELD_MM: [f32; 2] = [10.0, 60.0];
/// Millimetres a pixel: from 60 mm on 65 535 pixels to 10 mm on 16.
const MM_PER_PIXEL: [f32; 2] = [5e-4, 1.0];
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

/// What a sensor's pictures show.
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
    /// Millimetres on the undeformed gel for a pixel of the frame; `None` if the gel's shorter side
    /// has 40 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mm_per_pixel: Option<f32>,
    /// The lens' radial distortion κ: a place at the distance r from the frame's middle, in half
    /// diagonals, shows what a pinhole would show at r (1 + κ r²).
    #[serde(default)]
    pub distortion: f32,
    /// Dots printed on the gel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub markers: Option<Markers>,
    /// A frame without contact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<PathBuf>,
    /// How slopes of the gel change its brightness: for the simulator, from `smr-gpu calibrate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// How well simulated presses of a ball agree with real ones: from `smr-gpu calibrate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<Agreement>,
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

/// What one frame shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct View {
    /// Width and height of the frame.
    pub frame: [u32; 2],
    /// The part that the network sees.
    pub part: Rect,
    /// The middle of the gel, where millimetres begin.
    pub middle: [f32; 2],
    pub mm_per_pixel: f32,
    pub lens: Lens,
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
    fn of(origin: [f64; 2], size: [f64; 2], distortion: f32) -> Self {
        let axis = [0, 1].map(|i| (origin[i] + size[i] / 2.0) as f32);
        Self { axis, half_diagonal: (size[0].hypot(size[1]) / 2.0) as f32, distortion }
    }
}

impl View {
    /// Place on the gel, in millimetres from its middle, that is seen at this place of the frame.
    pub fn place_mm(&self, place: [f32; 2]) -> [f32; 2] {
        let Lens { axis, half_diagonal, distortion } = self.lens;
        let straight = |[x, y]: [f32; 2]| {
            let (x, y) = (x - axis[0], y - axis[1]);
            let r = x.hypot(y) / half_diagonal;
            let stretch = 1.0 + distortion * r * r;
            [x * stretch, y * stretch]
        };
        let ([x, y], [x0, y0]) = (straight(place), straight(self.middle));
        [(x - x0) * self.mm_per_pixel, (y - y0) * self.mm_per_pixel]
    }
}

impl Sensor {
    /// Names that [`Sensor::named`] knows.
    pub const NAMES: [&str; 3] = ["paper", "gelsight-mini", "plain"];

    /// The paper's: the central 1000 × 1000 pixels of 1920 × 1200 show 40 × 40 mm.
    pub fn paper() -> Self {
        Self {
            frame: Some([1920, 1200]),
            gel: Some(Rect { x: 460, y: 100, width: 1000, height: 1000 }),
            mm_per_pixel: Some(0.04),
            ..Self::plain().called("paper")
        }
    }

    /// GelSight Mini's frames as its software gives them, 320 × 240 pixels of 0.0634 mm.
    pub fn gelsight_mini() -> Self {
        Self {
            frame: Some([320, 240]),
            mm_per_pixel: Some(0.0634),
            ..Self::plain().called("gelsight-mini")
        }
    }

    /// Frames of any size, all of them gel, of which the shorter side has 40 mm; set `mm_per_pixel` for
    /// another scale.
    pub fn plain() -> Self {
        Self {
            name: "plain".into(),
            frame: None,
            gel: None,
            mm_per_pixel: None,
            distortion: 0.0,
            markers: None,
            reference: None,
            light: None,
            agreement: None,
        }
    }

    /// Frames of any size, all of them gel, at this scale.
    pub fn of_scale(mm_per_pixel: f32) -> Self {
        Self { mm_per_pixel: Some(mm_per_pixel), ..Self::plain() }
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
            "plain" => Self::plain(),
            _ => return None,
        })
    }

    /// Reads a sensor file. Where it names a reference frame, that is relative to the file's folder.
    ///
    /// # Errors
    /// [`Error::Sensor`] for a file that cannot be read, is not JSON with these fields, or holds what
    /// [`Sensor::check`] refuses.
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
        if let Some([width, height]) = self.frame {
            let fits = [width, height].iter().all(|side| (1..=MAX_SIDE).contains(side));
            let got = || format!("frame: expected sides of 1 to {MAX_SIDE}, got {width}, {height}");
            self.expect(fits, got)?;
            let pixels = u64::from(width) * u64::from(height);
            self.expect(pixels <= MAX_PIXELS as u64, || {
                format!("frame: expected at most {MAX_PIXELS} pixels, got {width} × {height}")
            })?;
        }
        if let Some(gel) = self.gel {
            let Some([width, height]) = self.frame else {
                return Err(self.fail("gel: expected `frame` beside it, got none".into()));
            };
            self.expect(gel.is_in(width, height), || {
                format!("gel: expected a part of {width} × {height} pixels, got {gel:?}")
            })?;
        }
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
        match self.frame {
            // The field is known before any frame is.
            Some([width, height]) => self.view([width, height], None).map(|_| ()),
            None => Ok(()),
        }
    }

    fn expect(&self, fits: bool, message: impl FnOnce() -> String) -> Result<()> {
        if fits { Ok(()) } else { Err(self.fail(message())) }
    }

    fn fail(&self, message: String) -> Error {
        Error::Sensor { sensor: self.name.clone(), message }
    }

    /// What a frame of this width and height shows, or its part `crop`.
    ///
    /// Frames of the sensor's shape at another resolution are taken for scaled ones, and those of the
    /// gel's shape for the gel alone.
    ///
    /// # Errors
    /// [`Error::Sensor`] for a frame of another shape, and for a field outside [`FIELD_MM`].
    pub(crate) fn view(&self, frame: [u32; 2], crop: Option<Rect>) -> Result<View> {
        self.view_at(frame, crop, None)
    }

    /// [`Sensor::view`] of a frame of which a pixel has `stated` millimetres, if that is known.
    ///
    /// # Errors
    /// As [`Sensor::view`].
    pub(crate) fn view_at(
        &self,
        frame: [u32; 2],
        crop: Option<Rect>,
        stated: Option<f32>,
    ) -> Result<View> {
        let [width, height] = frame;
        let all = Rect { x: 0, y: 0, width, height };
        let mut gel = all;
        let mut mm_per_pixel = self.mm_per_pixel;
        let mut lens = Lens::of([0.0; 2], frame.map(f64::from), self.distortion);
        if let Some([w, h]) = self.frame {
            let own = self.gel.unwrap_or(Rect { x: 0, y: 0, width: w, height: h });
            let scale = if same_shape(frame, [w, h]) {
                let scale = [f64::from(width) / f64::from(w), f64::from(height) / f64::from(h)];
                gel = own.scaled(scale, frame);
                scale[0]
            } else if same_shape(frame, [own.width, own.height]) {
                let scale = f64::from(width) / f64::from(own.width);
                let origin = [own.x, own.y].map(|at| -f64::from(at) * scale);
                lens =
                    Lens::of(origin, [w, h].map(|side| f64::from(side) * scale), self.distortion);
                scale
            } else {
                return Err(self.fail(format!(
                    "expected frames of the shape of {w} × {h} pixels, or of its gel's {} × {}; got \
                     {width} × {height}",
                    own.width, own.height
                )));
            };
            mm_per_pixel = mm_per_pixel.map(|mm| (f64::from(mm) / scale) as f32);
        }
        let shorter = gel.width.min(gel.height) as f32;
        let mm_per_pixel = stated.or(mm_per_pixel).unwrap_or(PAPER_MM / shorter);
        let part = crop.unwrap_or(gel);
        let field = part.width.max(part.height) as f32 * mm_per_pixel;
        let [least, most] = FIELD_MM;
        // Rounded to whole pixels, a field at the end of the range may lie a hair past it.
        let fits = (least * 0.999..=most * 1.001).contains(&field);
        self.expect(fits, || {
            format!(
                "expected a field of {least} to {most} mm along its longer side, got {field:.3} mm: \
                 {} pixels of {mm_per_pixel:.5} mm",
                part.width.max(part.height)
            )
        })?;
        Ok(View { frame, part, middle: part.middle(), mm_per_pixel, lens })
    }

    /// The part of this sensor's frames of size `other` that shows what a view's part does; `None` for what
    /// they do not show, and for a sensor without a size of its own.
    pub(crate) fn same_part(&self, view: &View, other: [u32; 2]) -> Option<Rect> {
        self.frame?;
        // Where the whole frame's middle is in each, and how large the whole frame.
        let lens = |size| self.view(size, None).ok().map(|view| view.lens);
        let (here, there) = (lens(view.frame)?, lens(other)?);
        let scale = there.half_diagonal / here.half_diagonal;
        let side = |axis: usize, at: u32, length: u32| {
            let edge = |at: u32| ((at as f32 - here.axis[axis]) * scale + there.axis[axis]).round();
            let (from, to, all) = (edge(at), edge(at + length), other[axis] as f32);
            let rounding = SAME_SHAPE as f32 * all;
            let shown = from >= -rounding && to <= all + rounding;
            let (from, to) = (from.max(0.0), to.min(all));
            (shown && from < to).then_some((from as u32, (to - from) as u32))
        };
        let (x, width) = side(0, view.part.x, view.part.width)?;
        let (y, height) = side(1, view.part.y, view.part.height)?;
        Some(Rect { x, y, width, height })
    }
}

/// What a frame shows of a sensor that nobody named: the paper's. A frame of its shape has the gel where
/// the paper's has; any other shows gel all over, 40 mm along its shorter side, and of its longer one the
/// middle [`FIELD_MM`] at most.
pub(crate) fn assumed(frame: [u32; 2], crop: Option<Rect>) -> View {
    let [width, height] = frame;
    let paper = Sensor::paper().view(frame, None);
    let gel = paper.map_or(Rect { x: 0, y: 0, width, height }, |view| view.part);
    let gel = crop.unwrap_or(gel);
    let part = gel.central(FIELD_MM[1] / PAPER_MM);
    let mm_per_pixel = PAPER_MM / part.width.min(part.height) as f32;
    let lens = Lens::of([0.0; 2], frame.map(f64::from), 0.0);
    View { frame, part, middle: gel.middle(), mm_per_pixel, lens }
}

/// What is assumed of a frame that cannot be the paper's when nobody named its sensor, in a line.
pub(crate) fn assumption(frame: [u32; 2]) -> Option<String> {
    let [width, height] = frame;
    let known = Sensor::paper().view(frame, None).is_ok();
    (!known).then(|| {
        let View { part, mm_per_pixel, .. } = assumed(frame, None);
        let [across, along] = [part.width, part.height].map(|side| side as f32 * mm_per_pixel);
        let seen = match [part.width, part.height] == frame {
            true => "it is taken for".to_owned(),
            false => {
                format!("its central {} × {} pixels are taken for", part.width, part.height)
            }
        };
        let named = Sensor::NAMES.into_iter().find(|name| {
            Sensor::named(name).is_some_and(|sensor| sensor.frame == Some(frame))
        });
        let like = named.map_or(String::new(), |name| format!(", not for one of {name}'s"));
        format!(
            "{width} × {height} is no frame of the paper's sensor: {seen} {across:.1} × {along:.1} mm{like}"
        )
    })
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

    #[test]
    fn the_papers_frames() {
        let paper = Sensor::paper();
        paper.check().expect("a sound sensor");
        let raw = paper.view([1920, 1200], None).expect("a view");
        assert_eq!((raw.part, raw.mm_per_pixel), (rect(460, 100, 1000, 1000), 0.04));
        // 12.5 columns right of the middle and 25 rows above it.
        assert_eq!(raw.place_mm([972.5, 575.0]), [0.5, -1.0]);
        // Half as many pixels, and the gel alone at a quarter.
        let half = paper.view([960, 600], None).expect("a view");
        assert_eq!((half.part, half.mm_per_pixel), (rect(230, 50, 500, 500), 0.08));
        let gel = paper.view([250, 250], None).expect("a view");
        assert_eq!((gel.part, gel.mm_per_pixel), (rect(0, 0, 250, 250), 0.16));
        // A stated scale is that of the frame that came, not of the sensor's.
        let stated = paper.view_at([250, 250], None, Some(0.1)).expect("a view");
        assert_eq!((stated.part, stated.mm_per_pixel), (rect(0, 0, 250, 250), 0.1));
        let message = paper.view([640, 480], None).expect_err("an error").to_string();
        let want = "sensor `paper`: expected frames of the shape of 1920 × 1200 pixels, or of its gel's \
                    1000 × 1000; got 640 × 480";
        assert_eq!(message, want);
    }

    #[test]
    fn frames_of_two_sizes_show_the_same_in_these_parts() {
        let paper = Sensor::paper();
        let same =
            |frame, crop, other| paper.same_part(&paper.view(frame, crop).expect("a view"), other);
        // Half as many pixels, the gel alone at half, and a part of that.
        assert_eq!(same([960, 600], None, [1920, 1200]), Some(rect(460, 100, 1000, 1000)));
        assert_eq!(same([500, 500], None, [1920, 1200]), Some(rect(460, 100, 1000, 1000)));
        let part = Some(rect(10, 20, 300, 200));
        assert_eq!(same([500, 500], part, [1920, 1200]), Some(rect(480, 140, 600, 400)));
        // The gel alone does not show what is beside it.
        assert_eq!(same([1920, 1200], None, [500, 500]), Some(rect(0, 0, 500, 500)));
        assert_eq!(same([1920, 1200], Some(rect(300, 100, 1000, 1000)), [500, 500]), None);
        assert_eq!(same([1920, 1200], None, [640, 480]), None);
        let plain = Sensor::plain();
        let view = plain.view([100, 100], None).expect("a view");
        assert_eq!(plain.same_part(&view, [200, 200]), None);
    }

    #[test]
    fn without_a_sensor_the_papers_is_assumed() {
        assert_eq!(
            assumed([1920, 1200], None),
            Sensor::paper().view([1920, 1200], None).expect("a view")
        );
        assert_eq!(assumption([1920, 1200]), None);
        assert_eq!(assumption([500, 500]), None);
        let mini = assumed([320, 240], None);
        assert_eq!((mini.part, mini.mm_per_pixel), (rect(0, 0, 320, 240), 40.0 / 240.0));
        let want = "320 × 240 is no frame of the paper's sensor: it is taken for 53.3 × 40.0 mm, \
                    not for one of gelsight-mini's";
        assert_eq!(assumption([320, 240]).as_deref(), Some(want));
        // 60 mm at most: three halves of the shorter side.
        let long = assumed([200, 801], None);
        assert_eq!((long.part, long.mm_per_pixel), (rect(0, 250, 200, 300), 0.2));
        let want = "200 × 801 is no frame of the paper's sensor: its central 200 × 300 pixels are taken \
                    for 40.0 × 60.0 mm";
        assert_eq!(assumption([200, 801]).as_deref(), Some(want));
        // A part that is named is what shows the gel.
        let part = assumed([320, 240], Some(rect(10, 20, 125, 80)));
        assert_eq!((part.part, part.middle), (rect(12, 20, 120, 80), [72.5, 60.0]));
        // A line of pixels has a middle too.
        assert_eq!(assumed([1, 8192], None).part, rect(0, 4095, 1, 1));
    }

    /// κ = −0.1 at half of the half diagonal, 250 of 500 px: 250 (1 − 0.1 / 4) = 243.75 px.
    #[test]
    fn a_lens_bends_places_but_not_the_middle() {
        let text =
            r#"{ "name": "lens", "frame": [800, 600], "mm_per_pixel": 0.05, "distortion": -0.1 }"#;
        let view = Sensor::parse(text).expect("a sensor").view([800, 600], None).expect("a view");
        assert_eq!(view.place_mm([400.0, 300.0]), [0.0, 0.0]);
        let [x, y] = view.place_mm([600.0, 450.0]);
        assert!((x - 0.8 * 243.75 * 0.05).abs() < 1e-5 && (y - 0.6 * 243.75 * 0.05).abs() < 1e-5);
    }

    /// A picture of the gel alone, at half the size, shows what the whole frame shows there.
    #[test]
    fn a_lens_bends_the_gel_alone_as_in_the_whole_frame() {
        let text = r#"{ "name": "lens", "frame": [800, 600], "mm_per_pixel": 0.05, "distortion": -0.1,
            "gel": { "x": 300, "y": 100, "width": 400, "height": 400 } }"#;
        let sensor = Sensor::parse(&format!("\u{feff}{text}")).expect("a sensor after a mark");
        let whole = sensor.view([800, 600], None).expect("a view");
        let alone = sensor.view([200, 200], None).expect("a view");
        let (in_frame, in_gel) = (whole.place_mm([680.0, 140.0]), alone.place_mm([190.0, 20.0]));
        for (a, b) in in_frame.into_iter().zip(in_gel) {
            assert!((a - b).abs() < 1e-4, "{in_frame:?} {in_gel:?}");
        }
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
                "sensor `a`: expected a field of 10 to 60 mm along its longer side, got 70.000 mm: 100 \
                 pixels of 0.70000 mm",
            ),
            (
                r#"{ "name": "a", "frame": [100, 80], "gel": { "x": 90, "y": 0, "width": 11, "height": 9 } }"#,
                "sensor `a`: gel: expected a part of 100 × 80 pixels, got Rect { x: 90, y: 0, width: 11, \
                 height: 9 }",
            ),
            (
                r#"{ "name": "a", "gel": { "x": 0, "y": 0, "width": 1, "height": 1 } }"#,
                "sensor `a`: gel: expected `frame` beside it, got none",
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
        let wide = Sensor::of_scale(0.05).view([2000, 10], None).expect_err("an error").to_string();
        assert!(wide.contains("10 to 60 mm") && wide.contains("100.000 mm"), "{wide}");
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
