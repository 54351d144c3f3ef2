//! The conditions of a wide picture: how its sensor differs from the plain one.
//!
//! Each picture draws a few conditions strongly and the rest mildly, so that conditions meet in
//! every combination. What was drawn stands in the picture's label; [`Forced`] sets single ones.

use std::fmt;
use std::str::FromStr;

use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::frame::{FIELD_MM, Frame};
use super::label::PixelBox;

/// From what a picture's conditions are drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Distribution {
    /// The paper's sensor.
    #[default]
    Plain,
    /// Wider than any one sensor; a fifth of it is plain.
    Wide,
}

/// What a picture's shading comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optics {
    /// A mixture of a measured sensor's lights.
    Measured,
    /// Lamps at finite angles over a matt coating.
    Lamps,
}

/// How the gel's surface follows what presses on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mechanics {
    /// The elastic layer in contact.
    Elastic,
    /// The part's own relief, smoothed: no mechanics, but what other renderers draw.
    Smoothed,
}

/// A picture's conditions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// Whether the picture was drawn as a plain one, whatever the distribution.
    pub plain: bool,
    /// What the shading comes from.
    pub optics: Optics,
    /// How the gel follows.
    pub mechanics: Mechanics,
    /// Thickness of the gel in millimetres.
    pub gel_mm: f64,
    /// Contrast of the shading over a plain sensor's median.
    pub strength: f64,
    /// Share of a light that its shadows take away; 0 without shadows.
    pub shadows: f64,
    /// Colour of the light: 0 grey, 1 each channel a light of its own; negative: one channel.
    pub colour: f64,
    /// Factor on the brightness.
    pub exposure: f64,
    /// Pitch of printed markers in millimetres; 0 without.
    pub markers_mm: f64,
    /// Standard deviation of the coating's clouds.
    pub mottle: f64,
    /// Quality of the JPEG that the picture went through, if it did.
    pub jpeg: Option<u8>,
    /// Standard deviation of the blur in pixels.
    pub blur_px: f64,
    /// Share of the light that is lost in the picture's corners.
    pub vignetting: f64,
    /// Whether the picture's edges show the housing.
    pub housing: bool,
    /// Radial distortion, [`Camera::distortion`](super::camera::Camera::distortion).
    pub distortion: f64,
    /// Signal over noise at saturation, in decibels.
    pub snr_db: f64,
    /// What of the picture shows gel, in pixels.
    pub window: PixelBox,
}

/// Contrast ([`Shading::contrast`](super::optics::Shading::contrast)) of a plain sensor, the
/// median of those drawn.
pub const TYPICAL_CONTRAST: f64 = 0.1;

/// A condition that can be strong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Strong {
    Strength,
    Shadows,
    Colour,
    Exposure,
    Markers,
    Mottle,
    Jpeg,
    Blur,
    Vignetting,
    Housing,
    Distortion,
    Noise,
}

const STRONG: [Strong; 12] = [
    Strong::Strength,
    Strong::Shadows,
    Strong::Colour,
    Strong::Exposure,
    Strong::Markers,
    Strong::Mottle,
    Strong::Jpeg,
    Strong::Blur,
    Strong::Vignetting,
    Strong::Housing,
    Strong::Distortion,
    Strong::Noise,
];

