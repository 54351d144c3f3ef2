//! What is pressed into the gel: drawn from a seed, laid out without overlaps.

use std::sync::Arc;

use glam::DVec2;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::contact::NO_BODY;
use super::distractors::Distractor;
use super::gel::Grid;
use super::own_part::PressedLike;
use super::pose::Pose;
use super::raster::Raster;
use super::relief::Relief;
use super::snaps::{Kind, Snap};

/// Side of the paper's gel in millimetres: plain scenes lie on it.
const GEL_MM: f64 = Raster::PAPER.width as f64 * Raster::PAPER.mm_per_pixel;

/// Least free space between two parts, in millimetres.
const CLEARANCE_MM: f64 = 0.8;

/// Heights further than this below the gel's surface are left out of the rigid body.
const BODY_DEPTH_MM: f64 = 3.0;

/// A part somewhere on the gel.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed<T> {
    /// The part.
    pub part: T,
    /// Its origin in millimetres from the gel's centre, x to the right, y down.
    pub center_mm: [f64; 2],
    /// Rotation from the gel's x towards its y, in radians.
    pub yaw: f64,
    /// Slope of the part's top plane along its own x and y.
    pub tilt: [f64; 2],
    /// Depth of its highest point below the undeformed surface if it were not tilted, in
    /// millimetres.
    pub depth_mm: f64,
}

impl<T> Placed<T> {
    /// Where the part's own frame lies on the gel.
    pub fn pose(&self) -> Pose {
        Pose { origin_mm: self.center_mm.into(), x: DVec2::from_angle(self.yaw) }
    }

    /// Coordinates of a point on the gel in the part's own frame.
    pub fn local(&self, x: f64, y: f64) -> [f64; 2] {
        self.pose().own(DVec2::new(x, y)).into()
    }

    /// How far the part reaches below the undeformed gel at a point, in millimetres.
    pub(super) fn penetration(&self, x: f64, y: f64, height: impl Fn(&T, f64, f64) -> f64) -> f64 {
        let [u, v] = self.local(x, y);
        self.depth_mm + height(&self.part, u, v) + self.tilt[0] * u + self.tilt[1] * v
    }
}

/// Which snaps a scene may hold.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize,
)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Mix {
    /// Cantilever hooks alone, at least one a picture.
    A,
    /// Split-ring studs alone, at least one a picture.
    B,
    /// Both kinds, several or none.
    #[default]
    Mixed,
    /// No snaps: other things, balls among them, or an untouched gel.
    None,
    /// An untouched gel, with its dust, scratches and stains.
    Bare,
}

impl Mix {
    /// Draws a snap's kind: of `classes`, if there are any, else A or B.
    pub(super) fn kind(self, rng: &mut Pcg64, classes: &[Kind]) -> Kind {
        match self {
            Self::A => Kind::A,
            Self::B => Kind::B,
            _ if !classes.is_empty() => classes[rng.random_range(0..classes.len())].clone(),
            Self::Mixed | Self::None | Self::Bare if rng.random_bool(0.5) => Kind::A,
            Self::Mixed | Self::None | Self::Bare => Kind::B,
        }
    }
}

/// Something that is no snap, but easily taken for one of a user's own.
#[derive(Debug, Clone, PartialEq)]
pub struct Negative {
    /// Its name, for people.
    pub name: String,
    /// Its shape.
    pub shape: NegativeShape,
    /// How often it is drawn, beside 1 of most others.
    pub weight: u32,
    /// How deep it is pressed, if not as any other shape.
    pub pressed: Option<PressedLike>,
}

/// The shape of a [`Negative`].
#[derive(Debug, Clone, PartialEq)]
pub enum NegativeShape {
    /// One and the same.
    Relief(Arc<Relief>),
    /// A snap of a kind that is no class, drawn anew each time.
    Snap(Kind),
}

impl Negative {
    /// One and the same shape.
    pub fn of(name: String, relief: Relief) -> Self {
        Self { name, shape: NegativeShape::Relief(Arc::new(relief)), weight: 1, pressed: None }
    }

    fn sample(&self, rng: &mut Pcg64, snap: impl Fn(&mut Pcg64, &Kind) -> Snap) -> Distractor {
        match &self.shape {
            NegativeShape::Relief(relief) => Distractor::Relief(relief.clone()),
            NegativeShape::Snap(kind) => Distractor::Snap(Box::new(snap(rng, kind))),
        }
    }
}

