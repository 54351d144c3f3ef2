//! How the parts of a wide picture lie.
//!
//! Four tenths show no snap but look-alikes, or nothing at all; the others show snaps with or
//! without look-alikes beside them. Most snaps lie in the picture as a whole, 15 % are cut by its
//! edge, and some touch another part.

use glam::DVec2;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64;

use super::distractors::{Distractor, Part};
use super::footprint::Footprint;
use super::forced::Forced;
use super::hook::Hook;
use super::scene::{Mix, Own, Placed, Scene, sample_tilt, sample_yaw};
use super::snaps::{Kind, Snap};

/// Share of mixed pictures without a snap.
const WITHOUT_SNAP: f64 = 0.4;
/// Share of snaps that the picture's edge cuts.
const CUT: f64 = 0.15;
/// Least free space between parts that do not touch, in millimetres.
const CLEARANCE_MM: f64 = 0.4;
/// Greatest depth of a ball, in millimetres.
const DEEPEST_MM: f64 = 2.0;
/// Attempts to place a part.
const TRIES: u32 = 30;

/// Look-alikes and other things, as often as they stand here. [`Part::Clutter`] is none: it is drawn where
/// it is asked for.
const PARTS: [Part; 20] = [
    Part::Arm,
    Part::Arm,
    Part::Arm,
    Part::Block,
    Part::Block,
    Part::Block,
    Part::Tab,
    Part::Tab,
    Part::Ring,
    Part::Ring,
    Part::Ring,
    Part::Screw,
    Part::Screw,
    Part::Nut,
    Part::Nut,
    Part::Ball,
    Part::Prism,
    Part::Letters,
    Part::Bracket,
    Part::Rib,
];

/// A part of the gel: least x and y, greatest x and y in millimetres from the gel's middle.
pub type Region = [f64; 4];

/// The footprint of a part. A plate's is as far as a picture reaches.
fn footprint(placed: &Placed<Distractor>) -> Footprint {
    let yaw = placed.yaw;
    match placed.part.half_size() {
        Some(half) => Footprint::of(placed.center_mm, half, yaw),
        None => {
            let center = placed.pose().origin_mm - 40.0 * placed.pose().x;
            Footprint::of(center, [40.0, 80.0], yaw)
        }
    }
}

/// Lays out a wide scene.
pub(super) struct Layout<'a> {
    pub(super) rng: &'a mut Pcg64,
    pub(super) forced: &'a Forced,
    pub(super) own: &'a Own,
    pub(super) visible: Region,
    pub(super) scene: Scene,
    taken: Vec<Footprint>,
}

impl Scene {
    /// Draws a wide scene for this part of the gel.
    ///
    /// `part` narrows what is no snap to one kind.
    pub fn sample_wide(
        rng: &mut Pcg64,
        visible: Region,
        mix: Mix,
        part: Option<Part>,
        (forced, own): (&Forced, &Own),
    ) -> Self {
        let scene = Self { snaps: Vec::new(), distractors: Vec::new() };
        let mut layout = Layout { rng, forced, own, visible, scene, taken: Vec::new() };
        layout.fill(mix, part);
        layout.scene
    }
}

