//! A user's own sensor, as its file describes it: pictures are drawn as it would take them.
//!
//! Frame, the gel's part of it, scale and distortion replace what is drawn by lot; so do the light, if
//! the file has one, and, if it names a frame without contact, the flat gel's picture: its colours,
//! texture, print and housing are then those of that frame. Its noise is in it too, and the same in
//! all pictures. Printed dots on it stay where they are when the gel moves.

use std::path::PathBuf;

use super::Error;
use super::appearance::{Appearance, Flat, Housing, Light};
use super::conditions::{Conditions, UNIT_CONTRAST};
use super::forced::{Forced, Span};
use super::optics::{Channel, Shading};
use super::options::Optics;
use super::raster::PixelBox;
use super::raster::{Raster, SIDE_PX};
use crate::picture;
use crate::sensor::rect::Rect;
use crate::sensor::scale::PAPER_MM;
use crate::sensor::{Sensed, Sensor};

/// Levels of a housing that nothing shows.
const DARK: f32 = 8.0;

/// A sensor that pictures are drawn for.
#[derive(Debug, Clone, PartialEq)]
pub struct Given {
    sensor: Sensor,
    frame: Raster,
    gel: Rect,
    window: PixelBox,
    shading: Option<Shading>,
    flat: Option<Flat>,
}

impl Given {
    /// Takes a sensor, and reads its frame without contact if it names one.
    ///
    /// # Errors
    /// [`Error::Sensor`] for one that cannot be, that takes frames of any size, or of which a frame is
    /// too large to be drawn; [`Error::Picture`] and [`Error::Content`] for a frame without contact that
    /// cannot be read or has another size.
    pub fn new(mut sensor: Sensor) -> Result<Self, Error> {
        sensor.check()?;
        // A data set that is continued reads it again, and wants the same.
        sensor.light = sensor.light.map(|light| light.rounded());
        sensor.reference_frame = None;
        let fail = |message: String| {
            Error::Sensor(crate::error::Error::Sensor { sensor: sensor.name.clone(), message })
        };
        let Some([width, height]) = sensor.frame else {
            return Err(fail("frame: expected one to draw, got none".into()));
        };
        let Sensed { gel, scale, .. } = sensor.sense([width, height])?;
        // The detector assumes the same of a sensor without a scale.
        let assumed = PAPER_MM / gel.width.min(gel.height) as f32;
        let mm_per_pixel = scale.map_or(assumed, |scale| scale.mm_per_pixel);
        let frame = Raster {
            width: width as usize,
            height: height as usize,
            // As many digits as single precision has.
            mm_per_pixel: (f64::from(mm_per_pixel) * 1e7).round() / 1e7,
        };
        if !frame.is_drawable() {
            let [least, most] = SIDE_PX;
            let expected = format!("sides of {least} to {most} pixels to draw");
            return Err(fail(format!("frame: expected {expected}, got {width} × {height}")));
        }
        let window = [gel.x, gel.y, gel.x + gel.width, gel.y + gel.height].map(f64::from);
        let shading = sensor.light.map(|light| {
            // There y is in halves of the width, in a look in halves of the height.
            let tall = f64::from(height) / f64::from(width);
            let scaled = |row: [f64; 6]| {
                let [one, x, y, xx, xy, yy] = row;
                [one, x, y * tall, xx, xy * tall, yy * tall * tall]
            };
            Shading { channels: light.channels.map(|channel: Channel| channel.map(scaled)) }
        });
        let flat = match &sensor.reference {
            Some(path) => Some(read_flat(path, [width, height])?),
            None => None,
        };
        Ok(Self { sensor, frame, gel, window, shading, flat })
    }

    /// The sensor.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The part of its frame that shows the gel.
    pub fn gel(&self) -> Rect {
        self.gel
    }

    /// The frame that it takes.
    pub fn frame(&self) -> Raster {
        self.frame
    }

