//! From a seed to a picture and its labels.

use std::sync::Arc;

use image::RgbImage;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::Error;
use super::appearance::{Appearance, Light};
use super::camera::Camera;
use super::conditions::{Conditions, Distribution, UNIT_CONTRAST};
use super::contact::{Contact, Stop, solve};
use super::distractors::Part;
use super::forced::Forced;
use super::gel::{Elasticity, Grid, Layer};
use super::given::Given;
use super::label::{Label, imprints, labels, visible_share};
use super::layout::Region;
use super::options::{Mechanics, Optics};
use super::painter::{Painter, Sideways};
use super::press::Press;
use super::raster::PixelBox;
use super::raster::Raster;
use super::scene::{Mix, Own, Scene, scene_seed};
use super::smooth;
use super::surface::Surface;

/// Cells of a plain picture's contact: the gel, two pixels a cell, and 5.6 mm of free gel round it, 28 %
/// more along a side, so that the periodic images are far.
pub const GRID: Grid = Grid { cells: 640, spacing_mm: 2.0 * Raster::PAPER.mm_per_pixel };

/// When the contact is good enough: half a micrometre.
pub const STOP: Stop = Stop { tolerance_mm: 5e-4, max_iterations: 150 };

/// Least share of a wide picture's snap that lies in the picture.
const LEAST_VISIBLE: f64 = 0.25;

/// Scenes drawn for one seed at most.
const ATTEMPTS: u32 = 50;

/// Share of wide pictures that are drawn as plain ones.
const PLAIN_SHARE: f64 = 0.2;

/// How far a wide picture's gel goes on beyond the picture, in millimetres.
const BEYOND_MM: f64 = 2.0;

/// Free gel between a wide picture's gel and the edge of the periodic grid, in millimetres, as in
/// [`GRID`].
const FREE_MM: f64 = 5.6;

/// What to draw.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Request {
    /// Which snaps.
    pub mix: Mix,
    /// From what the conditions are drawn.
    pub conditions: Distribution,
    /// The one kind of thing that is no snap; in wide pictures only.
    pub part: Option<Part>,
    /// Conditions that are set; in wide pictures only.
    pub forced: Forced,
    /// The one sensor that takes all pictures; in wide pictures only.
    pub sensor: Option<Arc<Given>>,
    /// Whether the pictures are the frames of [`Press`]es; plain ones only.
    pub press: bool,
    /// Classes of one's own in place of A and B.
    pub own: Own,
}

impl Request {
    /// Plain pictures.
    pub fn plain(mix: Mix) -> Self {
        Self { mix, ..Self::default() }
    }

    /// Wide pictures.
    pub fn wide(mix: Mix) -> Self {
        Self { mix, conditions: Distribution::Wide, ..Self::default() }
    }
}

/// A picture with its labels.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The picture.
    pub picture: RgbImage,
    /// What it measures.
    pub frame: Raster,
    /// How it was taken.
    pub conditions: Conditions,
    /// Labels of all snaps in it.
    pub labels: Vec<Label>,
}

/// The transforms of one gel on one grid.
struct Plan {
    layer: Layer,
    elasticity: Elasticity,
    sideways: Option<Elasticity>,
}

impl Plan {
    fn new(layer: Layer, grid: Grid) -> Self {
        Self { layer, elasticity: Elasticity::new(&layer, grid), sideways: None }
    }
}

/// Renders scenes; keeps plans and buffers between pictures. One a thread.
pub struct Renderer {
    plain: Option<Plan>,
    wide: Option<Plan>,
    painter: Painter,
}

impl Default for Renderer {
    fn default() -> Self {
        Self::new()
    }
}

impl Renderer {
    /// A renderer without plans; they are made when a picture needs them.
    pub fn new() -> Self {
        Self { plain: None, wide: None, painter: Painter::new() }
    }

