//! The camera: a pinhole above the picture's middle, its lens' distortion, defocus, noise, 8 bits.

use rand::Rng;
use rand_pcg::Pcg64;

use super::raster::Raster;
use super::smooth;

/// A pinhole camera that looks at the gel through the acrylic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// What its picture measures.
    pub frame: Raster,
    /// Distance from the pinhole to the undeformed surface, in millimetres.
    pub distance_mm: f64,
    /// Where on the flat gel millimetres begin, in millimetres from the middle of the picture, which the
    /// lens looks at: the middle of a gel that fills only a part of the picture.
    pub origin_mm: [f64; 2],
    /// Radial distortion κ: a place at the distance r from the picture's middle, in half diagonals,
    /// shows what a pinhole would show at r (1 + κ r²).
    pub distortion: f64,
    /// Standard deviation of the blur, in pixels.
    pub blur_px: f64,
    /// Signal over noise at saturation, in decibels.
    pub snr_db: f64,
    /// Noise in the dark, in 8-bit levels (standard deviation).
    pub read_noise: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            frame: Raster::PAPER,
            distance_mm: 125.0,
            origin_mm: [0.0; 2],
            distortion: 0.0,
            blur_px: 1.0,
            snr_db: 45.0,
            read_noise: 0.5,
        }
    }
}

impl Camera {
    /// Pixel at which a point of the surface appears, from its place in millimetres from
    /// [`origin_mm`](Self::origin_mm) and its depth: a dent comes nearer to the camera and moves outwards by
    /// `distance / (distance − depth)`.
    pub fn project(&self, x_mm: f64, y_mm: f64, depth_mm: f64) -> [f64; 2] {
        let scale = self.distance_mm / (self.distance_mm - depth_mm) / self.frame.mm_per_pixel;
        let [width, height] = self.frame.size_px();
        let [left, top] = self.origin_mm;
        let (dx, dy) = ((x_mm + left) * scale, (y_mm + top) * scale);
        let seen = ((dx * dx + dy * dy) * self.per_half_diagonal()).sqrt();
        let shrink = if seen > 0.0 { self.undistorted(seen) / seen } else { 1.0 };
        [dx * shrink + width / 2.0, dy * shrink + height / 2.0]
    }

    /// Place on a flat gel, in millimetres from [`origin_mm`](Self::origin_mm), that is seen at this
    /// place of the picture.
    pub fn flat_place(&self, x_px: f64, y_px: f64) -> [f64; 2] {
        let [x, y] = self.frame.to_mm([x_px, y_px]);
        let [left, top] = self.origin_mm;
        if self.distortion == 0.0 {
            return [x - left, y - top];
        }
        let mm = self.frame.mm_per_pixel;
        let r2 = (x * x + y * y) / (mm * mm) * self.per_half_diagonal();
        let stretch = 1.0 + self.distortion * r2;
        [x * stretch - left, y * stretch - top]
    }

    /// The distance from the middle, in half diagonals, that shows what a pinhole would show at `seen`:
    /// the root r of r (1 + κ r²) = `seen`, in closed form.
    ///
    /// A lens with κ < 0 shows nothing from further out than r = 1 / √(3 |κ|), where the picture would
    /// fold back. What lies past that is set there, which is off the picture for κ above −1/3.
    fn undistorted(&self, seen: f64) -> f64 {
        let kappa = self.distortion;
        if kappa == 0.0 {
            return seen;
        }
        // With r = 2 / √(3 |κ|) sinh t, or sin t, the cubic becomes that function's of 3 t.
        let scale = 2.0 / (3.0 * kappa.abs()).sqrt();
        let triple = 3.0 * seen / scale;
        scale
            * if kappa > 0.0 {
                (triple.asinh() / 3.0).sinh()
            } else {
                (triple.min(1.0).asin() / 3.0).sin()
            }
    }

    /// One over the squared half diagonal, in pixels.
    fn per_half_diagonal(&self) -> f64 {
        let [width, height] = self.frame.size_px();
        4.0 / (width * width + height * height)
    }

    /// Standard deviation of the noise in 8-bit levels at this level: shot noise, whose variance
    /// grows with the signal, and read noise.
    pub fn noise(&self, level: f64) -> f64 {
        let saturated = 255.0 / 10f64.powf(self.snr_db / 20.0);
        let read = self.read_noise * self.read_noise;
        (read + (saturated * saturated - read).max(0.0) * level.max(0.0) / 255.0).sqrt()
    }

    /// Blurs a plane of the picture, `[height][width]`, in place; edges are repeated.
    pub fn blur(&self, plane: &mut [f32], scratch: &mut Vec<f32>) {
        smooth::gaussian(self.frame.width, plane, scratch, self.blur_px, 2.5);
    }

    /// Adds noise to levels of 0 to 255 and rounds to 8 bits. `stride` and `offset` place the
    /// plane among the channels of `out`.
    pub fn digitise(
        &self,
        plane: &[f32],
        normal: &NormalTable,
        rng: &mut Pcg64,
        out: &mut [u8],
        offset: usize,
        stride: usize,
    ) {
        let table: Vec<f32> = (0..=255).map(|l| self.noise(f64::from(l)) as f32).collect();
        let mut targets = out.iter_mut().skip(offset).step_by(stride);
        for values in plane.chunks(NormalTable::PER_WORD) {
            let mut bits = rng.next_u64();
            for &value in values {
                // What is past the brightest level stays there, noise or not.
                let noise = table[value.clamp(0.0, 255.0) as usize] * normal.value(bits);
                bits >>= NormalTable::BITS;
                if let Some(target) = targets.next() {
                    *target = (value + noise + 0.5).clamp(0.0, 255.0) as u8;
                }
            }
        }
    }
}

/// Standard normal deviates by table: the middle of each of 4096 slices of equal probability.
pub struct NormalTable(Vec<f32>);

impl Default for NormalTable {
    fn default() -> Self {
        Self::new()
    }
}

impl NormalTable {
    const BITS: u32 = 12;
    const PER_WORD: usize = 5;

    /// Tabulates the inverse of the normal distribution by summing its density.
    pub fn new() -> Self {
        let count = 1usize << Self::BITS;
        let steps = 200_000;
        let (low, high) = (-6.0f64, 6.0f64);
        let width = (high - low) / f64::from(steps);
        let mut values = Vec::with_capacity(count);
        let mut area = 0.0;
        for i in 0..steps {
            let x = low + (f64::from(i) + 0.5) * width;
            area += (-0.5 * x * x).exp() * width / std::f64::consts::TAU.sqrt();
            while values.len() < count && area * count as f64 >= values.len() as f64 + 0.5 {
                values.push(x as f32);
            }
        }
        values.resize(count, high as f32);
        Self(values)
    }

    fn value(&self, bits: u64) -> f32 {
        self.0[(bits & ((1 << Self::BITS) - 1)) as usize]
    }

    /// A deviate.
    pub fn sample(&self, rng: &mut Pcg64) -> f32 {
        self.value(rng.next_u64())
    }

    /// Fills a slice with deviates.
    pub fn fill(&self, rng: &mut Pcg64, out: &mut [f32]) {
        for values in out.chunks_mut(Self::PER_WORD) {
            let mut bits = rng.next_u64();
            for value in values {
                *value = self.value(bits);
                bits >>= Self::BITS;
            }
        }
    }
}
