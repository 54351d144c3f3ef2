//! The coating as the camera sees it at rest: light that falls unevenly, texture, wear, dust,
//! scratches; and old dents in the gel.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::camera::NormalTable;
use super::raster::Raster;

/// A soft round spot, in millimetres from the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spot {
    center_mm: [f64; 2],
    /// Standard deviation along its own axes.
    radius_mm: [f64; 2],
    yaw: f64,
    strength: f64,
}

impl Spot {
    /// Calls `f` with index, value, and offsets in millimetres for the pixels within three radii.
    fn each(&self, frame: &Raster, mut f: impl FnMut(usize, f64, [f64; 2])) {
        let (size_px, size_mm) = (frame.size_px(), frame.size_mm());
        let reach = 3.0 * self.radius_mm[0].max(self.radius_mm[1]);
        let low = frame.to_px(self.center_mm.map(|center| center - reach));
        let high = frame.to_px(self.center_mm.map(|center| center + reach));
        let range = |axis: usize| {
            let n = size_px[axis];
            (low[axis].clamp(0.0, n) as usize)..(high[axis].clamp(0.0, n).ceil() as usize)
        };
        let offset = |axis: usize, index: usize| {
            ((index as f64 + 0.5) / size_px[axis] - 0.5) * size_mm[axis] - self.center_mm[axis]
        };
        let (sin, cos) = self.yaw.sin_cos();
        for y in range(1) {
            for x in range(0) {
                let (dx, dy) = (offset(0, x), offset(1, y));
                let u = (cos * dx + sin * dy) / self.radius_mm[0];
                let v = (-sin * dx + cos * dy) / self.radius_mm[1];
                let r2 = u * u + v * v;
                if r2 < 9.0 {
                    f(y * frame.width + x, (-0.5 * r2).exp(), [u, v]);
                }
            }
        }
    }
}

/// A scratch: a curve from end to end, in millimetres.
#[derive(Debug, Clone, PartialEq)]
struct Scratch {
    points: Vec<[f64; 2]>,
    width_mm: f64,
    strength: f64,
}

/// The coating of one sensor at one age.
#[derive(Debug, Clone, PartialEq)]
pub struct Coating {
    frame: Raster,
    /// Level of the flat gel at its centre, for each channel.
    levels: [f64; 3],
    /// For each channel the lights' bright sides: where, how wide (of half the picture), how much.
    glows: [[[f64; 4]; 2]; 3],
    grain: f64,
    mottle: f64,
    streaks: f64,
    streak_yaw: f64,
    worn: Vec<Spot>,
    dust: Vec<Spot>,
    scratches: Vec<Scratch>,
    dents: Vec<Spot>,
    texture_seed: u64,
}