impl Conditions {
    /// Draws the frame and the conditions of a wide picture.
    pub fn sample(rng: &mut Pcg64, forced: &Forced) -> (Frame, Self) {
        let frame = sample_frame(rng, forced);
        let count = match rng.random_range(0..10) {
            _ if forced.mild => 0,
            0 => 0,
            1..4 => 1,
            4..7 => 2,
            7..9 => 3,
            _ => 4,
        };
        let strong: Vec<Strong> = STRONG.sample(rng, count).copied().collect();
        let is = |condition: Strong| strong.contains(&condition);
        let mild = forced.mild;

        let optics = if rng.random_bool(if mild { 0.7 } else { 0.35 }) {
            Optics::Measured
        } else {
            Optics::Lamps
        };
        let mechanics = match rng.random_bool(0.25) {
            true if !mild => Mechanics::Smoothed,
            _ => Mechanics::Elastic,
        };
        let gel_mm = if rng.random_bool(0.4) || mild { 4.0 } else { rng.random_range(2.5..6.0) };
        // Drawn evenly over its logarithm: between these.
        let log =
            |rng: &mut Pcg64, low: f64, high: f64| rng.random_range(low.ln()..high.ln()).exp();
        let strength = if is(Strong::Strength) || is(Strong::Shadows) {
            log(rng, 2.0, 4.0)
        } else if mild {
            log(rng, 0.8, 1.4)
        } else {
            log(rng, 0.8, 2.2)
        };
        let shadows = if is(Strong::Shadows) {
            rng.random_range(0.5..1.0)
        } else if !mild && rng.random_bool(0.35) {
            rng.random_range(0.1..0.6)
        } else {
            0.0
        };
        let colour = match rng.random_range(0.0..1.0) {
            _ if is(Strong::Colour) => rng.random_range(0.5..1.0),
            u if u < 0.2 => -1.0,
            u if u < 0.45 => rng.random_range(0.0..0.12),
            u if u < 0.65 => rng.random_range(0.12..0.6),
            // Three coloured lights, as on most sensors that can be bought.
            _ => rng.random_range(0.6..1.0),
        };
        let exposure = match is(Strong::Exposure) {
            true if rng.random_bool(0.6) => rng.random_range(1.4..2.5),
            true => rng.random_range(0.25..0.6),
            false => rng.random_range(0.8..1.25),
        };
        let markers_mm = if is(Strong::Markers) { rng.random_range(1.0..4.0) } else { 0.0 };
        let mottle = if is(Strong::Mottle) {
            rng.random_range(0.02..0.05)
        } else {
            rng.random_range(0.002..0.02)
        };
        let jpeg = match is(Strong::Jpeg) {
            true => Some(rng.random_range(40..80)),
            false if !mild && rng.random_bool(0.3) => Some(rng.random_range(80..=95)),
            false => None,
        };
        // Blur belongs to the lens: it grows with the pixels a millimetre.
        let sharp =
            if is(Strong::Blur) { rng.random_range(2.0..4.5) } else { rng.random_range(0.5..2.0) };
        let blur_px = (sharp * 0.04 / frame.mm_per_pixel).clamp(0.4, 6.0);
        let vignetting = if is(Strong::Vignetting) {
            rng.random_range(0.3..0.7)
        } else {
            rng.random_range(0.0..0.2)
        };
        let housing = is(Strong::Housing);
        let distortion = if is(Strong::Distortion) {
            rng.random_range(-0.12..0.12)
        } else {
            rng.random_range(-0.02..0.02)
        };
        let snr_db = if is(Strong::Noise) {
            rng.random_range(28.0..36.0)
        } else {
            rng.random_range(38.0..48.0)
        };
        let [width, height] = frame.size_px();
        let mut window = [0.0, 0.0, width, height];
        if forced.housing.unwrap_or(housing) {
            let mut inset = |side: f64| {
                if rng.random_bool(0.7) {
                    (side * rng.random_range(0.01..0.1)).round()
                } else {
                    0.0
                }
            };
            window = [inset(width), inset(height), width - inset(width), height - inset(height)];
        }
        let mut conditions = Self {
            plain: false,
            optics,
            mechanics,
            gel_mm,
            strength,
            shadows,
            colour,
            exposure,
            markers_mm,
            mottle,
            jpeg,
            blur_px,
            vignetting,
            housing,
            distortion,
            snr_db,
            window,
        };
        conditions.force(rng, forced);
        (frame, conditions)
    }

