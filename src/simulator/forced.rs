//! Conditions that are set and not drawn: by name, as `smr-gpu simulate --force` reads them.

use std::fmt;
use std::str::FromStr;

use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::options::{Drive, MILD_GEL_MM, Mechanics, Optics};
use super::raster::{FIELD_MM, Raster};

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
    /// Whether the frame is the paper's and all that is not forced is drawn weakly, but for the lights'
    /// colour, which is drawn as ever.
    pub mild: bool,
    /// The frame.
    pub frame: Option<Raster>,
    /// Factor on the size at which things appear, beside the frame's own scale, as far as fields of
    /// [`FIELD_MM`] go.
    pub scale: Option<Span>,
    /// See [`Conditions::strength`](super::conditions::Conditions::strength).
    pub strength: Option<Span>,
    /// See [`Conditions::shadows`](super::conditions::Conditions::shadows).
    pub shadows: Option<Span>,
    /// See [`Conditions::colour`](super::conditions::Conditions::colour).
    pub colour: Option<Span>,
    /// See [`Conditions::exposure`](super::conditions::Conditions::exposure).
    pub exposure: Option<Span>,
    /// See [`Conditions::markers_mm`](super::conditions::Conditions::markers_mm).
    pub markers: Option<Span>,
    /// See [`Conditions::mottle`](super::conditions::Conditions::mottle).
    pub mottle: Option<Span>,
    /// See [`Conditions::jpeg`](super::conditions::Conditions::jpeg).
    pub jpeg: Option<Span>,
    /// See [`Conditions::blur_px`](super::conditions::Conditions::blur_px).
    pub blur: Option<Span>,
    /// See [`Conditions::vignetting`](super::conditions::Conditions::vignetting).
    pub vignetting: Option<Span>,
    /// See [`Conditions::housing`](super::conditions::Conditions::housing).
    pub housing: Option<bool>,
    /// See [`Conditions::distortion`](super::conditions::Conditions::distortion).
    pub distortion: Option<Span>,
    /// See [`Conditions::snr_db`](super::conditions::Conditions::snr_db).
    pub snr: Option<Span>,
    /// See [`Conditions::gel_mm`](super::conditions::Conditions::gel_mm).
    pub gel: Option<Span>,
    /// See [`Conditions::optics`](super::conditions::Conditions::optics).
    pub optics: Option<Optics>,
    /// See [`Conditions::mechanics`](super::conditions::Conditions::mechanics).
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
    /// The recess of screws' heads.
    pub drive: Option<Drive>,
    /// Free gel between parts that stand side by side, in millimetres: two to five of them then do.
    pub gap: Option<Span>,
    /// The longer side of snaps in millimetres.
    pub size: Option<Span>,
    /// Whether the barbs of hooks vary twice as much in length, width and rounding.
    pub barbs: Option<bool>,
    /// See [`Conditions::darkness`](super::conditions::Conditions::darkness).
    pub darkness: Option<Span>,
    /// See [`Conditions::rim`](super::conditions::Conditions::rim).
    pub rim: Option<Span>,
    /// See [`Conditions::light_deg`](super::conditions::Conditions::light_deg): lamps on that side alone.
    pub light: Option<Span>,
}

/// A condition that cannot be forced as asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{item:?}: expected {expected}")]
pub struct ForceError {
    item: String,
    expected: String,
}

/// Thinnest gel: the thinnest that is drawn, and as thin as look-alikes of up to 2 mm may press into.
const THINNEST_MM: f64 = 2.5;

/// Deepest that a snap may go as a share of the gel, as the deepest that are drawn: 2 mm of the thinnest.
/// Where it is tilted it goes on, and the acrylic is near.
const DEEPEST: f64 = 0.8;