    /// Renders the picture of this seed.
    ///
    /// # Errors
    /// [`Error::NoScene`] if no scene drawn from the seed shows all of its snaps.
    pub fn render(&mut self, seed: u64, request: &Request) -> Result<Rendered, Error> {
        if request.conditions == Distribution::Plain {
            return self.plain(seed, request);
        }
        // Streams of their own, so that what is forced in one leaves what the others draw; within its own
        // it may change what is drawn after it.
        let mut streams = Pcg64::seed_from_u64(seed);
        let mut stream = || Pcg64::seed_from_u64(streams.random_range(0..u64::MAX));
        let [mut choice, mut conditions, mut scenes, mut sensor] = [(); 4].map(|()| stream());
        let sensor_forced = request.sensor.as_ref().map(|given| given.force(&request.forced));
        let forced = sensor_forced.as_ref().unwrap_or(&request.forced);
        let free = request.part.is_none() && *forced == Forced::default();
        if choice.random_bool(PLAIN_SHARE) && free {
            return self.plain(choice.random_range(0..u64::MAX), request);
        }
        let (frame, mut conditions) = Conditions::sample(&mut conditions, forced);
        if let Some(given) = &request.sensor {
            given.state(&mut conditions);
        }
        self.wide(seed, request, frame, conditions, &mut scenes, &mut sensor)
    }

    /// Renders a frame of the presses of this seed, the first [`Press::FRAMES`] of one, the next of another;
    /// `noise` is the frame's own seed.
    pub fn press(&mut self, seed: u64, frame: usize, noise: u64, request: &Request) -> Rendered {
        let (number, frame) = (frame / Press::FRAMES, frame % Press::FRAMES);
        let press = Press::sample(scene_seed(seed, number as u64), request.mix, &request.own);
        let plan = self.plain.get_or_insert_with(|| Plan::new(Layer::default(), GRID));
        let (scene, look) = press.at(frame);
        let [width, height] = look.camera.frame.size_px();
        let window = [0.0, 0.0, width, height];
        let body = scene.body(GRID, look.camera.frame.size_mm());
        let contact = solve(&mut plan.elasticity, &body.penetration, STOP);
        let found = imprints(&body, &contact, GRID, &look.camera, window, scene.snaps.len());
        // What is too faint has no label.
        let labels = labels(&scene.snaps, &found, &look.camera, window).unwrap_or_default();
        let surface = Surface::new(GRID, contact.displacement);
        let mut rng = Pcg64::seed_from_u64(noise);
        let picture = self.painter.paint(&look, &surface, None, &mut rng);
        let conditions = plain_conditions(&look, plan.layer, window);
        Rendered { picture, frame: look.camera.frame, conditions, labels }
    }

    fn plain(&mut self, seed: u64, request: &Request) -> Result<Rendered, Error> {
        let mix = request.mix;
        let mut rng = Pcg64::seed_from_u64(seed);
        let camera = plain_camera(&mut rng);
        for _ in 0..ATTEMPTS {
            let scene = Scene::sample(rng.random_range(0..u64::MAX), mix, &request.own);
            if matches!(mix, Mix::A | Mix::B) && scene.snaps.is_empty() {
                continue;
            }
            if let Some(rendered) = self.plain_scene(&scene, camera, &mut rng) {
                return Ok(rendered);
            }
        }
        Err(Error::NoScene { seed, attempts: ATTEMPTS })
    }

