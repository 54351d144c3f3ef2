//! From a scene to a picture and its labels.

use image::RgbImage;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::camera::{Camera, NormalTable};
use super::coating::Coating;
use super::contact::{Stop, solve};
use super::gel::{Elasticity, Grid, Layer};
use super::label::{Imprint, PixelBox, imprints};
use super::optics::Shading;
use super::scene::{Mix, Placed, Scene};
use super::snaps::{Kind, Snap};
use super::{Error, MM_PER_PX, PICTURE_PX};

/// The deformed surface of the gel.
pub struct Surface {
    grid: Grid,
    /// Depth and gradient of each cell.
    cells: Vec<[f32; 3]>,
}

/// The surface at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Displacement into the gel in millimetres.
    pub depth: f32,
    /// Its derivatives along x and y.
    pub gradient: [f32; 2],
}

impl Surface {
    /// Takes displacements in millimetres, `[cells][cells]`, and finds gradients by central
    /// differences.
    ///
    /// # Panics
    /// If `displacement` is not as long as the grid.
    pub fn new(grid: Grid, displacement: Vec<f32>) -> Self {
        let n = grid.cells;
        assert_eq!(displacement.len(), n * n);
        let scale = (0.5 / grid.spacing_mm) as f32;
        let mut cells = Vec::with_capacity(n * n);
        for y in 0..n {
            let above = &displacement[y.saturating_sub(1) * n..][..n];
            let row = &displacement[y * n..][..n];
            let below = &displacement[(y + 1).min(n - 1) * n..][..n];
            for x in 0..n {
                cells.push([
                    row[x],
                    scale * (row[(x + 1).min(n - 1)] - row[x.saturating_sub(1)]),
                    scale * (below[x] - above[x]),
                ]);
            }
        }
        Self { grid, cells }
    }

    /// The surface at a point in millimetres from the centre, between cells by bilinear
    /// interpolation; the outermost cells go on for ever.
    pub fn at(&self, x_mm: f64, y_mm: f64) -> SurfacePoint {
        let last = (self.grid.cells - 1) as f32;
        let x = (self.grid.index(x_mm) as f32).clamp(0.0, last - 0.001);
        let y = (self.grid.index(y_mm) as f32).clamp(0.0, last - 0.001);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let i = row * self.grid.cells + column;
        let [a, b] = [self.cells[i], self.cells[i + 1]];
        let [c, d] = [self.cells[i + self.grid.cells], self.cells[i + self.grid.cells + 1]];
        let mix = |k: usize| {
            let top = a[k] + fx * (b[k] - a[k]);
            let bottom = c[k] + fx * (d[k] - c[k]);
            top + fy * (bottom - top)
        };
        SurfacePoint { depth: mix(0), gradient: [mix(1), mix(2)] }
    }
}

impl Surface {
    /// The point of the surface that the camera sees where a flat gel would show the point
    /// `x_mm`, `y_mm`.
    ///
    /// It solves `x = x_mm (1 − depth(x) / distance)`, [`Camera::project`] backwards, in two steps
    /// from the flat gel. A step shrinks the error by the slope times `x_mm / distance`, which is
    /// 0.16 for a slope of 1 at the gel's edge.
    pub fn seen(&self, camera: &Camera, x_mm: f64, y_mm: f64) -> SurfacePoint {
        let mut point = self.at(x_mm, y_mm);
        for _ in 0..2 {
            if point.depth.abs() < 1e-3 {
                break;
            }
            let shrink = 1.0 - f64::from(point.depth) / camera.distance_mm;
            point = self.at(x_mm * shrink, y_mm * shrink);
        }
        point
    }
}

/// Cells of the contact's grid: the gel, two pixels a cell, and half as much again of free gel
/// round it, so that the periodic images are far.
pub const GRID: Grid = Grid { cells: 640, spacing_mm: 2.0 * MM_PER_PX };

/// When the contact is good enough: half a micrometre.
pub const STOP: Stop = Stop { tolerance_mm: 5e-4, max_iterations: 150 };

/// An imprint's longer side must be at least this, in pixels, or the scene is drawn anew: no snap
/// is visible without a label.
pub const LEAST_IMPRINT_PX: f64 = 1.5 / MM_PER_PX;

/// Scenes drawn for one seed at most.
const ATTEMPTS: u32 = 50;

/// A labelled snap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// Its kind.
    pub kind: Kind,
    /// Box round the imprint, `x0, y0, x1, y1` in pixels.
    pub pixel_box: PixelBox,
    /// Area in contact, in square pixels.
    pub area_px: f64,
    /// Rotation from x towards y, in degrees.
    pub yaw_deg: f64,
    /// Depth of the highest point below the undeformed surface, in millimetres.
    pub depth_mm: f64,
    /// Middle of the box in millimetres from the picture's centre, x right, y down.
    pub center_mm: [f64; 2],
}

/// A picture with its labels.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The picture, [`PICTURE_PX`] square.
    pub picture: RgbImage,
    /// Labels of all snaps in it.
    pub labels: Vec<Label>,
}

/// Renders scenes; keeps plans and buffers between pictures. One a thread.
pub struct Renderer {
    elasticity: Elasticity,
    normal: NormalTable,
    texture: Vec<f32>,
    gradients: Vec<[f32; 2]>,
    plane: Vec<f32>,
    scratch: Vec<f32>,
}

impl Default for Renderer {
    fn default() -> Self {
        Self::new()
    }
}