/// Keys whose values are numbers, with the numbers they take.
const NUMBERS: [(&str, f64, f64); 23] = [
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
    ("gel", THINNEST_MM, 20.0),
    ("slots", 2.0, 6.0),
    ("hole", 0.5, 8.0),
    ("bead", 0.0, 0.6),
    ("fillet", 0.02, 1.0),
    ("depth", 0.05, 3.0),
    ("gap", 0.0, 10.0),
    ("size", 2.0, 15.0),
    ("darkness", 0.0, 0.95),
    ("rim", -0.9, 2.0),
    ("light", -180.0, 180.0),
];

/// Keys that are or are not.
const FLAGS: [&str; 7] = ["mild", "housing", "wall", "side", "cut", "touching", "barbs"];

impl Forced {
    /// Whether snaps are drawn as in plain pictures.
    pub fn leaves_parts_plain(&self) -> bool {
        let stud = [self.slots, self.hole, self.bead, self.fillet];
        let hook = [self.wall, self.side, self.barbs].contains(&Some(true)) || self.size.is_some();
        let shaped = hook || stud.iter().any(Option::is_some);
        self.mild && !shaped
    }

    /// Whether the gel is thick enough for the depth that is set.
    fn check_depth(&self) -> Result<(), ForceError> {
        let Some(depth) = self.depth else { return Ok(()) };
        let drawn = if self.mild { MILD_GEL_MM } else { THINNEST_MM };
        let gel = self.gel.map_or(drawn, |span| span.low);
        // To a micrometre.
        let most = (1e3 * DEEPEST * gel).round() / 1e3;
        if depth.high <= most {
            return Ok(());
        }
        Err(ForceError {
            item: format!("depth={}", depth.high),
            expected: format!(
                "at most {most} mm, {DEEPEST} of a gel that may have {gel} mm; gel=X makes it thicker"
            ),
        })
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
                "gap" => &mut self.gap,
                "size" => &mut self.size,
                "darkness" => &mut self.darkness,
                "rim" => &mut self.rim,
                "light" => &mut self.light,
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
                "barbs" => self.barbs = Some(flag),
                _ => self.touching = Some(flag),
            }
            return Ok(());
        }
        match (key, value) {
            ("frame", Some("paper")) => self.frame = Some(Raster::PAPER),
            ("frame", Some("gelsight-mini")) => self.frame = Some(Raster::GELSIGHT_MINI),
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
            ("drive", Some("cross")) => self.drive = Some(Drive::Cross),
            ("drive", Some("slot")) => self.drive = Some(Drive::Slot),
            ("drive", Some("hex")) => self.drive = Some(Drive::Hex),
            ("drive", _) => return Err(error("drive=cross, drive=slot or drive=hex".into())),
            ("optics", _) => return Err(error("optics=measured or optics=lamps".into())),
            ("mechanics", _) => {
                return Err(error("mechanics=elastic or mechanics=smoothed".into()));
            }
            _ => {
                let numbers: Vec<&str> = NUMBERS.iter().map(|(name, ..)| *name).collect();
                return Err(error(format!(
                    "one of {}, frame, optics, mechanics, drive, {}",
                    numbers.join(", "),
                    FLAGS.join(", ")
                )));
            }
        }
        Ok(())
    }
}

/// `WIDTHxHEIGHT@MM_PER_PIXEL` with a field that the simulator draws.
fn parse_frame(text: &str) -> Option<Raster> {
    let (size, mm) = text.split_once('@')?;
    let (width, height) = size.split_once('x')?;
    let frame = Raster {
        width: width.parse().ok()?,
        height: height.parse().ok()?,
        mm_per_pixel: mm.parse().ok()?,
    };
    let in_range = (FIELD_MM[0]..=FIELD_MM[1]).contains(&frame.longer_mm());
    (in_range && frame.is_drawable()).then_some(frame)
}

impl FromStr for Forced {
    type Err = ForceError;

    /// Reads conditions separated by commas, of which the depth must fit the gel.
    fn from_str(text: &str) -> Result<Self, ForceError> {
        let mut forced = Self::default();
        for item in text.split(',').filter(|item| !item.is_empty()) {
            forced.set(item)?;
        }
        forced.check_depth()?;
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
                        let frame = self.frame.unwrap_or(Raster::PAPER);
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