    /// The first condition that is `forced` though the sensor states it.
    pub fn stated(&self, forced: &Forced) -> Option<&'static str> {
        let (light, flat) = (self.shading.is_some(), self.flat.is_some());
        let both = [
            ("frame", true, forced.frame.is_some()),
            ("scale", true, forced.scale.is_some()),
            ("distortion", true, forced.distortion.is_some()),
            ("housing", true, forced.housing.is_some()),
            ("optics", light, forced.optics.is_some()),
            ("light", light, forced.light.is_some()),
            ("strength", light, forced.strength.is_some()),
            ("colour", light || flat, forced.colour.is_some()),
            ("markers", flat || self.sensor.markers.is_some(), forced.markers.is_some()),
            ("vignetting", flat, forced.vignetting.is_some()),
            ("mottle", flat, forced.mottle.is_some()),
        ];
        both.into_iter().find(|(_, stated, forced)| *stated && *forced).map(|(key, ..)| key)
    }

    /// Conditions to be drawn: those that are `forced`, and what the sensor states.
    pub fn force(&self, forced: &Forced) -> Forced {
        let exactly = |value: f64| Some(Span { low: value, high: value });
        let mut forced = forced.clone();
        forced.frame = Some(self.frame);
        forced.distortion = exactly(self.sensor.distortion.into());
        forced.housing = Some(false);
        if self.shading.is_some() {
            forced.optics = Some(Optics::Measured);
        }
        if self.flat.is_some() {
            // What the frame without contact shows is not drawn a second time.
            forced.markers = exactly(0.0);
            forced.vignetting = exactly(0.0);
            forced.mottle = exactly(0.0);
            forced.exposure = forced.exposure.or(exactly(1.0));
        } else if let Some(markers) = self.sensor.markers {
            forced.markers = exactly(markers.pitch_mm.into());
        }
        forced
    }

    /// Writes the sensor's own into drawn conditions.
    pub fn state(&self, conditions: &mut Conditions) {
        conditions.window = self.window;
        if self.shading.is_some() || self.flat.is_some() {
            // Which channels there are is the sensor's, not drawn.
            conditions.colour = conditions.colour.max(0.0);
        }
        if let Some(shading) = &self.shading {
            conditions.strength = shading.contrast() / UNIT_CONTRAST;
        }
    }

    /// Gives a drawn look the sensor's light, flat gel, print and housing.
    pub fn dress(&self, look: &mut Appearance) {
        if let Some(shading) = &self.shading {
            if let Some(shadows) = &mut look.shadows {
                for (channel, ray) in shadows.rays.iter_mut().take(3).enumerate() {
                    ray.azimuth = shading.azimuth(channel);
                }
            }
            look.light = Light::Measured(Box::new(shading.clone()));
        }
        let [width, height] = self.frame.size_px();
        if let Some(flat) = &self.flat {
            look.flat = Some(flat.clone());
            look.vignetting = 0.0;
        } else if self.window != [0.0, 0.0, width, height] {
            look.housing = Some(Housing {
                window: self.window,
                corner_px: 0.0,
                edge_px: 1.0,
                levels: [DARK; 3],
            });
        }
        if let (Some(markers), Some(own)) = (&mut look.markers, self.sensor.markers) {
            markers.size_mm = own.diameter_mm.into();
            markers.square = false;
            markers.jitter = 0.0;
            markers.missing = 0.0;
        }
        if let Some(flat) = &mut look.flat {
            flat.window = self.window;
        }
    }
}

fn read_flat(path: &PathBuf, [width, height]: [u32; 2]) -> Result<Flat, Error> {
    let read = picture::read(path);
    let read = read.map_err(|source| Error::Picture { path: path.clone(), source })?.into_rgb8();
    if read.dimensions() != (width, height) {
        return Err(Error::Content {
            path: path.clone(),
            expected: format!("{width} × {height} pixels as the sensor's frames"),
            found: format!("{} × {}", read.width(), read.height()),
        });
    }
    Ok(Flat { levels: read.into_raw().into(), window: [0.0; 4] })
}