    fn force(&mut self, rng: &mut Pcg64, forced: &Forced) {
        let mut set = |target: &mut f64, span: Option<Span>| {
            if let Some(span) = span {
                *target = span.sample(rng);
            }
        };
        set(&mut self.strength, forced.strength);
        set(&mut self.shadows, forced.shadows);
        set(&mut self.colour, forced.colour);
        set(&mut self.exposure, forced.exposure);
        set(&mut self.markers_mm, forced.markers);
        set(&mut self.mottle, forced.mottle);
        set(&mut self.blur_px, forced.blur);
        set(&mut self.vignetting, forced.vignetting);
        set(&mut self.distortion, forced.distortion);
        set(&mut self.snr_db, forced.snr);
        set(&mut self.gel_mm, forced.gel);
        if let Some(span) = forced.jpeg {
            self.jpeg = Some(span.sample(rng).round() as u8);
        }
        self.housing = forced.housing.unwrap_or(self.housing);
        self.optics = forced.optics.unwrap_or(self.optics);
        self.mechanics = forced.mechanics.unwrap_or(self.mechanics);
    }
}

/// Frames in pixels that sensors have.
const FRAMES_PX: [[usize; 2]; 9] = [
    [640, 480],
    [640, 480],
    [480, 640],
    [320, 240],
    [240, 320],
    [640, 640],
    [800, 600],
    [512, 512],
    [400, 300],
];

/// Fewest pixels a millimetre: three quarters of the scale that the network sees.
const LEAST_PX_PER_MM: f64 = 6.0;

fn sample_frame(rng: &mut Pcg64, forced: &Forced) -> Frame {
    let mut frame = match rng.random_range(0..100) {
        _ if forced.mild => Frame::PAPER,
        0..20 => Frame::PAPER,
        20..40 => Frame::GELSIGHT_MINI,
        _ => {
            let [width, height] = *FRAMES_PX.choose(rng).unwrap_or(&[640, 480]);
            let longer = width.max(height) as f64;
            let most = FIELD_MM[1].min(longer / LEAST_PX_PER_MM);
            let field = rng.random_range(FIELD_MM[0].ln()..most.ln()).exp();
            Frame { width, height, mm_per_pixel: field / longer }
        }
    };
    frame = forced.frame.unwrap_or(frame);
    if let Some(scale) = forced.scale {
        let field = frame.longer_mm() / scale.sample(rng);
        // Where the field would pass an end of the range, it is at that end.
        frame.mm_per_pixel = field.clamp(FIELD_MM[0], FIELD_MM[1]) / frame.longer_px() as f64;
    }
    // Four digits are more than a sensor is known by.
    frame.mm_per_pixel = (frame.mm_per_pixel * 1e5).round() / 1e5;
    frame
}

/// A number, or a range from which it is drawn evenly.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Span {
    /// Least.
    pub low: f64,
    /// Greatest.
    pub high: f64,
}

impl Span {
    /// Draws a number.
    pub fn sample(self, rng: &mut Pcg64) -> f64 {
        if self.low < self.high { rng.random_range(self.low..self.high) } else { self.low }
    }
}

/// Conditions that every picture of a data set shares; the others are drawn.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Forced {
    /// Whether the frame is the paper's and all that is not forced is drawn weakly.
    pub mild: bool,
    /// The frame.
    pub frame: Option<Frame>,
    /// Factor on the size at which things appear, beside the frame's own scale, as far as fields of
    /// [`FIELD_MM`] go.
    pub scale: Option<Span>,
    /// See [`Conditions::strength`].
    pub strength: Option<Span>,
    /// See [`Conditions::shadows`].
    pub shadows: Option<Span>,
    /// See [`Conditions::colour`].
    pub colour: Option<Span>,
    /// See [`Conditions::exposure`].
    pub exposure: Option<Span>,
    /// See [`Conditions::markers_mm`].
    pub markers: Option<Span>,
    /// See [`Conditions::mottle`].
    pub mottle: Option<Span>,
    /// See [`Conditions::jpeg`].
    pub jpeg: Option<Span>,
    /// See [`Conditions::blur_px`].
    pub blur: Option<Span>,
    /// See [`Conditions::vignetting`].
    pub vignetting: Option<Span>,
    /// See [`Conditions::housing`].
    pub housing: Option<bool>,
    /// See [`Conditions::distortion`].
    pub distortion: Option<Span>,
    /// See [`Conditions::snr_db`].
    pub snr: Option<Span>,
    /// See [`Conditions::gel_mm`].
    pub gel: Option<Span>,
    /// See [`Conditions::optics`].
    pub optics: Option<Optics>,
    /// See [`Conditions::mechanics`].
    pub mechanics: Option<Mechanics>,
    /// Whether hooks grow from a wall.
    pub wall: Option<bool>,
    /// Whether hooks lie on their side.
    pub side: Option<bool>,
    /// Whether snaps are cut by the picture's edge.
    pub cut: Option<bool>,
    /// Whether snaps touch other parts.
    pub touching: Option<bool>,
    /// Number of a stud's slots.
    pub slots: Option<Span>,
    /// Diameter of a stud's hole in millimetres.
    pub hole: Option<Span>,
    /// How far the bead of a stud, or of a ring without slots, stands out, in millimetres.
    pub bead: Option<Span>,
    /// Radius of the edges of a stud, or of a ring without slots, in millimetres.
    pub fillet: Option<Span>,
    /// Depth of snaps in millimetres.
    pub depth: Option<Span>,
}