impl Coating {
    /// Draws a coating that fills this frame.
    pub fn sample(rng: &mut Pcg64, frame: &Raster) -> Self {
        let half = frame.size_mm().map(|side| side / 2.0);
        let place = |rng: &mut Pcg64| half.map(|half| rng.random_range(-half..half));
        let grey = rng.random_range(75.0..185.0);
        let tint = if rng.random_bool(0.5) { 0.05 } else { 0.25 };
        let levels = [(); 3].map(|()| grey * (1.0 + tint * rng.random_range(-1.0..1.0)));
        let unevenness = rng.random_range(0.05..0.5);
        let side: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let spread = if tint > 0.1 { 3.0 } else { 0.4 };
        let glows = [(); 3].map(|()| {
            [(); 2].map(|()| {
                let angle = side + spread * rng.random_range(-1.0..1.0);
                let radius: f64 = rng.random_range(0.3..1.2);
                [
                    radius * angle.cos(),
                    radius * angle.sin(),
                    rng.random_range(0.5..1.2),
                    unevenness * rng.random_range(0.3..1.0),
                ]
            })
        });
        let aged = rng.random_bool(0.5);
        let spot = |rng: &mut Pcg64, low: f64, high: f64, strength: f64| Spot {
            center_mm: place(rng),
            radius_mm: [rng.random_range(low..high), rng.random_range(low..high)],
            yaw: rng.random_range(0.0..std::f64::consts::PI),
            strength: strength * rng.random_range(-1.0..1.0),
        };
        let count = |rng: &mut Pcg64, most: usize| rng.random_range(0..=most);
        let worn =
            (0..count(rng, if aged { 6 } else { 0 })).map(|_| spot(rng, 1.0, 5.0, 0.1)).collect();
        let dents =
            (0..count(rng, if aged { 8 } else { 1 })).map(|_| spot(rng, 0.4, 2.5, 0.03)).collect();
        let most = if rng.random_bool(0.3) { 60 } else { 15 };
        let dust = (0..count(rng, most))
            .map(|_| {
                let mut speck = spot(rng, 0.02, 0.1, 1.0);
                speck.strength = if rng.random_bool(0.8) {
                    -rng.random_range(0.05..0.45)
                } else {
                    rng.random_range(0.05..0.3)
                };
                speck
            })
            .collect();
        let scratches = (0..count(rng, if aged { 5 } else { 2 }))
            .map(|_| {
                let mut at = place(rng);
                let mut heading: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                let bend = rng.random_range(-0.04..0.04);
                let points = (0..rng.random_range(8..60))
                    .map(|_| {
                        heading += bend;
                        at = [at[0] + 0.4 * heading.cos(), at[1] + 0.4 * heading.sin()];
                        at
                    })
                    .collect();
                Scratch {
                    points,
                    width_mm: rng.random_range(0.02..0.06),
                    strength: rng.random_range(-0.18..0.15),
                }
            })
            .collect();
        Self {
            frame: *frame,
            levels,
            glows,
            grain: rng.random_range(0.002..0.012),
            mottle: rng.random_range(0.003..0.02),
            streaks: rng.random_range(0.0..0.012),
            streak_yaw: rng.random_range(0.0..std::f64::consts::PI),
            worn,
            dust,
            scratches,
            dents,
            texture_seed: rng.random_range(0..u64::MAX),
        }
    }

    /// Sets the standard deviation of the clouds.
    pub fn set_mottle(&mut self, mottle: f64) {
        self.mottle = mottle;
    }

    /// Standard deviation of the clouds.
    pub fn mottle(&self) -> f64 {
        self.mottle
    }

    /// Colours the flat gel: 0 or less leaves it grey. Most sensors whose channels have lights of
    /// their own are built so that flat gel is nearly grey all the same.
    pub fn set_colour(&mut self, rng: &mut Pcg64, colour: f64) {
        let grey = self.levels.iter().sum::<f64>() / 3.0;
        let colour = colour.max(0.0);
        let tint = match rng.random_range(0..10) {
            0..5 => 0.15,
            5..8 => 0.5,
            _ => 0.95,
        };
        self.levels = [(); 3].map(|()| grey * (1.0 + colour * tint * rng.random_range(-1.0..1.0)));
    }

    /// Lowers the level of the flat gel to at most this, for the brightest channel in the middle. A label
    /// says nothing of it: its `exposure` is what was drawn.
    pub fn limit_level(&mut self, most: f64) {
        let brightest = self.levels.iter().fold(0.0f64, |a, &b| a.max(b));
        let scale = (most / brightest).min(1.0);
        self.levels.iter_mut().for_each(|level| *level *= scale);
    }

    /// Spread of the levels over their mean.
    pub fn colour(&self) -> f64 {
        let [r, g, b] = self.levels;
        (r.max(g).max(b) - r.min(g).min(b)) / (r + g + b) * 1.5
    }

    /// Level of the flat gel without its texture; x and y run from −1 to 1 over the picture.
    pub fn flat(&self, channel: usize, x: f32, y: f32) -> f32 {
        let mut light = 1.0;
        for [cx, cy, width, strength] in self.glows[channel] {
            let (dx, dy) = (x - cx as f32, y - cy as f32);
            let w = width as f32;
            light += strength as f32 * ((-0.5 * (dx * dx + dy * dy) / (w * w)).exp() - 0.4);
        }
        self.levels[channel] as f32 * light
    }

