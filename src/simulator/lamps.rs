//! Lamps at finite angles over a matt coating: the second way in which a wide picture is lit, beside
//! the measured sensors of [`optics`](super::optics).
//!
//! Lambert's law with a share of scattered light, and Phong's gloss. The gel is clear and has no
//! refraction here, lamps are points whose light falls off with a power of the distance, and
//! `gain` scales the change of brightness to the strength that was drawn: a way to reach the
//! contrasts of real sensors, not a law.

use glam::{DVec2, DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::optics::over_directions;
use super::shadow::Ray;

/// A lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// Where it stands, seen from the gel's middle.
    pub ray: Ray,
    /// Distance from the gel's middle, in millimetres.
    pub distance_mm: f64,
    /// Light in the middle for red, green and blue.
    pub colour: [f64; 3],
}

impl Lamp {
    /// What its light is worth along the gel in the gel's middle, for the mean channel.
    pub fn along_gel(&self) -> DVec2 {
        let power = self.colour.iter().sum::<f64>() / 3.0;
        DVec2::from_angle(self.ray.azimuth) * (power * self.ray.elevation.cos())
    }
}

/// How lamps stand round the gel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrangement {
    /// One, two or three at any angle.
    Few,
    /// Three or four sides, each its own colour.
    Sides,
    /// Many in a ring.
    Ring,
}

/// All of a sensor's lamps.
#[derive(Debug, Clone, PartialEq)]
pub struct Lamps {
    /// The lamps.
    pub lamps: Vec<Lamp>,
    /// Light from everywhere, for each channel.
    pub ambient: [f64; 3],
    /// Share of gloss.
    pub gloss: f64,
    /// Power of the distance with which light falls off.
    pub falloff: i32,
    /// Factor on the change of brightness.
    pub gain: f64,
}

impl Lamps {
    /// Draws lamps for a field of this size. `colour` is 0 for grey light and 1 where each channel
    /// has lamps of its own.
    pub fn sample(rng: &mut Pcg64, field_mm: f64, colour: f64) -> Self {
        let arrangement = match rng.random_range(0..10) {
            0..4 => Arrangement::Few,
            4..8 => Arrangement::Sides,
            _ => Arrangement::Ring,
        };
        let count = match arrangement {
            Arrangement::Few => rng.random_range(1..=3),
            Arrangement::Sides => rng.random_range(3..=4),
            Arrangement::Ring => rng.random_range(6..=8),
        };
        let first = rng.random_range(0.0..std::f64::consts::TAU);
        let low = rng.random_range(5f64..60.0);
        let distance = field_mm * rng.random_range(0.7f64..4.0);
        let turn = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let hues = rng.random_range(0..3);
        let lamps = (0..count)
            .map(|i| {
                let share = f64::from(i) / f64::from(count);
                let azimuth = match arrangement {
                    Arrangement::Few => rng.random_range(0.0..std::f64::consts::TAU),
                    _ => first + turn * std::f64::consts::TAU * share + rng.random_range(-0.1..0.1),
                };
                // Hues follow the lamps round the gel, as on sensors with coloured sides.
                let pure = [0, 1, 2].map(|channel| {
                    let hue = match arrangement {
                        Arrangement::Ring => share,
                        _ => f64::from(i % 3) / 3.0,
                    };
                    let phase = hue - f64::from((channel + hues) % 3) / 3.0;
                    let near = (std::f64::consts::TAU * phase).cos();
                    (0.5 + near).max(0.0) / 0.75
                });
                let power = rng.random_range(0.6..1.4);
                Lamp {
                    ray: Ray {
                        azimuth,
                        elevation: (low + rng.random_range(-5.0..5.0))
                            .clamp(5.0, 65.0)
                            .to_radians(),
                    },
                    distance_mm: distance * rng.random_range(0.8..1.2),
                    colour: pure.map(|pure| power * (1.0 + colour * (pure - 1.0))),
                }
            })
            .collect();
        let ambient = rng.random_range(0.05..0.6);
        Self {
            lamps,
            ambient: [ambient; 3],
            gloss: if rng.random_bool(0.4) { rng.random_range(0.05..0.5) } else { 0.0 },
            falloff: rng.random_range(0..=2),
            gain: 1.0,
        }
    }

