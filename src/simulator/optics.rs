//! How the coating's brightness depends on its slope, and how a sensor differs from the next.
//!
//! A channel's brightness over that of the flat gel is 1 plus a quadratic in the surface normal
//! whose coefficients are quadratic in position: the form in which GelSight's own calibration
//! files describe their sensors, without the constant that the flat field already carries.

use std::sync::OnceLock;

use glam::DVec2;
use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Terms in the normal: nx, ny, nx², nx·ny, ny².
pub const NORMAL_TERMS: usize = 5;
/// Terms in position: 1, x, y, x², x·y, y².
pub const POSITION_TERMS: usize = 6;
/// Coefficients of a channel.
pub const TERMS: usize = NORMAL_TERMS * POSITION_TERMS;

/// A channel's coefficients, `[normal term][position term]`.
pub type Channel = [[f64; POSITION_TERMS]; NORMAL_TERMS];

/// A sensor's response to the surface normal, for three channels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shading {
    /// Red, green and blue.
    pub channels: [Channel; 3],
}

/// A real sensor's lights, each with its response to the surface normal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredSensor {
    /// The measurement's name.
    pub name: String,
    /// The lights; of a colour picture, its channels.
    pub lights: Vec<Channel>,
}

/// The real sensors that simulated ones are drawn from: what [`calibrate`](super::calibrate)
/// wrote.
pub fn measured_sensors() -> &'static [MeasuredSensor] {
    static SENSORS: OnceLock<Vec<MeasuredSensor>> = OnceLock::new();
    SENSORS.get_or_init(|| {
        serde_json::from_str(include_str!("calibration.json"))
            .expect("the file is part of the program and a test reads it")
    })
}

/// The position terms at a point; x and y run from −1 to 1 over half the picture's width.
pub fn position_terms(x: f64, y: f64) -> [f64; POSITION_TERMS] {
    [1.0, x, y, x * x, x * y, y * y]
}

/// The normal terms where the surface's depth has this gradient.
pub fn normal_terms(gx: f64, gy: f64) -> [f64; NORMAL_TERMS] {
    let scale = 1.0 / (1.0 + gx * gx + gy * gy).sqrt();
    let (nx, ny) = (gx * scale, gy * scale);
    [nx, ny, nx * nx, nx * ny, ny * ny]
}

impl Shading {
    /// Change of brightness relative to the flat gel, for each channel.
    pub fn relative(&self, x: f64, y: f64, gx: f64, gy: f64) -> [f64; 3] {
        let position = position_terms(x, y);
        let normal = normal_terms(gx, gy);
        self.channels.map(|channel| {
            channel
                .iter()
                .zip(normal)
                .map(|(row, n)| n * row.iter().zip(position).map(|(c, p)| c * p).sum::<f64>())
                .sum()
        })
    }

    /// The same sensor turned by `angle`, and mirrored before that if wanted.
    pub fn turned(&self, angle: f64, mirror: bool) -> Self {
        let (sin, cos) = angle.sin_cos();
        let flip = if mirror { -1.0 } else { 1.0 };
        // A vector v of the turned sensor is m·v in the original's frame.
        let m = [[cos * flip, sin * flip], [-sin, cos]];
        Self { channels: self.channels.map(|channel| turn_channel(&channel, &m)) }
    }
}

/// Least change of brightness that a slope of ½ makes, root mean square over directions and
/// channels: real edges change by 5 to 7 %.
const LEAST_CONTRAST: f64 = 0.05;

impl Shading {
    /// Change of brightness at a slope of ½ in the picture's middle: root mean square over
    /// directions and channels.
    pub fn contrast(&self) -> f64 {
        over_directions(|angle| self.relative(0.0, 0.0, 0.5 * angle.cos(), 0.5 * angle.sin()))
    }

    /// Draws a sensor whose edges are no fainter than real ones.
    pub fn sample(rng: &mut Pcg64) -> Self {
        loop {
            let shading = Self::sample_any(rng, None);
            if shading.contrast() >= LEAST_CONTRAST {
                return shading;
            }
        }
    }

    /// Draws a sensor of this colour and [`contrast`](Self::contrast).
    pub fn sample_wide(rng: &mut Pcg64, colour: f64, contrast: f64) -> Self {
        let mut shading = Self::sample_any(rng, Some(colour.max(0.0)));
        let gain = contrast / shading.contrast().max(1e-3);
        for value in shading.channels.as_flattened_mut().as_flattened_mut() {
            *value *= gain;
        }
        shading
    }