/// A condition that cannot be forced as asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{item:?}: expected {expected}")]
pub struct ForceError {
    item: String,
    expected: String,
}

/// Keys whose values are numbers, with the numbers they take.
const NUMBERS: [(&str, f64, f64); 18] = [
    ("scale", 0.25, 4.0),
    ("strength", 0.1, 10.0),
    ("shadows", 0.0, 1.0),
    ("colour", -1.0, 1.0),
    ("exposure", 0.05, 5.0),
    ("markers", 0.0, 20.0),
    ("mottle", 0.0, 0.5),
    ("jpeg", 1.0, 100.0),
    ("blur", 0.0, 20.0),
    ("vignetting", 0.0, 1.0),
    ("distortion", -0.2, 0.2),
    ("snr", 10.0, 60.0),
    ("gel", 0.5, 20.0),
    ("slots", 2.0, 6.0),
    ("hole", 0.5, 8.0),
    ("bead", 0.0, 0.6),
    ("fillet", 0.02, 1.0),
    ("depth", 0.05, 3.0),
];

/// Keys that are or are not.
const FLAGS: [&str; 6] = ["mild", "housing", "wall", "side", "cut", "touching"];

impl Forced {
    /// Whether snaps are drawn as in plain pictures.
    pub fn leaves_parts_plain(&self) -> bool {
        let stud = [self.slots, self.hole, self.bead, self.fillet];
        let shaped = self.wall.or(self.side).is_some() || stud.iter().any(Option::is_some);
        self.mild && !shaped
    }

