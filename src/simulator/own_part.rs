//! A user's own part as a class of snaps: a height field with a name, and what is easily taken for it.

use std::sync::Arc;

use rand::RngExt;
use rand_pcg::Pcg64;

use super::relief::{Relief, Symmetry};

/// Deepest press of one's own part, in millimetres.
pub const DEEPEST_MM: f64 = 1.6;
/// Shallowest press: less hardly shows.
const SHALLOWEST_MM: f64 = 0.25;
/// How much deeper most presses go than where half of the part touches, in millimetres.
const PAST_MM: [f64; 2] = [0.1, 0.8];
/// Share of the presses that are shallower.
const SHALLOW: f64 = 0.08;
/// Of wide pictures the share of faint presses, and their depths in millimetres.
const FAINT: f64 = 0.25;
const FAINT_MM: [f64; 2] = [0.3, 0.8];
/// Share of its length that the part without its tip lacks.
const TIP: f64 = 1.0 / 3.0;
/// How often that is drawn beside each other negative: it is the one that is hardest to tell from the part.
const CUT_WEIGHT: u32 = 8;
/// Slope of the most that a part is tilted by, which can keep one of its ends off the gel.
const TILT: f64 = 0.06;

/// A class of snaps that is a height field.
#[derive(Debug, PartialEq)]
pub struct OwnPart {
    /// Its name, the class's.
    pub name: String,
    /// Its shape, seen along the pressing direction.
    pub relief: Relief,
    /// After which turns it looks the same in the deepest press.
    pub symmetry: Symmetry,
    /// Depth at which a press touches half of what the deepest one does, in millimetres.
    half_contact_mm: f64,
}

/// A shape that is easily taken for a part.
#[derive(Debug, PartialEq)]
pub struct Derived {
    /// `block`, a plain one of the part's outline; `cut`, the part without the third that its zero points to,
    /// as one that has broken; or `mirror`, its mirror image.
    ///
    /// A part whose top is cut off flat is none of them: pressed less deep it touches the gel where the part does, and
    /// no more than the steps' heights tell them apart.
    pub what: &'static str,
    /// How often it is drawn beside 1 of others.
    pub weight: u32,
    /// Its shape, and the depth in millimetres from which presses tell it from the part, however both are tilted.
    /// `None` where the deepest one does not.
    pub shape: Option<(Relief, f64)>,
}

/// How a part's negative is pressed: as a whole, as deep as the part, but no less deep than what tells them apart.
#[derive(Debug, Clone, PartialEq)]
pub struct PressedLike {
    /// The part.
    pub part: Arc<OwnPart>,
    /// The least depth in millimetres.
    pub least_mm: f64,
}

impl PressedLike {
    /// Draws a depth in millimetres.
    pub fn sample_depth(&self, rng: &mut Pcg64) -> f64 {
        self.part.sample_depth(rng).max(self.least_mm)
    }

    /// Draws the depth of a wide picture's press.
    pub fn sample_wide_depth(&self, rng: &mut Pcg64) -> f64 {
        self.part.sample_wide_depth(rng).max(self.least_mm)
    }
}

impl OwnPart {
    /// A part of this shape, whose symmetry is found from it.
    pub fn new(name: String, relief: Relief) -> Arc<Self> {
        let symmetry = relief.symmetry(DEEPEST_MM);
        let half_contact_mm = relief.half_contact_mm(DEEPEST_MM);
        Arc::new(Self { name, relief, symmetry, half_contact_mm })
    }

    /// The direction that a label states of a yaw in degrees: none for a part that looks the same after some
    /// turn.
    ///
    /// It could be folded into that part of a turn. But a network says sine and cosine of a whole turn, and its loss
    /// takes two equal pictures with opposite directions for a contradiction; to fold, each class would have a
    /// number of turns in labels, weights, decoding, `eval` and what is done with a yaw. A gripper gains little: a
    /// part of two sides shows its line in its box.
    pub fn direction(&self, yaw_deg: f64) -> Option<f64> {
        (self.symmetry == Symmetry::None).then_some(yaw_deg)
    }

    /// Draws how deep the highest point goes into the gel, in millimetres: as of A and B, mostly so deep that the
    /// part's lower faces touch too, as far as presses go.
    pub fn sample_depth(&self, rng: &mut Pcg64) -> f64 {
        let [low, high] = PAST_MM.map(|past| (self.half_contact_mm + past).min(DEEPEST_MM));
        // Of a part whose faces are that far apart the deepest presses.
        let low = low.clamp(SHALLOWEST_MM, DEEPEST_MM - PAST_MM[1] / 2.0);
        match rng.random_bool(SHALLOW) && low > SHALLOWEST_MM {
            true => rng.random_range(SHALLOWEST_MM..low),
            false => rng.random_range(low..high),
        }
    }

    /// Draws the depth of a wide picture's press: a quarter are faint.
    pub fn sample_wide_depth(&self, rng: &mut Pcg64) -> f64 {
        match rng.random_bool(FAINT) {
            true => rng.random_range(FAINT_MM[0]..FAINT_MM[1]),
            false => self.sample_depth(rng),
        }
    }