/// A user's own classes and what else is taken for them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Own {
    /// The classes in their order; none for A and B.
    pub classes: Vec<Kind>,
    /// What is no snap: half of all that is drawn beside snaps or in place of them.
    pub negatives: Vec<Negative>,
    /// Whether all that is no snap is one of these, and every picture without a snap shows one at least.
    pub negatives_alone: bool,
}

impl Own {
    /// Draws one of the negatives with how it is pressed, or none: then something else is drawn that is no snap.
    /// `snap` draws one of this kind.
    pub(super) fn negative(
        &self,
        rng: &mut Pcg64,
        snap: impl Fn(&mut Pcg64, &Kind) -> Snap,
    ) -> Option<(Distractor, Option<&PressedLike>)> {
        if self.negatives.is_empty() || !(self.negatives_alone || rng.random_bool(0.5)) {
            return None;
        }
        let negative = self.negatives.choose_weighted(rng, |negative| negative.weight).ok()?;
        Some((negative.sample(rng, snap), negative.pressed.as_ref()))
    }
}

/// Everything that touches the gel.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The snaps.
    pub snaps: Vec<Placed<Snap>>,
    /// Whatever else.
    pub distractors: Vec<Placed<Distractor>>,
}

/// A rigid body on a grid.
#[derive(Debug, Clone)]
pub struct Body {
    /// Penetration in millimetres, [`NO_BODY`] where nothing is near or the gel has ended.
    pub penetration: Vec<f32>,
    /// Index of the part that reaches deepest, snaps before distractors.
    pub owner: Vec<u8>,
}

impl Scene {
    /// Draws a plain scene.
    pub fn sample(seed: u64, mix: Mix, own: &Own) -> Self {
        let rng = &mut Pcg64::seed_from_u64(seed);
        let mut scene = Self { snaps: Vec::new(), distractors: Vec::new() };
        let count = match rng.random_range(0..100) {
            0..8 if mix == Mix::Mixed => 0,
            _ if matches!(mix, Mix::None | Mix::Bare) => 0,
            0..60 => 1,
            60..84 => 2,
            84..95 => 3,
            _ => 4,
        };
        for _ in 0..count {
            let kind = mix.kind(rng, &own.classes);
            scene.add_snap(rng, &kind);
        }
        let touched = match mix {
            Mix::Bare => 0.0,
            Mix::None if own.negatives_alone => 1.0,
            Mix::None => 0.9,
            Mix::A | Mix::B | Mix::Mixed => 0.5,
        };
        let count = if rng.random_bool(touched) { rng.random_range(1..=3) } else { 0 };
        for _ in 0..count {
            let (part, pressed) = match own.negative(rng, Snap::sample) {
                Some(negative) => negative,
                None if mix == Mix::None && rng.random_bool(0.3) => (Distractor::ball(rng), None),
                None => (Distractor::sample(rng), None),
            };
            scene.add_distractor(rng, part, pressed);
        }
        scene
    }

    /// Draws a snap of this kind alone, as plain scenes show it.
    pub fn alone(rng: &mut Pcg64, kind: &Kind) -> Self {
        let mut scene = Self { snaps: Vec::new(), distractors: Vec::new() };
        scene.add_snap(rng, kind);
        scene
    }

    fn add_snap(&mut self, rng: &mut Pcg64, kind: &Kind) {
        let part = Snap::sample(rng, kind);
        let reach = part.reach();
        let depth_mm = part.sample_depth(rng);
        let (tilt, yaw) = (sample_tilt(rng, 2.5), sample_yaw(rng));
        // Most lie on the gel as a whole, some reach over its edge.
        let reaches = if rng.random_bool(0.85) { reach } else { 0.5 };
        // What is larger than the gel lies near its middle.
        let limit = (GEL_MM / 2.0 - reaches).max(1.0);
        for _ in 0..30 {
            let center_mm = [rng.random_range(-limit..limit), rng.random_range(-limit..limit)];
            let clear = self.snaps.iter().all(|other| {
                let d =
                    (other.center_mm[0] - center_mm[0]).hypot(other.center_mm[1] - center_mm[1]);
                d > reach + other.part.reach() + CLEARANCE_MM
            });
            if clear {
                self.snaps.push(Placed { part, center_mm, yaw, tilt, depth_mm });
                return;
            }
        }
    }