    /// Sets one condition from `key` or `key=value`; a number may be a range, `low..high`.
    ///
    /// # Errors
    /// [`ForceError`] with the keys or values there are.
    pub fn set(&mut self, item: &str) -> Result<(), ForceError> {
        let error = |expected: String| ForceError { item: item.to_owned(), expected };
        let (key, value) = match item.split_once('=') {
            Some((key, value)) => (key, Some(value)),
            None => (item, None),
        };
        if let Some((_, least, most)) = NUMBERS.iter().find(|(name, ..)| *name == key) {
            let wanted = || error(format!("{key}=X or {key}=X..Y with {least} ≤ X ≤ Y ≤ {most}"));
            let text = match value {
                // A shadow without a depth is a deep one.
                None if key == "shadows" => "0.6..1",
                None => return Err(wanted()),
                Some(text) => text,
            };
            let (low, high) = text.split_once("..").unwrap_or((text, text));
            let (Ok(low), Ok(high)) = (low.parse::<f64>(), high.parse::<f64>()) else {
                return Err(wanted());
            };
            if !(*least <= low && low <= high && high <= *most) {
                return Err(wanted());
            }
            let target = match key {
                "scale" => &mut self.scale,
                "strength" => &mut self.strength,
                "shadows" => &mut self.shadows,
                "colour" => &mut self.colour,
                "exposure" => &mut self.exposure,
                "markers" => &mut self.markers,
                "mottle" => &mut self.mottle,
                "jpeg" => &mut self.jpeg,
                "blur" => &mut self.blur,
                "vignetting" => &mut self.vignetting,
                "distortion" => &mut self.distortion,
                "snr" => &mut self.snr,
                "gel" => &mut self.gel,
                "slots" => &mut self.slots,
                "hole" => &mut self.hole,
                "bead" => &mut self.bead,
                "fillet" => &mut self.fillet,
                _ => &mut self.depth,
            };
            *target = Some(Span { low, high });
            return Ok(());
        }
        if FLAGS.contains(&key) {
            let flag = match value {
                None | Some("yes") => true,
                Some("no") => false,
                Some(_) => return Err(error(format!("{key}, {key}=yes or {key}=no"))),
            };
            match key {
                "mild" => self.mild = flag,
                "housing" => self.housing = Some(flag),
                "wall" => self.wall = Some(flag),
                "side" => self.side = Some(flag),
                "cut" => self.cut = Some(flag),
                _ => self.touching = Some(flag),
            }
            return Ok(());
        }
        match (key, value) {
            ("frame", Some("paper")) => self.frame = Some(Frame::PAPER),
            ("frame", Some("gelsight-mini")) => self.frame = Some(Frame::GELSIGHT_MINI),
            ("frame", Some(text)) => {
                let wanted = || {
                    error(
                        "frame=paper, frame=gelsight-mini or frame=WIDTHxHEIGHT@MM_PER_PIXEL"
                            .into(),
                    )
                };
                self.frame = Some(parse_frame(text).ok_or_else(wanted)?);
            }
            ("optics", Some("measured")) => self.optics = Some(Optics::Measured),
            ("optics", Some("lamps")) => self.optics = Some(Optics::Lamps),
            ("mechanics", Some("elastic")) => self.mechanics = Some(Mechanics::Elastic),
            ("mechanics", Some("smoothed")) => self.mechanics = Some(Mechanics::Smoothed),
            ("optics", _) => return Err(error("optics=measured or optics=lamps".into())),
            ("mechanics", _) => {
                return Err(error("mechanics=elastic or mechanics=smoothed".into()));
            }
            _ => {
                let numbers: Vec<&str> = NUMBERS.iter().map(|(name, ..)| *name).collect();
                return Err(error(format!(
                    "one of {}, frame, optics, mechanics, {}",
                    numbers.join(", "),
                    FLAGS.join(", ")
                )));
            }
        }
        Ok(())
    }
}

/// `WIDTHxHEIGHT@MM_PER_PIXEL` with a field that the simulator draws.
fn parse_frame(text: &str) -> Option<Frame> {
    let (size, mm) = text.split_once('@')?;
    let (width, height) = size.split_once('x')?;
    let frame = Frame {
        width: width.parse().ok()?,
        height: height.parse().ok()?,
        mm_per_pixel: mm.parse().ok()?,
    };
    let in_range = (FIELD_MM[0]..=FIELD_MM[1]).contains(&frame.longer_mm());
    let drawable = frame.width.min(frame.height) >= 32 && frame.longer_px() <= 4000;
    (in_range && drawable).then_some(frame)
}

impl FromStr for Forced {
    type Err = ForceError;

    /// Reads conditions separated by commas.
    fn from_str(text: &str) -> Result<Self, ForceError> {
        let mut forced = Self::default();
        for item in text.split(',').filter(|item| !item.is_empty()) {
            forced.set(item)?;
        }
        Ok(forced)
    }
}

impl fmt::Display for Forced {
    /// Writes the conditions as they are read.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fields = serde_json::to_value(self).map_err(|_| fmt::Error)?;
        let mut separator = "";
        for (key, value) in fields.as_object().into_iter().flatten() {
            let value = match value {
                Value::Null => continue,
                Value::Bool(false) if key == "mild" => continue,
                Value::Bool(flag) => (if *flag { "yes" } else { "no" }).to_owned(),
                Value::String(name) => name.clone(),
                fields => match (fields.get("low"), fields.get("high")) {
                    (Some(low), Some(high)) => format!("{low}..{high}"),
                    _ => {
                        let frame = self.frame.unwrap_or(Frame::PAPER);
                        format!("{}x{}@{}", frame.width, frame.height, frame.mm_per_pixel)
                    }
                },
            };
            write!(f, "{separator}{key}={value}")?;
            separator = ",";
        }
        Ok(())
    }
}
