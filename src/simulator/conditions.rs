//! The conditions of a wide picture: how its sensor differs from the plain one.
//!
//! Each picture draws a few conditions strongly and the rest mildly, so that conditions meet in
//! every combination. What was drawn stands in the picture's label; [`Forced`] sets single ones.

use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::forced::{Forced, Span};
use super::options::{MILD_GEL_MM, Mechanics, Optics};
use super::raster::PixelBox;
use super::raster::{FIELD_MM, Raster};

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
    /// Contrast of the shading over [`UNIT_CONTRAST`], as drawn: lamps whose own contrast is low reach
    /// three times that at most, [`Lamps::set_contrast`](super::lamps::Lamps::set_contrast).
    pub strength: f64,
    /// Share of a light that its shadows take away; 0 without shadows.
    pub shadows: f64,
    /// Colour of the light: 0 grey, 1 each channel a light of its own; negative: one channel.
    pub colour: f64,
    /// Factor on the brightness, as drawn: a gel that it would overexpose is given a darker coating,
    /// [`Coating::limit_level`](super::coating::Coating::limit_level), so that above about 1.4 many
    /// pictures are less bright than it says, and none has gel that is white all over.
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
    /// Share of the light that gel lacks which is pressed deep, as where a dark coating lies behind a
    /// grey gel; 0 without.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub darkness: f64,
    /// Change of brightness, as a share, where the gel turns up from what presses; 0 without.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub rim: f64,
    /// Direction on the gel from which the light comes where it comes from one side, in degrees from x
    /// towards y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_deg: Option<f64>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Contrast ([`Shading::contrast`](super::optics::Shading::contrast)) of a strength of 1.
/// Plain sensors have 0.06 to 0.31 (nine in ten of them), half of them less than 0.12.
pub const UNIT_CONTRAST: f64 = 0.1;

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
    pub fn sample(rng: &mut Pcg64, forced: &Forced) -> (Raster, Self) {
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
        let gel_mm =
            if rng.random_bool(0.4) || mild { MILD_GEL_MM } else { rng.random_range(2.5..6.0) };
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
            darkness: 0.0,
            rim: 0.0,
            light_deg: None,
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
        set(&mut self.darkness, forced.darkness);
        set(&mut self.rim, forced.rim);
        if let Some(span) = forced.jpeg {
            self.jpeg = Some(span.sample(rng).round() as u8);
        }
        self.housing = forced.housing.unwrap_or(self.housing);
        self.optics = forced.optics.unwrap_or(self.optics);
        if let Some(span) = forced.light {
            self.light_deg = Some(span.sample(rng));
            self.optics = Optics::Lamps;
        }
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

fn sample_frame(rng: &mut Pcg64, forced: &Forced) -> Raster {
    let mut frame = match rng.random_range(0..100) {
        _ if forced.mild => Raster::PAPER,
        0..20 => Raster::PAPER,
        20..40 => Raster::GELSIGHT_MINI,
        _ => {
            let [width, height] = *FRAMES_PX.choose(rng).unwrap_or(&[640, 480]);
            let longer = width.max(height) as f64;
            let most = FIELD_MM[1].min(longer / LEAST_PX_PER_MM);
            let field = rng.random_range(FIELD_MM[0].ln()..most.ln()).exp();
            Raster { width, height, mm_per_pixel: field / longer }
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