    /// Leaves one lamp or two, on this side of the gel (in radians from x towards y).
    pub fn gather(&mut self, rng: &mut Pcg64, azimuth: f64) {
        self.lamps.truncate(rng.random_range(1..=2));
        for lamp in &mut self.lamps {
            lamp.ray.azimuth = azimuth + rng.random_range(-0.3..0.3);
        }
    }

    /// The lamps as their light is summed.
    pub fn beams(&self) -> Beams {
        let beam = |lamp: &Lamp| Beam {
            from: lamp.ray.place(lamp.distance_mm).as_vec3(),
            distance: lamp.distance_mm as f32,
            colour: DVec3::from(lamp.colour).as_vec3(),
        };
        Beams {
            beams: self.lamps.iter().map(beam).collect(),
            ambient: DVec3::from(self.ambient).as_vec3(),
            gloss: self.gloss as f32,
            falloff: self.falloff,
        }
    }

    /// Change of brightness at a slope of ½ in the gel's middle, root mean square over
    /// directions and channels, as [`Shading::contrast`](super::optics::Shading::contrast).
    pub fn contrast(&self) -> f64 {
        let beams = self.beams();
        let flat = beams.lit([0.0; 2], [0.0; 2], |_| 0.0);
        over_directions(|angle| {
            let angle = angle as f32;
            let lit = beams.lit([0.0; 2], [0.5 * angle.cos(), 0.5 * angle.sin()], |_| 0.0);
            [0, 1, 2].map(|c| self.gain * f64::from(lit[c] / flat[c] - 1.0))
        })
    }

    /// Sets the gain so that [`contrast`](Self::contrast) is this, or as near as a gain of 0.05 to 3 comes.
    /// A picture's label keeps what was asked for.
    pub fn set_contrast(&mut self, contrast: f64) {
        self.gain = 1.0;
        self.gain = (contrast / self.contrast().max(1e-6)).clamp(0.05, 3.0);
    }
}

struct Beam {
    from: Vec3,
    distance: f32,
    colour: Vec3,
}

/// Lamps in single precision, for the sum over a picture.
pub struct Beams {
    beams: Vec<Beam>,
    ambient: Vec3,
    gloss: f32,
    falloff: i32,
}

impl Beams {
    /// Light at a place in millimetres from the gel's middle where the depth has this gradient,
    /// for each channel. `shadow` says how much of each lamp's light the place lacks.
    pub fn lit(
        &self,
        [x, y]: [f32; 2],
        [gx, gy]: [f32; 2],
        shadow: impl Fn(usize) -> f32,
    ) -> [f32; 3] {
        let scale = 1.0 / (1.0 + gx * gx + gy * gy).sqrt();
        // Towards the camera, against the growth of depth.
        let normal = Vec3::new(-gx * scale, -gy * scale, scale);
        let mut sum = self.ambient;
        for (i, beam) in self.beams.iter().enumerate() {
            let to = beam.from - Vec3::new(x, y, 0.0);
            let inverse = to.length_recip();
            let light = to * inverse;
            let facing = normal.dot(light);
            let mut amount = facing.max(0.0);
            if self.gloss > 0.0 {
                // The camera looks along z: the mirrored light's z is their cosine.
                let mirrored = (2.0 * facing * normal.z - light.z).max(0.0);
                let power2 = mirrored * mirrored;
                let power4 = power2 * power2;
                amount += self.gloss * power4 * power4;
            }
            amount *= (1.0 - shadow(i)) * (beam.distance * inverse).powi(self.falloff);
            sum += beam.colour * amount;
        }
        sum.to_array()
    }
}
