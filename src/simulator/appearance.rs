//! A sensor's look, plain or as its conditions draw it.

use std::sync::Arc;

use glam::DVec2;
use rand::RngExt;
use rand_pcg::Pcg64;

use super::camera::Camera;
use super::coating::Coating;
use super::conditions::{Conditions, UNIT_CONTRAST};
use super::lamps::Lamps;
use super::markers::Markers;
use super::optics::Shading;
use super::options::Optics;
use super::raster::PixelBox;
use super::shadow::Ray;
use super::tone::Tone;

/// What answers to the slope of the surface.
#[derive(Debug, Clone, PartialEq)]
pub enum Light {
    /// A measured sensor.
    Measured(Box<Shading>),
    /// Lamps at finite angles.
    Lamps(Lamps),
}

/// Shadows.
#[derive(Debug, Clone, PartialEq)]
pub struct Shadows {
    /// Share of a light that is taken away.
    pub depth: f32,
    /// Least width of their edges in millimetres.
    pub soft_mm: f64,
    /// Half the angle over which a light reaches up and down, in radians.
    pub size: f64,
    /// The lights: of lamps each, of a measured sensor one for each channel.
    pub rays: Vec<Ray>,
}

/// The housing round the gel.
#[derive(Debug, Clone, PartialEq)]
pub struct Housing {
    /// What shows gel.
    pub window: PixelBox,
    /// Radius of the window's corners in pixels.
    pub corner_px: f64,
    /// Width of its edge in pixels.
    pub edge_px: f64,
    /// Its levels.
    pub levels: [f32; 3],
}

/// The picture of the flat gel.
#[derive(Debug, Clone, PartialEq)]
pub struct Flat {
    /// Its levels, three a pixel.
    pub levels: Arc<[u8]>,
    /// What of it shows gel; the rest is the same whatever presses.
    pub window: PixelBox,
}

impl Flat {
    /// Multiplies the gel's brightness over that of flat gel by its levels.
    pub(super) fn light(&self, plane: &mut [f32], width: usize, channel: usize) {
        let [left, top, right, bottom] = self.window;
        for (i, (value, pixel)) in plane.iter_mut().zip(self.levels.chunks_exact(3)).enumerate() {
            let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let gel = (left..right).contains(&x) && (top..bottom).contains(&y);
            *value = f32::from(pixel[channel]) * if gel { *value } else { 1.0 };
        }
    }
}

/// All that a sensor adds to a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance {
    /// The camera.
    pub camera: Camera,
    /// The light.
    pub light: Light,
    /// The coating.
    pub coating: Coating,
    /// The flat gel as it was photographed, in place of the coating.
    pub flat: Option<Flat>,
    /// Factor on the brightness.
    pub exposure: f32,
    /// Shadows, if any.
    pub shadows: Option<Shadows>,
    /// What the gel's depth does to its brightness, if anything.
    pub tone: Option<Tone>,
    /// Print on the gel, if any.
    pub markers: Option<Markers>,
    /// Share of the light lost in the corners.
    pub vignetting: f32,
    /// Housing in the picture, if any.
    pub housing: Option<Housing>,
    /// Whether the picture has one channel.
    pub grey: bool,
    /// Quality of the JPEG that the picture goes through, if it does.
    pub jpeg: Option<u8>,
}

impl Appearance {
    /// Draws a plain sensor with this camera.
    pub fn plain(rng: &mut Pcg64, camera: Camera) -> Self {
        let shading = Shading::sample(rng);
        let coating = Coating::sample(rng, &camera.frame);
        let exposure = rng.random_range(0.85f32..1.15);
        Self {
            camera,
            light: Light::Measured(Box::new(shading)),
            coating,
            flat: None,
            exposure,
            shadows: None,
            tone: None,
            markers: None,
            vignetting: 0.0,
            housing: None,
            grey: false,
            jpeg: None,
        }
    }

    /// Draws a sensor under these conditions.
    pub fn wide(rng: &mut Pcg64, camera: Camera, conditions: &Conditions) -> Self {
        let frame = camera.frame;
        let contrast = conditions.strength * UNIT_CONTRAST;
        let light = match conditions.optics {
            Optics::Measured => {
                let shading = Shading::sample_wide(rng, conditions.colour, contrast);
                Light::Measured(Box::new(shading))
            }
            Optics::Lamps => {
                let mut lamps = Lamps::sample(rng, frame.longer_mm(), conditions.colour.max(0.0));
                if let Some(degrees) = conditions.light_deg {
                    lamps.gather(rng, degrees.to_radians());
                }
                lamps.set_contrast(contrast);
                Light::Lamps(lamps)
            }
        };
        let elevation = rng.random_range(8f64..35.0).to_radians();
        let rays = match &light {
            Light::Lamps(lamps) => lamps.lamps.iter().map(|lamp| lamp.ray).collect(),
            Light::Measured(shading) => [0, 1, 2]
                .map(|channel| Ray { azimuth: shading.azimuth(channel), elevation })
                .to_vec(),
        };
        let soft_mm = rng.random_range(0.05..0.6);
        // From a single LED to a strip or a diffuser.
        let size = rng.random_range(0f64..12.0).to_radians();
        let shadows = (conditions.shadows > 0.0).then_some(Shadows {
            depth: conditions.shadows as f32,
            soft_mm,
            size,
            rays,
        });
        let mut coating = Coating::sample(rng, &frame);
        coating.set_mottle(conditions.mottle);
        coating.set_colour(rng, conditions.colour);
        // However long the exposure, slopes away from the light must still show. The label keeps it.
        coating.limit_level(rng.random_range(150.0..330.0) / conditions.exposure);
        let markers = (conditions.markers_mm > 0.0)
            .then(|| Markers::sample(rng, conditions.markers_mm, frame.mm_per_pixel));
        let toned = conditions.darkness > 0.0 || conditions.rim != 0.0;
        let tone = toned.then(|| Tone::sample(rng, conditions.darkness, conditions.rim));
        let longer = frame.longer_px() as f64;
        let level = rng.random_range(2.0..40.0);
        let housing = conditions.housing.then(|| Housing {
            window: conditions.window,
            corner_px: longer * rng.random_range(0.0..0.12),
            edge_px: rng.random_range(0.5..0.02 * longer),
            levels: [(); 3].map(|()| level * rng.random_range(0.6..1.4)),
        });
        Self {
            camera,
            light,
            coating,
            flat: None,
            exposure: conditions.exposure as f32,
            shadows,
            tone,
            markers,
            vignetting: conditions.vignetting as f32,
            housing,
            grey: conditions.colour < 0.0,
            jpeg: conditions.jpeg,
        }
    }
}

/// Least resultant of all lights' directions, over their sum, of light that comes from one side.
const ONE_SIDED: f64 = 0.7;

impl Appearance {
    /// The direction on the gel from which light comes, in degrees from x towards y, where it comes from
    /// one side.
    pub fn light_deg(&self) -> Option<f64> {
        let lights: Vec<DVec2> = match &self.light {
            Light::Lamps(lamps) => lamps.lamps.iter().map(|lamp| lamp.along_gel()).collect(),
            Light::Measured(shading) => [0, 1, 2].map(|c| shading.along_gel(c)).to_vec(),
        };
        let resultant: DVec2 = lights.iter().sum();
        let all: f64 = lights.iter().map(|light| light.length()).sum();
        (resultant.length() >= ONE_SIDED * all && all > 0.0)
            .then(|| resultant.y.atan2(resultant.x).to_degrees())
    }
}
