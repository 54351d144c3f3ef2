//! The picture that a sensor takes of a surface.
//!
//! In the order of the light: lamps or measured shading, shadows, the coating with its texture and
//! its print, uneven light, vignetting, the housing, the lens' blur, noise, 8 bits, JPEG. Channels
//! do not mix, the sensor does not bloom, and there is no demosaicing.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, RgbImage};
use rand_pcg::Pcg64;

use super::appearance::{Appearance, Light};
use super::camera::NormalTable;
use super::coating::Coating;
use super::lamps::Lamps;
use super::markers::Markers;
use super::optics::Shading;
use super::outline::rectangle;
use super::raster::Raster;
use super::shadow::{Ray, cast};
use super::surface::Surface;

/// How the gel moved sideways, for its print.
pub struct Sideways {
    /// Potential whose negative gradient is the displacement in millimetres.
    pub potential: Surface,
    /// Share of the parts' own motion that each place follows.
    pub share: Surface,
    /// The parts' own motion along the gel in millimetres.
    pub shear_mm: [f64; 2],
}

impl Sideways {
    /// Where the gel that is now at a point was at rest.
    pub fn rest(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [gx, gy] = self.potential.at(x, y).gradient;
        let share = f64::from(self.share.at(x, y).depth);
        [x + f64::from(gx) - share * self.shear_mm[0], y + f64::from(gy) - share * self.shear_mm[1]]
    }
}

/// Draws pictures; keeps buffers between them.
pub struct Painter {
    normal: NormalTable,
    texture: Vec<f32>,
    gradients: Vec<[f32; 2]>,
    /// Where each pixel's point of the surface lies, in millimetres, where that is needed.
    places: Vec<[f32; 2]>,
    lit: [Vec<f32>; 3],
    /// What depth and rims do to each pixel, where they do something.
    tones: Vec<f32>,
    plane: Vec<f32>,
    scratch: Vec<f32>,
}

impl Default for Painter {
    fn default() -> Self {
        Self::new()
    }
}