    /// The direction on the gel in which a channel's light comes in the picture's middle: where a
    /// slope against it is brightest. In radians from x towards y.
    pub fn azimuth(&self, channel: usize) -> f64 {
        let DVec2 { x, y } = self.along_gel(channel);
        y.atan2(x)
    }

    /// The same, as long as the change of brightness with the slope against it.
    pub fn along_gel(&self, channel: usize) -> DVec2 {
        let [nx, ny, ..] = self.channels[channel];
        // The gradient of depth points away from the light on a lit slope.
        DVec2::new(-nx[0], -ny[0])
    }

    /// Draws a sensor: one of the real ones, turned, its lights mixed into channels.
    ///
    /// Where all channels see nearly the same lights the picture is nearly grey, as with a silver
    /// coating; where each sees its own, it is coloured. With many lights on at once their slopes
    /// cancel and only the darkening of steep slopes remains. `colour` says how far channels see
    /// their own lights, 0 to 1; it is drawn without.
    fn sample_any(rng: &mut Pcg64, colour: Option<f64>) -> Self {
        let sensors = measured_sensors();
        let sensor = &sensors[rng.random_range(0..sensors.len())];
        let lights = sensor.lights.len();
        // Exponent 0 lights all equally, a large one singles out few.
        let drawn = rng.random_range(0.3..5.0f64);
        // Channels that see lights of their own must see few each, or all see the same.
        let exponent = colour.map_or(drawn, |colour| drawn.max(4.0 * colour));
        let weights = |rng: &mut Pcg64| -> Vec<f64> {
            let raw: Vec<f64> =
                (0..lights).map(|_| rng.random_range(0.05f64..1.0).powf(exponent)).collect();
            let sum: f64 = raw.iter().sum();
            raw.into_iter().map(|w| w / sum).collect()
        };
        let common = weights(rng);
        let drawn = if rng.random_bool(0.5) {
            rng.random_range(0.0..0.15)
        } else {
            rng.random_range(0.15..1.0)
        };
        let colour = colour.unwrap_or(drawn);
        let strength = rng.random_range(0.75..1.3);
        let locality = rng.random_range(0.4..1.0);
        let channels = [(); 3].map(|()| {
            let own = weights(rng);
            let mut channel = [[0.0; POSITION_TERMS]; NORMAL_TERMS];
            for (light, (common, own)) in sensor.lights.iter().zip(common.iter().zip(&own)) {
                let weight = common + colour * (own - common);
                for (sum, row) in channel.iter_mut().zip(light) {
                    for (p, (sum, value)) in sum.iter_mut().zip(row).enumerate() {
                        let scale = if p == 0 { 1.0 } else { locality };
                        *sum += strength * scale * weight * value;
                    }
                }
            }
            channel
        });
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        Self { channels }.turned(angle, rng.random_bool(0.5))
    }
}

/// Root mean square over directions and channels of what changes with a slope in the direction `angle`.
pub(super) fn over_directions(change: impl Fn(f64) -> [f64; 3]) -> f64 {
    const DIRECTIONS: usize = 8;
    let angles = (0..DIRECTIONS).map(|i| i as f64 * std::f64::consts::TAU / DIRECTIONS as f64);
    let sum: f64 = angles.flat_map(change).map(|v| v * v).sum();
    (sum / (3 * DIRECTIONS) as f64).sqrt()
}

/// Coefficients of `b·v` after `v → m·v`.
fn turn_linear(b: [f64; 2], m: &[[f64; 2]; 2]) -> [f64; 2] {
    [b[0] * m[0][0] + b[1] * m[1][0], b[0] * m[0][1] + b[1] * m[1][1]]
}

/// Coefficients of xx, xy, yy after `v → m·v`.
fn turn_quadratic(q: [f64; 3], m: &[[f64; 2]; 2]) -> [f64; 3] {
    let [[a, b], [c, d]] = *m;
    [
        q[0] * a * a + q[1] * a * c + q[2] * c * c,
        2.0 * q[0] * a * b + q[1] * (a * d + b * c) + 2.0 * q[2] * c * d,
        q[0] * b * b + q[1] * b * d + q[2] * d * d,
    ]
}

