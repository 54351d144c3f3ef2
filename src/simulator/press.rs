//! One press as a camera sees it, frame by frame: a snap comes, presses, rests, slides and goes.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::appearance::Appearance;
use super::camera::Camera;
use super::scene::{Mix, Own, Placed, Scene, sample_tilt, sample_yaw};
use super::snaps::Snap;

/// Last frame of each phase and one: nothing yet, pressing, at rest, sliding, at rest, going; then nothing
/// any more.
const PHASES: [usize; 6] = [100, 160, 250, 330, 390, 430];
/// How far from the gel's centre a press begins at most along x and y, and how far it slides, in
/// millimetres: with both a snap stays on the gel.
const START_MM: f64 = 8.0;
const SLIDE_MM: [f64; 2] = [2.0, 5.0];
/// Share by which the light goes up and down at most, and by which it changes from the first frame to the
/// last.
const DRIFT: [f64; 2] = [0.02, 0.04];

/// A press on the paper's sensor.
#[derive(Debug, Clone)]
pub struct Press {
    /// At its deepest, where it begins.
    snap: Placed<Snap>,
    slide_mm: [f64; 2],
    look: Appearance,
    /// Of the light: how often it goes up and down in all frames, from where, and its change in all.
    waves: f64,
    phase: f64,
    change: f64,
}

impl Press {
    /// Frames of a press: 12 s at the 41 a second of the paper's camera.
    pub const FRAMES: usize = 500;

    /// Draws a press: of A, of B, or of any class.
    pub fn sample(seed: u64, mix: Mix, own: &Own) -> Self {
        let rng = &mut Pcg64::seed_from_u64(seed);
        let kind = mix.kind(rng, &own.classes);
        let part = Snap::sample(rng, &kind);
        let depth_mm = part.sample_depth(rng);
        let (tilt, yaw) = (sample_tilt(rng, 2.5), sample_yaw(rng));
        let center_mm = [(); 2].map(|()| rng.random_range(-START_MM..START_MM));
        let (distance, angle) =
            (rng.random_range(SLIDE_MM[0]..SLIDE_MM[1]), rng.random_range(0.0..TAU));
        let camera = Camera { blur_px: rng.random_range(0.6..2.2), ..Camera::default() };
        Self {
            snap: Placed { part, center_mm, yaw, tilt, depth_mm },
            slide_mm: [distance * f64::cos(angle), distance * f64::sin(angle)],
            look: Appearance::plain(rng, camera),
            waves: rng.random_range(0.5..3.0),
            phase: rng.random_range(0.0..TAU),
            change: rng.random_range(-DRIFT[1]..DRIFT[1]),
        }
    }

    /// What presses, and the sensor's look, in one of [`Press::FRAMES`] frames.
    pub fn at(&self, frame: usize) -> (Scene, Appearance) {
        let mut scene = Scene { snaps: Vec::new(), distractors: Vec::new() };
        let depth_mm = self.snap.depth_mm * pressed(frame);
        if depth_mm > 0.0 {
            let slid = share(frame, PHASES[2], PHASES[3]);
            let center_mm =
                [0, 1].map(|axis| self.snap.center_mm[axis] + slid * self.slide_mm[axis]);
            scene.snaps.push(Placed { depth_mm, center_mm, ..self.snap.clone() });
        }
        let time = frame as f64 / Self::FRAMES as f64;
        let light = 1.0
            + DRIFT[0] * f64::sin(TAU * self.waves * time + self.phase)
            + self.change * (time - 0.5);
        let exposure = self.look.exposure * light as f32;
        (scene, Appearance { exposure, ..self.look.clone() })
    }
}

/// How much of the way from one frame to another is behind, from 0 to 1.
fn share(frame: usize, from: usize, to: usize) -> f64 {
    (frame.saturating_sub(from) as f64 / (to - from) as f64).min(1.0)
}

/// Share of the deepest depth.
fn pressed(frame: usize) -> f64 {
    share(frame, PHASES[0], PHASES[1]) - share(frame, PHASES[4], PHASES[5])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_press_comes_slides_and_goes() {
        let press = Press::sample(1, Mix::A, &Own::default());
        let snap = |frame| press.at(frame).0.snaps.first().cloned();
        assert_eq!([0, 100, 430, 499].map(|frame| snap(frame).is_some()), [false; 4]);
        let [early, deep, rest] = [130, 160, 250].map(|frame| snap(frame).expect("a snap"));
        assert!((early.depth_mm - deep.depth_mm / 2.0).abs() < 1e-12);
        assert_eq!(deep, rest);
        let slid = snap(330).expect("a snap");
        let way = [0, 1].map(|axis| slid.center_mm[axis] - rest.center_mm[axis]);
        let distance = way[0].hypot(way[1]);
        assert!((SLIDE_MM[0]..SLIDE_MM[1]).contains(&distance), "{distance}");
        assert_eq!(snap(389), Some(slid));
        // Light drifts: no two frames have the same, none has left the range.
        let light = |frame| f64::from(press.at(frame).1.exposure / press.look.exposure);
        let most = DRIFT[0] + DRIFT[1] / 2.0 + 1e-6;
        assert!((0..Press::FRAMES).all(|frame| (light(frame) - 1.0).abs() <= most));
        assert!((1..Press::FRAMES).any(|frame| (light(frame) - light(0)).abs() > 0.005));
    }
}