    /// What is easily taken for the part.
    pub fn negatives(&self) -> [Derived; 3] {
        let relief = &self.relief;
        [
            ("block", 1, relief.block(DEEPEST_MM)),
            ("cut", CUT_WEIGHT, relief.without_tip(TIP)),
            ("mirror", 1, relief.mirrored()),
        ]
        .map(|(what, weight, other)| {
            let [x, y] = relief.half_size();
            let tilted = TILT * x.hypot(y);
            let shape = other
                .told_apart_mm(relief, DEEPEST_MM)
                .map(|apart| (other, (apart + tilted).min(DEEPEST_MM)));
            Derived { what, weight, shape }
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::mesh::{Mesh, Triangle, Unit};
    use super::super::relief::View;
    use super::*;

    /// A block of half this size with its upper side at this height.
    fn block([x, y]: [f32; 2], top: f32) -> Vec<Triangle> {
        let corner = |at: usize| {
            let side = |bit: usize, half: f32| if at >> bit & 1 == 1 { half } else { -half };
            [side(0, x), side(1, y), if at >> 2 & 1 == 1 { top } else { -3.0 }]
        };
        let faces =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let halves = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
        halves.map(|triangle| triangle.map(corner)).collect()
    }

    fn part(triangles: Vec<Triangle>) -> Arc<OwnPart> {
        let mesh = Mesh::new(triangles, Unit::Mm).expect("a mesh");
        OwnPart::new("part".to_owned(), Relief::of_mesh(&mesh, View::default()).expect("a part").0)
    }

    #[test]
    fn what_equals_the_part_is_no_negative() {
        // A plate far below two ridges; the one that the zero points to lies 0.4 mm below the other.
        let (mut high, mut low) = (block([0.5, 3.0], 0.0), block([0.5, 3.0], -0.4));
        high.iter_mut().flatten().for_each(|corner| corner[0] -= 3.0);
        low.iter_mut().flatten().for_each(|corner| corner[0] += 3.0);
        let ridges = part([block([4.0, 3.0], -2.0), high, low].concat());
        let negatives = ridges.negatives();
        let least = |what: &str| {
            let found = negatives.iter().find(|negative| negative.what == what);
            found.and_then(|negative| negative.shape.as_ref()).map(|(_, least_mm)| *least_mm)
        };
        // Where the lower ridge touches, and as much deeper as a slope of 0.06 lifts it: at 5 mm by 0.3.
        let cut = least("cut").expect("a negative");
        assert!((0.7..0.75).contains(&cut), "{cut}");
        // A block under both shows at once; a mirror image never.
        assert!(least("block").is_some_and(|least| (0.3..0.35).contains(&least)));
        assert_eq!(least("mirror"), None);
        let pressed = PressedLike { part: ridges.clone(), least_mm: cut };
        let rng = &mut Pcg64::seed_from_u64(1);
        let depths: Vec<f64> = (0..1000)
            .flat_map(|_| [pressed.sample_depth(rng), pressed.sample_wide_depth(rng)])
            .collect();
        assert!(depths.iter().all(|depth| (cut..=DEEPEST_MM).contains(depth)));
        assert!(depths.iter().any(|depth| *depth > cut + 0.2), "as deep as the part");
    }

    #[test]
    fn most_presses_touch_the_lower_faces_too() {
        // A plate of 8 × 6 mm, 0.6 mm below a ridge of 2 × 6 mm: three quarters of the part.
        let ridge = part([block([4.0, 3.0], 0.0), block([1.0, 3.0], 0.6)].concat());
        assert!((ridge.relief.half_contact_mm(DEEPEST_MM) - 0.6).abs() < 1e-6);
        // Nothing but the ridge is seen by a press of half a millimetre.
        assert_eq!(ridge.relief.half_contact_mm(0.5), 0.0);
        let flat = part(block([4.0, 3.0], 0.0));
        // The plate lies deeper than any press.
        let tower = part([block([4.0, 3.0], -2.0), block([1.0, 3.0], 0.6)].concat());
        let rng = &mut Pcg64::seed_from_u64(1);
        for (part, low, high) in [(&ridge, 0.7, 1.4), (&flat, 0.25, 0.8), (&tower, 0.25, 0.8)] {
            let depths: Vec<f64> = (0..1000).map(|_| part.sample_depth(rng)).collect();
            assert!(depths.iter().all(|depth| (SHALLOWEST_MM..high).contains(depth)));
            let shallow = depths.iter().filter(|depth| **depth < low).count();
            // Eight in a hundred, with a deviation of 0.9.
            let expected = if low > SHALLOWEST_MM { 45..115 } else { 0..1 };
            assert!(expected.contains(&shallow), "{shallow} below {low}");
            let faint = (0..1000).filter(|_| part.sample_wide_depth(rng) < 0.8).count();
            assert!(faint >= 200, "{faint}");
        }
    }
}