    /// Renders this scene as a plain picture, whose focus, light, wear and noise are drawn from `seed`. `None` if
    /// one of its snaps is not to be seen.
    pub fn scene(&mut self, scene: &Scene, seed: u64) -> Option<Rendered> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let camera = plain_camera(&mut rng);
        self.plain_scene(scene, camera, &mut rng)
    }

    fn plain_scene(&mut self, scene: &Scene, camera: Camera, rng: &mut Pcg64) -> Option<Rendered> {
        let plan = self.plain.get_or_insert_with(|| Plan::new(Layer::default(), GRID));
        let frame = camera.frame;
        let [width, height] = frame.size_px();
        let window = [0.0, 0.0, width, height];
        let body = scene.body(GRID, frame.size_mm());
        let contact = solve(&mut plan.elasticity, &body.penetration, STOP);
        let found = imprints(&body, &contact, GRID, &camera, window, scene.snaps.len());
        let labels = labels(&scene.snaps, &found, &camera, window)?;
        let surface = Surface::new(GRID, contact.displacement);
        let look = Appearance::plain(rng, camera);
        let picture = self.painter.paint(&look, &surface, None, rng);
        let conditions = plain_conditions(&look, plan.layer, window);
        Some(Rendered { picture, frame, conditions, labels })
    }

    fn wide(
        &mut self,
        seed: u64,
        request: &Request,
        frame: Raster,
        mut conditions: Conditions,
        scenes: &mut Pcg64,
        sensor: &mut Pcg64,
    ) -> Result<Rendered, Error> {
        let window = conditions.window;
        // A housing that is drawn hides gel; of a given sensor the frame shows it there alone.
        let [width, height] = frame.size_px();
        let gel = if request.sensor.is_some() { window } else { [0.0, 0.0, width, height] };
        let middle = [(gel[0] + gel[2]) / 2.0, (gel[1] + gel[3]) / 2.0];
        let [left, top, right, bottom] = region(&frame, gel, middle);
        let field_mm = [right - left, bottom - top];
        let visible = region(&frame, window, middle);
        let longer_mm = f64::max(field_mm[0], field_mm[1]);
        let mut camera = Camera {
            frame,
            distance_mm: if request.forced.mild {
                125.0 * longer_mm / Raster::PAPER.longer_mm()
            } else {
                longer_mm * sensor.random_range(1.5..4.0)
            },
            origin_mm: [0.0; 2],
            distortion: conditions.distortion,
            blur_px: conditions.blur_px,
            snr_db: conditions.snr_db,
            read_noise: sensor.random_range(0.3..1.5),
        };
        let layer = Layer { thickness_mm: conditions.gel_mm, ..Layer::default() };
        // Millimetres begin in the middle of the gel, as the contact's grid does.
        camera.origin_mm = camera.flat_place(middle[0], middle[1]);
        let gel_mm = shown(&camera, gel, field_mm).map(|side| side + 2.0 * BEYOND_MM);
        let grid = contact_grid(&frame, gel_mm);
        if self
            .wide
            .as_ref()
            .is_none_or(|plan| plan.layer != layer || plan.elasticity.grid() != grid)
        {
            self.wide = Some(Plan::new(layer, grid));
        }
        let plan = self.wide.get_or_insert_with(|| Plan::new(layer, grid));
        // The coating has a thickness, and rounds edges by it; less than a cell would show the grid.
        let skin_cells = (sensor.random_range(0.05..0.15) / grid.spacing_mm).max(0.9);
        let falloff_mm = sensor.random_range(0.1f64..0.8);
        for _ in 0..ATTEMPTS {
            let rng = &mut Pcg64::seed_from_u64(scenes.random_range(0..u64::MAX));
            let scene = Scene::sample_wide(
                rng,
                visible,
                request.mix,
                request.part,
                (&request.forced, &request.own),
            );
            if matches!(request.mix, Mix::A | Mix::B) && scene.snaps.is_empty() {
                continue;
            }
            let seen = |snap| visible_share(snap, &camera, window) >= LEAST_VISIBLE;
            if !scene.snaps.iter().all(seen) {
                continue;
            }
            let body = scene.body(grid, gel_mm);
            let contact = match conditions.mechanics {
                Mechanics::Elastic => solve(&mut plan.elasticity, &body.penetration, STOP),
                Mechanics::Smoothed => smooth::pressed(grid, &body.penetration, falloff_mm),
            };
            let found = imprints(&body, &contact, grid, &camera, window, scene.snaps.len());
            let Some(labels) = labels(&scene.snaps, &found, &camera, window) else { continue };
            let mut look = Appearance::wide(sensor, camera, &conditions);
            if let Some(given) = &request.sensor {
                given.dress(&mut look);
            }
            conditions.light_deg = look.light_deg();
            let sideways = look.markers.is_some().then(|| plan.sideways(&contact, sensor));
            let mut displacement = contact.displacement;
            smooth::blur(grid.cells, &mut displacement, skin_cells);
            let surface = Surface::new(grid, displacement);
            let picture = self.painter.paint(&look, &surface, sideways.as_ref(), sensor);
            return Ok(Rendered { picture, frame, conditions, labels });
        }
        Err(Error::NoScene { seed, attempts: ATTEMPTS })
    }
}