    /// Writes the texture's factor for each pixel, and adds the old dents' gradients to
    /// `gradients`.
    pub fn texture(
        &self,
        normal: &NormalTable,
        texture: &mut Vec<f32>,
        gradients: &mut [[f32; 2]],
    ) {
        let frame = &self.frame;
        let mut rng = Pcg64::seed_from_u64(self.texture_seed);
        texture.clear();
        texture.resize(frame.pixels(), 0.0);
        normal.fill(&mut rng, texture);
        let grain = self.grain as f32;
        texture.iter_mut().for_each(|t| *t *= grain);
        // Clouds of several sizes, smooth between the nodes of coarse grids.
        for (nodes, weight) in [(10usize, 1.0f32), (34, 0.7), (112, 0.5)] {
            let amplitude = weight * self.mottle as f32;
            add_noise(texture, frame, normal, &mut rng, [nodes, nodes], 0.0, amplitude);
        }
        let amplitude = self.streaks as f32;
        add_noise(texture, frame, normal, &mut rng, [24, 400], self.streak_yaw, amplitude);
        for spot in self.worn.iter().chain(&self.dust) {
            spot.each(frame, |i, value, _| texture[i] += (spot.strength * value) as f32);
        }
        for scratch in &self.scratches {
            draw_scratch(texture, frame, scratch);
        }
        texture.iter_mut().for_each(|t| *t = (1.0 + *t).max(0.05));
        for dent in &self.dents {
            let (sin, cos) = dent.yaw.sin_cos();
            dent.each(frame, |i, value, [u, v]| {
                let du = -dent.strength * value * u / dent.radius_mm[0];
                let dv = -dent.strength * value * v / dent.radius_mm[1];
                gradients[i][0] += (cos * du - sin * dv) as f32;
                gradients[i][1] += (sin * du + cos * dv) as f32;
            });
        }
    }
}

/// Adds noise from a turned grid of `columns` × `rows` nodes over the picture's diagonal.
fn add_noise(
    texture: &mut [f32],
    frame: &Raster,
    normal: &NormalTable,
    rng: &mut Pcg64,
    [columns, rows]: [usize; 2],
    yaw: f64,
    amplitude: f32,
) {
    let n = frame.longer_px();
    let mut nodes = vec![0.0f32; (columns + 2) * (rows + 2)];
    normal.fill(rng, &mut nodes);
    let (sin, cos) = (yaw.sin() as f32, yaw.cos() as f32);
    // The diagonal fits into the nodes at any angle.
    let scale = 1.0 / (n as f32 * std::f32::consts::SQRT_2);
    for y in 0..frame.height {
        let dy = (y as f32 + 0.5) - frame.height as f32 / 2.0;
        for x in 0..frame.width {
            let dx = (x as f32 + 0.5) - frame.width as f32 / 2.0;
            let u = ((cos * dx + sin * dy) * scale + 0.5) * columns as f32;
            let v = ((cos * dy - sin * dx) * scale + 0.5) * rows as f32;
            let (column, row) = (u as usize, v as usize);
            let (fu, fv) = (u - column as f32, v - row as f32);
            let (fu, fv) = (fu * fu * (3.0 - 2.0 * fu), fv * fv * (3.0 - 2.0 * fv));
            let i = row * (columns + 2) + column;
            let top = nodes[i] + fu * (nodes[i + 1] - nodes[i]);
            let j = i + columns + 2;
            let bottom = nodes[j] + fu * (nodes[j + 1] - nodes[j]);
            texture[y * frame.width + x] += amplitude * (top + fv * (bottom - top));
        }
    }
}

fn draw_scratch(texture: &mut [f32], frame: &Raster, scratch: &Scratch) {
    let (size_px, size_mm) = (frame.size_px(), frame.size_mm());
    let width = scratch.width_mm / size_mm[0] * size_px[0];
    let reach = (2.5 * width).ceil();
    for pair in scratch.points.windows(2) {
        let [a, b] = [frame.to_px(pair[0]), frame.to_px(pair[1])];
        let steps = (b[0] - a[0]).hypot(b[1] - a[1]).ceil().max(1.0);
        for step in 0..steps as usize {
            let t = step as f64 / steps;
            let at = [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
            let range = |axis: usize| {
                let (c, n) = (at[axis], size_px[axis]);
                ((c - reach).clamp(0.0, n) as usize)..((c + reach).clamp(0.0, n) as usize)
            };
            for y in range(1) {
                for x in range(0) {
                    let (dx, dy) = (x as f64 + 0.5 - at[0], y as f64 + 0.5 - at[1]);
                    let value = (-0.5 * (dx * dx + dy * dy) / (width * width)).exp();
                    // Steps of a pixel along the line add up to about 2.5 widths.
                    let value = scratch.strength * value / (2.5 * width);
                    texture[y * frame.width + x] += value as f32;
                }
            }
        }
    }
}