impl Layout<'_> {
    fn fill(&mut self, mix: Mix, part: Option<Part>) {
        if let Some(gap) = self.forced.gap.filter(|_| mix != Mix::Bare) {
            return self.fill_with_company(gap, mix, part);
        }
        // One part to 150 mm², four at most.
        let [x0, y0, x1, y1] = self.visible;
        let room = (((x1 - x0) * (y1 - y0) / 150.0) as usize).clamp(1, 4);
        let without = match mix {
            Mix::Bare => return,
            Mix::None => true,
            Mix::Mixed => self.rng.random_bool(WITHOUT_SNAP),
            Mix::A | Mix::B => false,
        };
        if without {
            // Now and then bare gel.
            let count = match self.rng.random_range(0..20) {
                0 if part.is_none() && !self.own.negatives_alone => 0,
                0..13 => 1,
                _ => self.rng.random_range(1..=room),
            };
            for _ in 0..count {
                self.add_other(part);
            }
            return;
        }
        let count = match self.rng.random_range(0..100) {
            0..60 => 1,
            60..84 => 2,
            84..95 => 3,
            _ => 4,
        };
        for _ in 0..count.min(room) {
            let kind = mix.kind(self.rng, &self.own.classes);
            self.add_snap(&kind);
        }
        let touching = self.rng.random_bool(0.15) && !self.forced.mild;
        if self.forced.touching.unwrap_or(touching) {
            self.add_neighbour(part);
        }
        if self.rng.random_bool(0.5) {
            for _ in 0..self.rng.random_range(1..=room) {
                self.add_other(part);
            }
        }
    }

    pub(super) fn draw_part(&mut self, part: Option<Part>) -> Part {
        match part {
            Some(part) => part,
            None if self.rng.random_bool(0.06) => Part::Edge,
            None if self.rng.random_bool(0.06) => Part::Pin,
            None => *PARTS.choose(self.rng).unwrap_or(&Part::Block),
        }
    }

    /// A place for a footprint of this half size at this yaw, as a whole in the picture if it fits.
    fn place(&mut self, half: [f64; 2], yaw: f64, cut: bool) -> [f64; 2] {
        let shape = Footprint::of([0.0; 2], half, yaw);
        let extent = [shape.extent(0.0), shape.extent(std::f64::consts::FRAC_PI_2)];
        let [x0, y0, x1, y1] = self.visible;
        let sides = [[x0, x1], [y0, y1]];
        let mut center = [0, 1].map(|axis| {
            let [low, high] = sides[axis];
            let (low_in, high_in) = (low + extent[axis] + 0.3, high - extent[axis] - 0.3);
            if low_in < high_in {
                self.rng.random_range(low_in..high_in)
            } else {
                // Too large for the picture: near its middle.
                (low + high) / 2.0 + self.rng.random_range(-1.0..1.0)
            }
        });
        if cut {
            let axis = self.rng.random_range(0..2);
            // A tenth to six tenths lie outside.
            let outside = extent[axis] * (2.0 * self.rng.random_range(0.1..0.6) - 1.0);
            let [low, high] = sides[axis];
            center[axis] = if self.rng.random_bool(0.5) { low - outside } else { high + outside };
        }
        center
    }

    fn is_free(&self, footprint: &Footprint) -> bool {
        self.taken.iter().all(|other| other.gap(footprint) > CLEARANCE_MM)
    }

    /// A snap of this kind, and how deep it is pressed.
    pub(super) fn draw_snap(&mut self, kind: &Kind) -> (Snap, f64) {
        let mut part = Snap::sample_wide(self.rng, kind, self.forced);
        let mut depth_mm = part.sample_wide_depth(self.rng);
        if self.forced.leaves_parts_plain() {
            part = Snap::sample(self.rng, kind);
            depth_mm = part.sample_depth(self.rng);
        }
        (part, self.forced.depth.map_or(depth_mm, |span| span.sample(self.rng)))
    }

    fn add_snap(&mut self, kind: &Kind) {
        let (part, depth_mm) = self.draw_snap(kind);
        // A long wall at a large tilt would go deeper than any snap.
        let walled = matches!(part, Snap::Hook(Hook { wall: true, .. }));
        let tilt = sample_tilt(self.rng, if walled { 1.0 } else { 3.5 });
        let cut = self.rng.random_bool(CUT);
        let cut = self.forced.cut.unwrap_or(cut);
        let half = part.half_size();
        for _ in 0..TRIES {
            let yaw = sample_yaw(self.rng);
            let center_mm = self.place(half, yaw, cut);
            let placed = Placed { part: part.clone(), center_mm, yaw, tilt, depth_mm };
            let wall = self.wall_of(&placed);
            if self.claim(Footprint::of(center_mm, half, yaw), &wall) {
                self.scene.snaps.push(placed);
                self.scene.distractors.extend(wall);
                return;
            }
        }
    }

    /// The wall that a snap grows from, if it has one.
    pub(super) fn wall_of(&mut self, placed: &Placed<Snap>) -> Vec<Placed<Distractor>> {
        match &placed.part {
            Snap::Hook(hook @ Hook { wall: true, .. }) => {
                let above = if hook.on_side.is_some() { 0.0 } else { -hook.undercut };
                self.wall(placed, placed.part.half_size(), above)
            }
            _ => Vec::new(),
        }
    }

    /// Takes the place of a part and its wall, if it is free.
    fn claim(&mut self, part: Footprint, wall: &[Placed<Distractor>]) -> bool {
        let all: Vec<Footprint> = std::iter::once(part).chain(wall.iter().map(footprint)).collect();
        let free = all.iter().all(|footprint| self.is_free(footprint));
        if free {
            self.taken.extend(all);
        }
        free
    }

    /// Draws the wall or plate that an arm of this half size grows from, at its end against x.
    /// `above` is the arm's height over the placed part's highest point.
    fn wall<T>(&mut self, arm: &Placed<T>, half: [f64; 2], above: f64) -> Vec<Placed<Distractor>> {
        let rng = &mut *self.rng;
        let (length, width) = (2.0 * half[0], 2.0 * half[1]);
        let fillet = rng.random_range(0.05..0.3);
        // Flush with the arm, or higher, or lower.
        let top = above + [0.0, rng.random_range(-0.4..0.8)][usize::from(rng.random_bool(0.7))];
        let block = |length: f64, width: f64| Distractor::Arm {
            length,
            width,
            ramp: 0.0,
            angle: 0.5,
            corner: 0.1,
            fillet,
        };
        let root = -length / 2.0;
        let mut parts = Vec::new();
        match rng.random_range(0..10) {
            // A wall across.
            0..6 => {
                let thickness = rng.random_range(1.0..4.0);
                let wide = width + rng.random_range(0.5..10.0);
                let aside = rng.random_range(-0.4..0.4) * (wide - width);
                parts.push((block(thickness, wide), [root - thickness / 2.0, aside], top));
            }
            // A plate that ends at the root.
            6..8 => parts.push((Distractor::Edge { fillet }, [root, 0.0], top)),
            // A plate from which the arm is cut out.
            _ => {
                let gap = rng.random_range(0.5..1.6);
                let bar = rng.random_range(0.8..3.0);
                let thickness = rng.random_range(1.0..3.0);
                let wide = width + 2.0 * (gap + bar);
                let long = length + rng.random_range(-1.0..2.0);
                parts.push((block(thickness, wide), [root - thickness / 2.0, 0.0], top));
                for side in [-1.0, 1.0] {
                    let y = side * (width / 2.0 + gap + bar / 2.0);
                    parts.push((block(long, bar), [root + long / 2.0, y], top));
                }
            }
        }
        let pose = arm.pose();
        let place = |(part, [u, v], top): (Distractor, [f64; 2], f64)| Placed {
            part,
            center_mm: pose.gel([u, v]).into(),
            yaw: arm.yaw,
            tilt: arm.tilt,
            // In the plane of the arm's tilt.
            depth_mm: arm.depth_mm + top + arm.tilt[0] * u + arm.tilt[1] * v,
        };
        parts.into_iter().map(place).collect()
    }

    /// `only` narrows it to one kind.
    fn add_other(&mut self, only: Option<Part>) {
        let part = self.draw_part(only);
        let forced = self.forced;
        let own = match only {
            None => self.own.negative(self.rng, |rng, kind| Snap::sample_wide(rng, kind, forced)),
            Some(_) => None,
        };
        let (shape, pressed) = match own {
            Some((shape, pressed)) => (Some(shape), pressed),
            None => (Distractor::sample_wide(self.rng, part, forced), None),
        };
        let Some(shape) = shape else { return };
        let depth_mm = match (pressed, &shape) {
            (Some(pressed), _) => pressed.sample_wide_depth(self.rng),
            // A ball is calibrated with: as deep as its half sphere, so that its whole outline shows.
            (None, Distractor::Pin { radius, .. })
                if part == Part::Ball && self.rng.random_bool(0.6) =>
            {
                (radius * self.rng.random_range(0.4..1.0)).min(DEEPEST_MM)
            }
            _ if self.rng.random_bool(0.25) => self.rng.random_range(0.1..0.6),
            _ => self.rng.random_range(0.4..1.5),
        };
        let [x0, y0, x1, y1] = self.visible;
        let Some(half) = shape.half_size() else {
            // A plate covers a side of the picture.
            let angle = self.rng.random_range(0.0..std::f64::consts::TAU);
            let away = 0.5 * f64::min(x1 - x0, y1 - y0) * self.rng.random_range(0.35..0.95);
            let center = [
                (x0 + x1) / 2.0 + away * f64::cos(angle),
                (y0 + y1) / 2.0 + away * f64::sin(angle),
            ];
            let yaw = angle + std::f64::consts::PI + self.rng.random_range(-0.4..0.4);
            let tilt = sample_tilt(self.rng, 0.8);
            let placed = Placed { part: shape, center_mm: center, yaw, tilt, depth_mm };
            if self.claim(footprint(&placed), &[]) {
                self.scene.distractors.push(placed);
            }
            return;
        };
        let walled = self.rng.random_bool(0.4);
        // One's own negatives stand in for any kind, with a wall as often as a hook's arm would have one.
        let walled = part == Part::Arm && self.forced.wall.unwrap_or(walled);
        let tilt = sample_tilt(self.rng, if walled { 1.0 } else { 3.0 });
        // A part's negative that is cut may look like the part that is cut.
        let cut = self.rng.random_bool(CUT) && pressed.is_none();
        for _ in 0..TRIES {
            let yaw = sample_yaw(self.rng);
            let center_mm = self.place(half, yaw, cut);
            let placed = Placed { part: shape.clone(), center_mm, yaw, tilt, depth_mm };
            let wall = if walled { self.wall(&placed, half, 0.0) } else { Vec::new() };
            if self.claim(footprint(&placed), &wall) {
                self.scene.distractors.push(placed);
                self.scene.distractors.extend(wall);
                return;
            }
        }
    }

    /// Adds a part that touches the last snap's side, end or outline.
    fn add_neighbour(&mut self, part: Option<Part>) {
        let Some(snap) = self.scene.snaps.last().cloned() else { return };
        let half = snap.part.half_size();
        for _ in 0..TRIES {
            let part = match part {
                Some(part) => part,
                None => *[Part::Block, Part::Block, Part::Rib, Part::Pin, Part::Screw]
                    .choose(self.rng)
                    .unwrap_or(&Part::Block),
            };
            let Some(shape) = Distractor::sample_wide(self.rng, part, self.forced) else { return };
            let Some(other) = shape.half_size() else { return };
            // Beside it, or before its tip.
            let gap = self.rng.random_range(-0.1..0.25);
            let side = if self.rng.random_bool(0.5) { 1.0 } else { -1.0 };
            let [u, v] = if self.rng.random_bool(0.6) {
                [self.rng.random_range(-0.8..0.8) * half[0], side * (half[1] + other[1] + gap)]
            } else {
                [half[0] + other[0] + gap, self.rng.random_range(-0.8..0.8) * half[1]]
            };
            let center = snap.pose().gel([u, v]).into();
            let beside = Footprint::of(center, other, snap.yaw);
            let free = self
                .taken
                .iter()
                .filter(|taken| taken.center != DVec2::from(snap.center_mm))
                .all(|taken| taken.gap(&beside) > CLEARANCE_MM);
            if free {
                self.taken.push(beside);
                let drop = self.rng.random_range(-0.6..0.3);
                self.scene.distractors.push(Placed {
                    part: shape,
                    center_mm: center,
                    yaw: snap.yaw,
                    tilt: snap.tilt,
                    depth_mm: (snap.depth_mm + drop + snap.tilt[0] * u + snap.tilt[1] * v).max(0.1),
                });
                return;
            }
        }
    }
}