impl Plan {
    /// How the gel under this contact moved sideways: by incompressibility as the layer's solution
    /// says; and with the parts, which slide along by up to 0.4 mm and take the gel near them with
    /// them. The latter is drawn, not solved: the contact is frictionless.
    fn sideways(&mut self, contact: &Contact, rng: &mut Pcg64) -> Sideways {
        let grid = self.elasticity.grid();
        let all = vec![true; grid.cells];
        let transform =
            self.sideways.get_or_insert_with(|| Elasticity::sideways(&self.layer, grid));
        let mut potential = vec![0.0; grid.len()];
        transform.displacement(&contact.displacement, &all, &all, &mut potential);
        let mut share: Vec<f32> =
            contact.pressure.iter().map(|&p| if p > 0.0 { 1.0 } else { 0.0 }).collect();
        let reach = 0.4 * self.layer.thickness_mm;
        smooth::blur(grid.cells, &mut share, reach / grid.spacing_mm);
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let slide = if rng.random_bool(0.5) { rng.random_range(0.0..0.4) } else { 0.0 };
        Sideways {
            potential: Surface::new(grid, potential),
            share: Surface::new(grid, share),
            shear_mm: [slide * f64::cos(angle), slide * f64::sin(angle)],
        }
    }
}

/// The grid of a wide picture's contact: two pixels a cell within 0.05 and 0.08 mm, no more than
/// 640 cells, a number whose transforms are fast.
pub fn contact_grid(frame: &Raster, gel_mm: [f64; 2]) -> Grid {
    const CELLS: [usize; 16] =
        [240, 256, 288, 320, 360, 384, 400, 432, 450, 480, 500, 512, 540, 576, 600, 640];
    let side = f64::max(gel_mm[0], gel_mm[1]) + 2.0 * FREE_MM;
    let wanted = side / (2.0 * frame.mm_per_pixel).clamp(0.05, 0.08);
    let cells = CELLS.into_iter().find(|&cells| cells as f64 >= wanted).unwrap_or(640);
    Grid { cells, spacing_mm: side / cells as f64 }
}

/// What of the gel a window of the picture shows without the lens, in millimetres from what is seen at
/// `middle`: where parts are laid out.
fn region(frame: &Raster, [x0, y0, x1, y1]: PixelBox, middle: [f64; 2]) -> Region {
    let [left, top] = frame.to_mm(middle);
    let ([a, b], [c, d]) = (frame.to_mm([x0, y0]), frame.to_mm([x1, y1]));
    [a - left, b - top, c - left, d - top]
}

/// Size about the middle of the gel that holds all that its part of the picture shows: more than
/// `field_mm` where the lens shows more in the corners.
fn shown(camera: &Camera, [x0, y0, x1, y1]: PixelBox, field_mm: [f64; 2]) -> [f64; 2] {
    let corners = [(x0, y0), (x0, y1), (x1, y0), (x1, y1)].map(|(x, y)| camera.flat_place(x, y));
    [0, 1]
        .map(|axis| corners.iter().fold(field_mm[axis], |size, at| size.max(2.0 * at[axis].abs())))
}

/// The paper's camera, more or less in focus.
fn plain_camera(rng: &mut Pcg64) -> Camera {
    Camera { blur_px: rng.random_range(0.6..2.2), ..Camera::default() }
}

fn plain_conditions(look: &Appearance, layer: Layer, window: PixelBox) -> Conditions {
    let contrast = match &look.light {
        Light::Measured(shading) => shading.contrast(),
        Light::Lamps(lamps) => lamps.contrast(),
    };
    Conditions {
        plain: true,
        optics: Optics::Measured,
        mechanics: Mechanics::Elastic,
        gel_mm: layer.thickness_mm,
        strength: contrast / UNIT_CONTRAST,
        shadows: 0.0,
        colour: look.coating.colour(),
        exposure: look.exposure.into(),
        markers_mm: 0.0,
        mottle: look.coating.mottle(),
        jpeg: None,
        blur_px: look.camera.blur_px,
        vignetting: 0.0,
        housing: false,
        distortion: 0.0,
        snr_db: look.camera.snr_db,
        window,
        darkness: 0.0,
        rim: 0.0,
        light_deg: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The corners lie half a diagonal from the middle: there the lens shows 1 + κ of the field.
    #[test]
    fn what_a_lens_shows_in_the_corners_is_drawn() {
        let frame = Raster { width: 640, height: 480, mm_per_pixel: 0.05 };
        for (distortion, size) in [(0.5, [48.0, 36.0]), (0.0, [32.0, 24.0]), (-0.3, [32.0, 24.0])] {
            let camera = Camera { frame, distortion, ..Camera::default() };
            let found = shown(&camera, [0.0, 0.0, 640.0, 480.0], frame.size_mm());
            let off = [0, 1].map(|axis| (found[axis] - size[axis]).abs());
            assert!(off[0].max(off[1]) < 1e-9, "{distortion}: {found:?}");
        }
    }
}
