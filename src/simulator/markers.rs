//! Dots printed on the gel, which move with it.

use glam::DVec2;
use rand::RngExt;
use rand_pcg::Pcg64;

use super::pose::Pose;

/// Widest jitter of a dot, as a share of the pitch: its neighbours' cells are searched.
const MOST_JITTER: f64 = 0.5;

/// A print of dots, given where the gel is at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Markers {
    /// Distance between dots in millimetres.
    pub pitch_mm: f64,
    /// Diameter or side of a dot in millimetres.
    pub size_mm: f64,
    /// Whether dots are squares.
    pub square: bool,
    /// Direction of the grid's rows, in radians.
    pub yaw: f64,
    /// Place of one of its nodes in millimetres.
    pub origin_mm: [f64; 2],
    /// How far a dot lies from its node at most, as a share of the pitch.
    pub jitter: f64,
    /// Share of nodes without a dot.
    pub missing: f64,
    /// Brightness of a dot over the gel's, for each channel.
    pub brightness: [f32; 3],
    /// Width of a dot's edge in millimetres.
    pub edge_mm: f64,
    /// Tells prints of the same measures apart.
    pub seed: u64,
}

impl Markers {
    /// Draws a print of this pitch.
    pub fn sample(rng: &mut Pcg64, pitch_mm: f64, mm_per_pixel: f64) -> Self {
        let most = (0.6 * pitch_mm).min(1.0);
        let dark = rng.random_bool(0.75);
        let level = if dark { rng.random_range(0.05..0.6) } else { rng.random_range(1.3..2.2) };
        let tint = if rng.random_bool(0.3) { 0.4 } else { 0.05 };
        Self {
            pitch_mm,
            size_mm: rng.random_range(0.3..most.max(0.35)),
            square: rng.random_bool(0.3),
            yaw: if rng.random_bool(0.5) {
                rng.random_range(-0.05..0.05)
            } else {
                rng.random_range(0.0..std::f64::consts::FRAC_PI_2)
            },
            origin_mm: [(); 2].map(|()| rng.random_range(0.0..pitch_mm)),
            jitter: match rng.random_range(0..10) {
                0..5 => rng.random_range(0.0..0.04),
                5..8 => rng.random_range(0.04..0.15),
                _ => MOST_JITTER,
            },
            missing: if rng.random_bool(0.25) { rng.random_range(0.0..0.15) } else { 0.0 },
            brightness: [(); 3]
                .map(|()| (level * (1.0 + tint * rng.random_range(-1.0..1.0))) as f32),
            edge_mm: (1.2 * mm_per_pixel).max(rng.random_range(0.02..0.08)),
            seed: rng.random_range(0..u64::MAX),
        }
    }

    /// How much of a point of the gel at rest is printed, 0 to 1.
    pub fn coverage(&self, x_mm: f64, y_mm: f64) -> f32 {
        let grid = Pose { origin_mm: self.origin_mm.into(), x: DVec2::from_angle(self.yaw) };
        let [u, v] = (grid.own(DVec2::new(x_mm, y_mm)) / self.pitch_mm).into();
        // Dots of which no part leaves the node's own cell are found there alone.
        let stays = self.jitter * self.pitch_mm + (self.size_mm + self.edge_mm) * 0.75;
        let near = i64::from(stays > 0.5 * self.pitch_mm);
        let (column, row) = (u.round() as i64, v.round() as i64);
        let mut most = 0.0f64;
        for j in row - near..=row + near {
            for i in column - near..=column + near {
                let [a, b, c] = self.deviates(i, j);
                if c < self.missing {
                    continue;
                }
                let du = (u - i as f64 - self.jitter * (2.0 * a - 1.0)) * self.pitch_mm;
                let dv = (v - j as f64 - self.jitter * (2.0 * b - 1.0)) * self.pitch_mm;
                let from = if self.square { du.abs().max(dv.abs()) } else { du.hypot(dv) };
                let inside = (0.5 * self.size_mm - from) / self.edge_mm + 0.5;
                most = most.max(inside);
            }
        }
        most.clamp(0.0, 1.0) as f32
    }

    /// Three numbers in 0 to 1 that belong to a node.
    fn deviates(&self, column: i64, row: i64) -> [f64; 3] {
        let mut state = self.seed ^ (column as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        state ^= (row as u64).wrapping_mul(0xd1b5_4a32_d192_ed03).rotate_left(32);
        [(); 3].map(|()| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        })
    }
}
