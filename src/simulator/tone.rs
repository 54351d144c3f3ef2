//! What the depth of the gel and the rims of contacts do to its brightness, whatever the slope does.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::gel::Grid;
use super::smooth;
use super::surface::Surface;

/// Gel over a dark coating, as grey gels have it (DTact, Lin et al. 2023): the deeper it is pressed, the less light
/// comes back. And a rim, brighter or darker, where the gel turns up from what presses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tone {
    /// Share of the light that is lost where gel is pressed far deeper than `reach_mm`.
    share: f32,
    /// Depth at which 63 % of that is lost.
    reach_mm: f32,
    /// Standard deviation, in millimetres, over which light scatters in the gel.
    scatter_mm: f64,
    /// Change of brightness at a rim, as a share.
    rim: f32,
}

/// Least depth that counts: gel that stands out further is no brighter.
const OUTERMOST_MM: f32 = -0.3;
/// Width of a rim in millimetres.
const RIM_MM: f64 = 0.25;

impl Tone {
    /// Draws one that loses this share of the light to depth, and changes it by `rim` at rims.
    pub fn sample(rng: &mut Pcg64, share: f64, rim: f64) -> Self {
        Self {
            share: share as f32,
            reach_mm: rng.random_range(0.3..2.0),
            scatter_mm: rng.random_range(0.05..0.4),
            rim: rim as f32,
        }
    }

    /// The factor on the brightness at points of a surface, in millimetres.
    pub fn on(self, surface: &Surface) -> impl Fn(f64, f64) -> f32 {
        let grid = surface.grid();
        let mut depths = surface.depths();
        let rims = Surface::new(grid, rims(grid, &depths));
        smooth::blur(grid.cells, &mut depths, self.scatter_mm / grid.spacing_mm);
        let depths = Surface::new(grid, depths);
        move |x, y| self.at_depth(depths.at(x, y).depth) * (1.0 + self.rim * rims.at(x, y).depth)
    }

    fn at_depth(self, depth_mm: f32) -> f32 {
        1.0 - self.share * (1.0 - (-depth_mm.max(OUTERMOST_MM) / self.reach_mm).exp())
    }
}

/// How far the gel turns up at each cell, 0 to 1: 1 where its slope changes by 1 or more within [`RIM_MM`].
fn rims(grid: Grid, depths: &[f32]) -> Vec<f32> {
    let n = grid.cells;
    let scale = (RIM_MM / (grid.spacing_mm * grid.spacing_mm)) as f32;
    let at = |x: usize, y: usize| depths[y.min(n - 1) * n + x.min(n - 1)];
    let bend = |i: usize| {
        let (x, y) = (i % n, i / n);
        let across = at(x + 1, y) + at(x.saturating_sub(1), y);
        let along = at(x, y + 1) + at(x, y.saturating_sub(1));
        (scale * (across + along - 4.0 * at(x, y))).clamp(0.0, 1.0)
    };
    (0..n * n).map(bend).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { cells: 64, spacing_mm: 0.25 };

    fn surface(depth: impl Fn(f64) -> f64) -> Surface {
        let depths = (0..GRID.len()).map(|i| depth(GRID.position(i % GRID.cells)) as f32);
        Surface::new(GRID, depths.collect())
    }

    /// At the reach's depth 63 % of the share are lost, on flat gel nothing.
    #[test]
    fn deep_gel_is_dark() {
        let tone = Tone { share: 0.5, reach_mm: 1.0, scatter_mm: 0.0, rim: 0.0 };
        let lost = |depth: f64| 1.0 - tone.on(&surface(|_| depth))(0.0, 0.0);
        assert_eq!(lost(0.0), 0.0);
        assert!((lost(1.0) - 0.5 * (1.0 - (-1f32).exp())).abs() < 1e-6);
        // 0.3 mm count of what stands out.
        assert_eq!(lost(-2.0), lost(-0.3));
        assert!(lost(-0.3) < 0.0);
    }

    /// A trough whose side rises by 0.5 mm a mm ends at x = 2.125, halfway between cells: the gel turns up at its
    /// foot from 0.5 to 0 over half a millimetre, a quarter of that within each of two cells; at its
    /// other end, where it turns down, nothing.
    #[test]
    fn rims_are_where_the_gel_turns_up() {
        let tone = Tone { share: 0.0, reach_mm: 1.0, scatter_mm: 0.0, rim: 0.4 };
        let trough = surface(|x| (0.5 * (2.125 - x)).clamp(0.0, 1.0));
        let change = |cell: usize| tone.on(&trough)(GRID.position(cell), 0.0) - 1.0;
        let cell = |x: f64| GRID.index(x).round() as usize;
        let (foot, brow) = (cell(2.125), cell(0.125));
        assert!(change(foot) > 0.05, "{}", change(foot));
        assert_eq!(change(brow - 3), 0.0);
        assert!((brow - 1..=brow + 1).all(|at| change(at) <= 0.0));
    }
}