impl Renderer {
    /// Plans the transforms and makes the buffers.
    pub fn new() -> Self {
        Self {
            elasticity: Elasticity::new(&Layer::default(), GRID),
            normal: NormalTable::new(),
            texture: Vec::new(),
            gradients: Vec::new(),
            plane: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// Renders the scene of this seed.
    ///
    /// # Errors
    /// [`Error::NoScene`] if no scene drawn from the seed shows all of its snaps.
    pub fn render(&mut self, seed: u64, mix: Mix) -> Result<Rendered, Error> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let camera = Camera { blur_px: rng.random_range(0.6..2.2), ..Camera::default() };
        for _ in 0..ATTEMPTS {
            let scene = Scene::sample(rng.random_range(0..u64::MAX), mix);
            if matches!(mix, Mix::A | Mix::B) && scene.snaps.is_empty() {
                continue;
            }
            let body = scene.body(GRID);
            let contact = solve(&mut self.elasticity, &body.penetration, &[], STOP);
            let found = imprints(&body, &contact, GRID, &camera, scene.snaps.len());
            let labels: Vec<Label> = scene
                .snaps
                .iter()
                .zip(found)
                .filter_map(|(snap, imprint)| label(snap, imprint?))
                .collect();
            if labels.len() == scene.snaps.len() {
                let surface = Surface::new(GRID, contact.displacement);
                let picture = self.picture(&surface, &camera, &mut rng);
                return Ok(Rendered { picture, labels });
            }
        }
        Err(Error::NoScene { seed, attempts: ATTEMPTS })
    }

    /// The picture that a randomly drawn sensor takes of this surface.
    fn picture(&mut self, surface: &Surface, camera: &Camera, rng: &mut Pcg64) -> RgbImage {
        const N: usize = PICTURE_PX;
        let shading = Shading::sample(rng);
        let coating = Coating::sample(rng);
        let exposure = rng.random_range(0.85f32..1.15);

        self.gradients.clear();
        for y in 0..N {
            let y_mm = (y as f64 + 0.5 - N as f64 / 2.0) * MM_PER_PX;
            for x in 0..N {
                let x_mm = (x as f64 + 0.5 - N as f64 / 2.0) * MM_PER_PX;
                self.gradients.push(surface.seen(camera, x_mm, y_mm).gradient);
            }
        }
        coating.texture(&self.normal, &mut self.texture, &mut self.gradients);

        let mut bytes = vec![0u8; N * N * 3];
        self.plane.resize(N * N, 0.0);
        for channel in 0..3 {
            let coefficients = &shading.channels[channel];
            for y in 0..N {
                let v = ((y as f64 + 0.5) * 2.0 / N as f64 - 1.0) as f32;
                // Along a row each coefficient is a quadratic in x.
                let rows = coefficients.map(|c| {
                    let c = c.map(|c| c as f32);
                    [c[0] + v * (c[2] + v * c[5]), c[1] + v * c[4], c[3]]
                });
                let row = y * N..(y + 1) * N;
                let values = self.plane[row.clone()]
                    .iter_mut()
                    .zip(&self.gradients[row.clone()])
                    .zip(&self.texture[row])
                    .enumerate();
                for (x, ((value, &[gx, gy]), texture)) in values {
                    let u = (x as f32 + 0.5) * (2.0 / N as f32) - 1.0;
                    let [a, b, c, d, e] = rows.map(|r| r[0] + u * (r[1] + u * r[2]));
                    let scale = 1.0 / (1.0 + gx * gx + gy * gy).sqrt();
                    let (nx, ny) = (gx * scale, gy * scale);
                    let change = nx * (a + c * nx + d * ny) + ny * (b + e * ny);
                    *value = exposure * texture * (1.0 + change).max(0.02);
                }
            }
            // The flat field is smooth: every eighth column is enough.
            const STEP: usize = 8;
            for y in 0..N {
                let v = ((y as f64 + 0.5) * 2.0 / N as f64 - 1.0) as f32;
                let at = |x: usize| coating.flat(channel, x as f32 * (2.0 / N as f32) - 1.0, v);
                let mut left = at(0);
                for x in (0..N).step_by(STEP) {
                    let right = at(x + STEP);
                    for i in 0..STEP {
                        let t = (i as f32 + 0.5) / STEP as f32;
                        self.plane[y * N + x + i] *= left + t * (right - left);
                    }
                    left = right;
                }
            }
            camera.blur(&mut self.plane, &mut self.scratch);
            camera.digitise(&self.plane, &self.normal, rng, &mut bytes, channel, 3);
        }
        RgbImage::from_raw(N as u32, N as u32, bytes).expect("three bytes a pixel")
    }
}

fn label(snap: &Placed<Snap>, imprint: Imprint) -> Option<Label> {
    let [x0, y0, x1, y1] = imprint.pixel_box;
    if (x1 - x0).max(y1 - y0) < LEAST_IMPRINT_PX {
        return None;
    }
    let middle = PICTURE_PX as f64 / 2.0;
    Some(Label {
        kind: snap.part.kind(),
        pixel_box: imprint.pixel_box,
        area_px: imprint.area_px,
        yaw_deg: snap.yaw.to_degrees(),
        depth_mm: snap.depth_mm,
        center_mm: [(0.5 * (x0 + x1) - middle) * MM_PER_PX, (0.5 * (y0 + y1) - middle) * MM_PER_PX],
    })
}
