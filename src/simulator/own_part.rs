//! A user's own part as a class of snaps: a height field with a name, and what is easily taken for it.

use std::sync::Arc;

use rand::RngExt;
use rand_pcg::Pcg64;

use super::relief::{Relief, Symmetry};

/// Deepest press of one's own part, in millimetres.
pub const DEEPEST_MM: f64 = 1.6;
/// Shallowest press: less hardly shows.
const SHALLOWEST_MM: f64 = 0.25;
/// How much deeper a press goes than the part's lower faces, in millimetres.
const PAST_MM: f64 = 0.8;
/// Share of the seen height that the part without its top lacks.
const TOP: f64 = 1.0 / 3.0;

/// A class of snaps that is a height field.
#[derive(Debug, PartialEq)]
pub struct OwnPart {
    /// Its name, the class's.
    pub name: String,
    /// Its shape, seen along the pressing direction.
    pub relief: Relief,
    /// After which turns it looks the same in the deepest press.
    pub symmetry: Symmetry,
}

impl OwnPart {
    /// A part of this shape, whose symmetry is found from it.
    pub fn new(name: String, relief: Relief) -> Arc<Self> {
        let symmetry = relief.symmetry(DEEPEST_MM);
        Arc::new(Self { name, relief, symmetry })
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

    /// Draws how deep the highest point goes into the gel, in millimetres: from what hardly shows to past the
    /// part's lower faces, as far as presses go.
    pub fn sample_depth(&self, rng: &mut Pcg64) -> f64 {
        let most = (self.relief.depth_mm(DEEPEST_MM) + PAST_MM).min(DEEPEST_MM);
        rng.random_range(SHALLOWEST_MM..most)
    }

    /// What is easily taken for the part, by name: `block`, a plain one of its outline, `cut`, the part without
    /// its top third, and `mirror`, its mirror image. `None` in place of a shape that looks like the part itself, in the
    /// deepest press.
    pub fn negatives(&self) -> [(&'static str, Option<Relief>); 3] {
        let relief = &self.relief;
        [
            ("block", relief.block(DEEPEST_MM)),
            ("cut", relief.without_top(TOP, DEEPEST_MM)),
            ("mirror", relief.mirrored()),
        ]
        .map(|(what, other)| {
            (what, Some(other).filter(|other| !other.looks_like(relief, DEEPEST_MM)))
        })
    }
}