fn turn_channel(channel: &Channel, m: &[[f64; 2]; 2]) -> Channel {
    let mut turned = *channel;
    for row in &mut turned {
        let linear = turn_linear([row[1], row[2]], m);
        let quadratic = turn_quadratic([row[3], row[4], row[5]], m);
        *row = [row[0], linear[0], linear[1], quadratic[0], quadratic[1], quadratic[2]];
    }
    let rows = turned;
    for p in 0..POSITION_TERMS {
        let linear = turn_linear([rows[0][p], rows[1][p]], m);
        let quadratic = turn_quadratic([rows[2][p], rows[3][p], rows[4][p]], m);
        let column = [linear[0], linear[1], quadratic[0], quadratic[1], quadratic[2]];
        for (row, value) in turned.iter_mut().zip(column) {
            row[p] = value;
        }
    }
    turned
}

/// Least share of a term, squared and summed over the observations, that the terms before it leave
/// unexplained. With less than this, noise weighs over a thousand times as much in its coefficient
/// as in that of a term that stands alone.
const LEAST_INDEPENDENT: f64 = 1e-6;

/// Least squares for the coefficients of one channel, by the normal equations.
pub struct Fit {
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl Default for Fit {
    fn default() -> Self {
        Self::new()
    }
}

impl Fit {
    /// No observation yet.
    pub fn new() -> Self {
        Self { matrix: vec![0.0; TERMS * TERMS], right: vec![0.0; TERMS] }
    }

    /// Adds a pixel: its terms, the flat gel's level there, and the level seen.
    pub fn add(
        &mut self,
        position: &[f64; POSITION_TERMS],
        normal: &[f64; NORMAL_TERMS],
        flat: f64,
        seen: f64,
    ) {
        let mut row = [0.0; TERMS];
        for (i, n) in normal.iter().enumerate() {
            for (j, p) in position.iter().enumerate() {
                row[i * POSITION_TERMS + j] = flat * n * p;
            }
        }
        for i in 0..TERMS {
            for j in 0..=i {
                self.matrix[i * TERMS + j] += row[i] * row[j];
            }
            self.right[i] += row[i] * (seen - flat);
        }
    }

    /// Adds another fit's observations.
    pub fn merge(&mut self, other: &Self) {
        for (a, b) in self.matrix.iter_mut().zip(&other.matrix) {
            *a += b;
        }
        for (a, b) in self.right.iter_mut().zip(&other.right) {
            *a += b;
        }
    }

    /// Number of coefficients, at most [`TERMS`], that the observations determine: terms that are
    /// no combination of those before them, by the pivots of Cholesky's factorisation with every
    /// term scaled to unit length.
    pub fn rank(&self) -> usize {
        let n = TERMS;
        let mut l = vec![0.0; n * n];
        let mut rank = 0;
        for i in 0..n {
            for j in 0..=i {
                let dot: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
                let length = (self.matrix[i * n + i] * self.matrix[j * n + j]).sqrt();
                let value = self.matrix[i * n + j] / length - dot;
                if i != j {
                    let pivot = l[j * n + j];
                    l[i * n + j] = if pivot > 0.0 { value / pivot } else { 0.0 };
                } else if value > LEAST_INDEPENDENT {
                    // A term that is zero everywhere makes a NaN, which is not greater.
                    l[i * n + i] = value.sqrt();
                    rank += 1;
                }
            }
        }
        rank
    }

    /// The coefficients that fit best, by Cholesky's factorisation. A ridge of 1e-6 of the mean
    /// diagonal settles terms that the observations leave open.
    pub fn solve(&self) -> Channel {
        let n = TERMS;
        let trace: f64 = (0..n).map(|i| self.matrix[i * n + i]).sum();
        let ridge = (1e-6 * trace / n as f64).max(f64::MIN_POSITIVE);
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let dot: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
                let value = self.matrix[i * n + j] - dot;
                l[i * n + j] = if i == j {
                    (value + ridge).max(f64::MIN_POSITIVE).sqrt()
                } else {
                    value / l[j * n + j]
                };
            }
        }
        let mut x = self.right.clone();
        for i in 0..n {
            let dot: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
            x[i] = (x[i] - dot) / l[i * n + i];
        }
        for i in (0..n).rev() {
            let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
            x[i] = (x[i] - dot) / l[i * n + i];
        }
        let mut channel = [[0.0; POSITION_TERMS]; NORMAL_TERMS];
        for (i, value) in x.into_iter().enumerate() {
            channel[i / POSITION_TERMS][i % POSITION_TERMS] = value;
        }
        channel
    }
}