    fn add_distractor(&mut self, rng: &mut Pcg64, part: Distractor, pressed: Option<&PressedLike>) {
        let half = part.half_size();
        for _ in 0..30 {
            let center_mm = match half {
                // Where the gel's edge cuts it, it may look like the part that the edge cuts.
                Some([a, b]) if pressed.is_some() => {
                    let limit = (GEL_MM / 2.0 - a.hypot(b)).max(1.0);
                    [0, 1].map(|_| rng.random_range(-limit..limit))
                }
                Some(_) => [rng.random_range(-20.0..20.0), rng.random_range(-20.0..20.0)],
                // A plate stays in the outer part, or it would fill the picture.
                None => {
                    let radius = rng.random_range(11.0..21.0);
                    let angle = rng.random_range(0.0..std::f64::consts::TAU);
                    [radius * f64::cos(angle), radius * f64::sin(angle)]
                }
            };
            let yaw = match half {
                Some(_) => sample_yaw(rng),
                None => f64::atan2(-center_mm[1], -center_mm[0]) + rng.random_range(-0.5..0.5),
            };
            let placed = Placed {
                part: part.clone(),
                center_mm,
                yaw,
                tilt: sample_tilt(rng, if half.is_some() { 2.0 } else { 0.8 }),
                depth_mm: match pressed {
                    Some(pressed) => pressed.sample_depth(rng),
                    None => rng.random_range(0.08..1.0),
                },
            };
            let clear = |center: [f64; 2], reach: f64| {
                let [u, v] = placed.local(center[0], center[1]);
                match half {
                    Some([a, b]) => {
                        (u.abs() - a).max(0.0).hypot((v.abs() - b).max(0.0)) > reach + CLEARANCE_MM
                    }
                    None => u > reach + CLEARANCE_MM,
                }
            };
            let reach_of = |d: &Placed<Distractor>| match d.part.half_size() {
                Some([a, b]) => a.hypot(b),
                None => 0.0,
            };
            if self.snaps.iter().all(|s| clear(s.center_mm, s.part.reach()))
                && self
                    .distractors
                    .iter()
                    .all(|d| d.part.half_size().is_some() && clear(d.center_mm, reach_of(d)))
            {
                self.distractors.push(placed);
                return;
            }
        }
    }

    /// The scene as one rigid body: at each cell the part that reaches deepest. The gel ends at
    /// half of `gel_mm` along x and y.
    pub fn body(&self, grid: Grid, gel_mm: [f64; 2]) -> Body {
        let mut body =
            Body { penetration: vec![NO_BODY; grid.len()], owner: vec![u8::MAX; grid.len()] };
        for (i, snap) in self.snaps.iter().enumerate() {
            let reach = snap.part.reach();
            body.add(grid, gel_mm, snap, i as u8, Some(reach), Snap::height);
        }
        for (i, part) in self.distractors.iter().enumerate() {
            let reach = part.part.half_size().map(|[a, b]| a.hypot(b));
            let owner = (self.snaps.len() + i) as u8;
            body.add(grid, gel_mm, part, owner, reach, Distractor::height);
        }
        body
    }
}

impl Body {
    fn add<T>(
        &mut self,
        grid: Grid,
        gel_mm: [f64; 2],
        placed: &Placed<T>,
        owner: u8,
        reach: Option<f64>,
        height: impl Fn(&T, f64, f64) -> f64,
    ) {
        let n = grid.cells;
        let range = |axis: usize| {
            let (center, edge) = (placed.center_mm[axis], gel_mm[axis] / 2.0);
            let (low, high) = match reach {
                Some(r) => ((center - r - 1.0).max(-edge), (center + r + 1.0).min(edge)),
                None => (-edge, edge),
            };
            let low = grid.index(low).ceil().max(0.0) as usize;
            let high = (grid.index(high).floor().max(-1.0) + 1.0) as usize;
            low..high.min(n)
        };
        for row in range(1) {
            for column in range(0) {
                let (x, y) = (grid.position(column), grid.position(row));
                let d = placed.penetration(x, y, &height) as f32;
                let i = row * n + column;
                if f64::from(d) > -BODY_DEPTH_MM && d > self.penetration[i] {
                    self.penetration[i] = d;
                    self.owner[i] = owner;
                }
            }
        }
    }
}

pub(super) fn sample_yaw(rng: &mut Pcg64) -> f64 {
    rng.random_range(-std::f64::consts::PI..std::f64::consts::PI)
}

/// Slopes along x and y of a plane tilted by at most `degrees`, mostly less.
pub(super) fn sample_tilt(rng: &mut Pcg64, degrees: f64) -> [f64; 2] {
    let slope = (degrees * rng.random_range(0.0..1.0)).to_radians().tan();
    let angle = rng.random_range(0.0..std::f64::consts::TAU);
    [slope * f64::cos(angle), slope * f64::sin(angle)]
}

/// Seed of the scene with this number in a data set: SplitMix64's finaliser over both.
pub fn scene_seed(seed: u64, index: u64) -> u64 {
    let mix = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    mix(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)).wrapping_add(index))
}