impl Painter {
    /// Makes the buffers.
    pub fn new() -> Self {
        Self {
            normal: NormalTable::new(),
            texture: Vec::new(),
            gradients: Vec::new(),
            places: Vec::new(),
            lit: [const { Vec::new() }; 3],
            tones: Vec::new(),
            plane: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// The picture that a sensor takes of this surface.
    pub fn paint(
        &mut self,
        look: &Appearance,
        surface: &Surface,
        sideways: Option<&Sideways>,
        rng: &mut Pcg64,
    ) -> RgbImage {
        let camera = &look.camera;
        let frame = camera.frame;
        let (width, height) = (frame.width, frame.height);
        let shadows = look.cast_shadows(surface);
        let lamps = matches!(look.light, Light::Lamps(_));
        let placed = lamps || look.markers.is_some() || !shadows.is_empty() || look.tone.is_some();
        // Two steps where the camera is far and the picture plain.
        let steps = if camera.distance_mm < 3.0 * frame.longer_mm() { 5 } else { 2 };

        self.gradients.clear();
        self.places.clear();
        for y in 0..height {
            for x in 0..width {
                let [x_mm, y_mm] = camera.flat_place(x as f64 + 0.5, y as f64 + 0.5);
                let (place, point) = surface.seen_from(camera, x_mm, y_mm, steps);
                self.gradients.push(point.gradient);
                if placed {
                    self.places.push(place.map(|v| v as f32));
                }
            }
        }
        // A picture of the flat gel has its coating and how evenly it is lit.
        let drawn = look.flat.is_none();
        if drawn {
            look.coating.texture(&self.normal, &mut self.texture, &mut self.gradients);
        }
        if let Light::Lamps(lamps) = &look.light {
            let depth = look.shadows.as_ref().map_or(0.0, |s| s.depth);
            self.light_lamps(lamps, &shadows, depth, drawn);
        }

        self.tones.clear();
        if let Some(tone) = &look.tone {
            let factor = tone.on(surface);
            self.tones.extend(self.places.iter().map(|&[x, y]| factor(x.into(), y.into())));
        }
        let mut bytes = vec![0u8; frame.pixels() * 3];
        self.plane.resize(frame.pixels(), 0.0);
        self.plane.truncate(frame.pixels());
        let prints: Vec<f32> = match &look.markers {
            Some(markers) => self.prints(markers, sideways),
            None => Vec::new(),
        };
        let channels = if look.grey { 1 } else { 3 };
        for channel in 0..channels {
            match &look.light {
                Light::Measured(shading) => {
                    self.light_measured(&frame, shading, channel);
                    if let (Some(cast), Some(drawn)) = (shadows.get(channel), &look.shadows) {
                        for (value, &[x, y]) in self.plane.iter_mut().zip(&self.places) {
                            *value *= 1.0 - drawn.depth * cast.at(f64::from(x), f64::from(y)).depth;
                        }
                    }
                }
                Light::Lamps(_) => self.plane.copy_from_slice(&self.lit[channel]),
            }
            for (value, tone) in self.plane.iter_mut().zip(&self.tones) {
                *value *= tone;
            }
            match &look.flat {
                None => {
                    for (value, texture) in self.plane.iter_mut().zip(&self.texture) {
                        *value *= look.exposure * texture;
                    }
                    if let Some(markers) = &look.markers {
                        let change = markers.brightness[channel] - 1.0;
                        for (value, print) in self.plane.iter_mut().zip(&prints) {
                            *value *= 1.0 + change * print;
                        }
                    }
                    self.uneven_light(&look.coating, &frame, channel);
                    look.darken(&mut self.plane, channel);
                    camera.blur(&mut self.plane, &mut self.scratch);
                }
                // The lens has blurred it once.
                Some(flat) => {
                    self.plane.iter_mut().for_each(|value| *value *= look.exposure);
                    camera.blur(&mut self.plane, &mut self.scratch);
                    flat.light(&mut self.plane, width, channel);
                }
            }
            camera.digitise(&self.plane, &self.normal, rng, &mut bytes, channel, 3);
        }
        if look.grey {
            for pixel in bytes.chunks_exact_mut(3) {
                pixel.fill(pixel[0]);
            }
        }
        let picture =
            RgbImage::from_raw(width as u32, height as u32, bytes).expect("three bytes a pixel");
        match look.jpeg {
            Some(quality) => through_jpeg(&picture, quality),
            None => picture,
        }
    }

    /// Brightness over flat gel's by a measured sensor's shading, to `plane`.
    fn light_measured(&mut self, frame: &Raster, shading: &Shading, channel: usize) {
        let (width, height) = (frame.width, frame.height);
        let coefficients = &shading.channels[channel];
        for y in 0..height {
            let v = ((y as f64 + 0.5) * 2.0 / height as f64 - 1.0) as f32;
            // Along a row each coefficient is a quadratic in x.
            let rows = coefficients.map(|c| {
                let c = c.map(|c| c as f32);
                [c[0] + v * (c[2] + v * c[5]), c[1] + v * c[4], c[3]]
            });
            let row = y * width..(y + 1) * width;
            let values = self.plane[row.clone()].iter_mut().zip(&self.gradients[row]).enumerate();
            for (x, (value, &[gx, gy])) in values {
                let u = (x as f32 + 0.5) * (2.0 / width as f32) - 1.0;
                let [a, b, c, d, e] = rows.map(|r| r[0] + u * (r[1] + u * r[2]));
                let scale = 1.0 / (1.0 + gx * gx + gy * gy).sqrt();
                let (nx, ny) = (gx * scale, gy * scale);
                let change = nx * (a + c * nx + d * ny) + ny * (b + e * ny);
                *value = (1.0 + change).clamp(0.02, BRIGHTEST);
            }
        }
    }

    /// Brightness for all channels, to `lit`: over that of flat gel in the picture's middle where
    /// lamps are to light it unevenly, else over that of flat gel at the same place.
    fn light_lamps(&mut self, lamps: &Lamps, shadows: &[Surface], depth: f32, unevenly: bool) {
        let beams = lamps.beams();
        let gain = lamps.gain as f32;
        let middle = beams.lit([0.0; 2], [0.0; 2], |_| 0.0);
        for plane in &mut self.lit {
            plane.clear();
        }
        for (&place, &gradient) in self.places.iter().zip(&self.gradients) {
            let flat = beams.lit(place, [0.0; 2], |_| 0.0);
            let lit = beams.lit(place, gradient, |lamp| match shadows.get(lamp) {
                Some(cast) => depth * cast.at(f64::from(place[0]), f64::from(place[1])).depth,
                None => 0.0,
            });
            for channel in 0..3 {
                let change = gain * (lit[channel] / flat[channel] - 1.0);
                // How lamps fall off over the gel, half of it: sensors are built to be even.
                let uneven = match unevenly {
                    true => (flat[channel] / middle[channel]).clamp(0.2, 2.0).sqrt(),
                    false => 1.0,
                };
                self.lit[channel].push(uneven * (1.0 + change).clamp(0.02, BRIGHTEST));
            }
        }
    }

    /// How much of each pixel is printed.
    fn prints(&self, markers: &Markers, sideways: Option<&Sideways>) -> Vec<f32> {
        let printed = |&[x, y]: &[f32; 2]| {
            let place = [f64::from(x), f64::from(y)];
            let [x, y] = sideways.map_or(place, |moved| moved.rest(place));
            markers.coverage(x, y)
        };
        self.places.iter().map(printed).collect()
    }

    /// Multiplies `plane` by the flat gel's levels.
    fn uneven_light(&mut self, coating: &Coating, frame: &Raster, channel: usize) {
        // The flat field is smooth: every eighth column is enough.
        const STEP: usize = 8;
        let (width, height) = (frame.width, frame.height);
        for y in 0..height {
            let v = ((y as f64 + 0.5) * 2.0 / height as f64 - 1.0) as f32;
            let at = |x: usize| coating.flat(channel, x as f32 * (2.0 / width as f32) - 1.0, v);
            let mut left = at(0);
            for (block, values) in
                self.plane[y * width..(y + 1) * width].chunks_mut(STEP).enumerate()
            {
                let right = at((block + 1) * STEP);
                for (i, value) in values.iter_mut().enumerate() {
                    let t = (i as f32 + 0.5) / STEP as f32;
                    *value *= left + t * (right - left);
                }
                left = right;
            }
        }
    }
}

/// Greatest brightness over flat gel's.
const BRIGHTEST: f32 = 4.0;

impl Appearance {
    /// Each light's shadows on the surface.
    fn cast_shadows(&self, surface: &Surface) -> Vec<Surface> {
        let Some(shadows) = &self.shadows else { return Vec::new() };
        let (grid, depths) = (surface.grid(), surface.depths());
        let cast = |&ray: &Ray| {
            Surface::new(grid, cast(grid, &depths, ray, shadows.soft_mm, shadows.size))
        };
        shadows.rays.iter().map(cast).collect()
    }

    /// Vignetting and housing.
    fn darken(&self, plane: &mut [f32], channel: usize) {
        let frame = &self.camera.frame;
        let [width, height] = frame.size_px();
        if self.vignetting > 0.0 {
            let scale = (4.0 / (width * width + height * height)) as f32;
            for (y, row) in plane.chunks_exact_mut(frame.width).enumerate() {
                let dy = y as f32 + 0.5 - height as f32 / 2.0;
                for (x, value) in row.iter_mut().enumerate() {
                    let dx = x as f32 + 0.5 - width as f32 / 2.0;
                    *value *= 1.0 - self.vignetting * scale * (dx * dx + dy * dy);
                }
            }
        }
        if let Some(housing) = &self.housing {
            let [x0, y0, x1, y1] = housing.window;
            let half = [(x1 - x0) / 2.0, (y1 - y0) / 2.0];
            let corner = housing.corner_px.min(half[0]).min(half[1]);
            for (y, row) in plane.chunks_exact_mut(frame.width).enumerate() {
                for (x, value) in row.iter_mut().enumerate() {
                    let (dx, dy) =
                        (x as f64 + 0.5 - (x0 + x1) / 2.0, y as f64 + 0.5 - (y0 + y1) / 2.0);
                    let inside = rectangle(dx, dy, half, corner);
                    let gel = (inside / housing.edge_px + 0.5).clamp(0.0, 1.0) as f32;
                    *value = housing.levels[channel] + gel * (*value - housing.levels[channel]);
                }
            }
        }
    }
}

/// The picture after a JPEG of this quality.
fn through_jpeg(picture: &RgbImage, quality: u8) -> RgbImage {
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, quality)
        .encode_image(picture)
        .expect("an RGB picture in memory can be written");
    image::load(Cursor::new(file), ImageFormat::Jpeg)
        .expect("what was just written can be read")
        .into_rgb8()
}
