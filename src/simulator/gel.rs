//! The gel: an incompressible elastic layer bonded to the acrylic plate, solved in Fourier space.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::num_traits::Zero;
use rustfft::{Fft, FftPlanner};

/// An incompressible elastic layer whose back is bonded to a rigid plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer {
    /// Thickness H in millimetres.
    pub thickness_mm: f64,
    /// Shear modulus μ in megapascals (newtons per square millimetre).
    pub shear_modulus_mpa: f64,
}

impl Default for Layer {
    /// The sensor's gel: 4 mm thick, μ = 0.145 MPa.
    fn default() -> Self {
        Self { thickness_mm: 4.0, shear_modulus_mpa: 0.145 }
    }
}

impl Layer {
    /// Normal displacement of the free surface, in millimetres per megapascal, under a pressure
    /// wave of angular wavenumber `k` in radians per millimetre.
    ///
    /// `(sinh 2x − 2x) / (cosh 2x + 1 + 2x²) / (2 μ k)` with `x = k H`: the plane-strain solution
    /// for an incompressible layer without slip at its back (K. L. Johnson, *Contact Mechanics*,
    /// §5.8, with ν = ½). It tends to the half-space's `1/(2μk)` for large `x` and to
    /// lubrication's `k² H³/(3μ)` for small `x`; at `k = 0` it is zero, so volume is conserved.
    pub fn compliance(&self, k: f64) -> f64 {
        let h = self.thickness_mm;
        let mu = self.shear_modulus_mpa;
        let x = k.abs() * h;
        if x < 0.02 {
            // The numerator cancels: sinh 2x − 2x = (2x)³/6 + (2x)⁵/120 + …
            let numerator = x.powi(3) * (8.0 / 6.0 + x * x * 32.0 / 120.0);
            let denominator = 2.0 + 4.0 * x * x;
            return if x == 0.0 { 0.0 } else { numerator / denominator * h / (2.0 * mu * x) };
        }
        // Numerator and denominator times 2 exp(−2x), which cannot overflow.
        let e = (-2.0 * x).exp();
        let numerator = 1.0 - e * e - 4.0 * x * e;
        let denominator = 1.0 + e * e + (2.0 + 4.0 * x * x) * e;
        numerator / denominator * h / (2.0 * mu * x)
    }
}

impl Layer {
    /// What maps a wave of normal displacement `w` of the free surface to the potential `q` of its
    /// tangential displacement, `u = −∇q`: q over w, in millimetres.
    ///
    /// `2 x² / (sinh 2x − 2x) / k` with `x = k H`: the tangential half of the solution that
    /// [`compliance`](Self::compliance) is the normal half of, whose amplitude u is
    /// `2 x² / (sinh 2x − 2x)` of w. It tends to lubrication's `3 / (2 x k)` for small `x`, and to 0
    /// for large `x`: an incompressible half-space does not move sideways under pressure.
    pub fn sideways(&self, k: f64) -> f64 {
        let x = k.abs() * self.thickness_mm;
        if x == 0.0 {
            return 0.0;
        }
        let numerator = if x < 0.02 {
            // sinh 2x − 2x = (2x)³/6 + (2x)⁵/120 + …
            1.0 / (x * (8.0 / 12.0 + x * x * 32.0 / 240.0))
        } else {
            // Times 2 exp(−2x) above and below, which cannot overflow.
            let e = (-2.0 * x).exp();
            4.0 * x * x * e / (1.0 - e * e - 4.0 * x * e)
        };
        numerator / k.abs()
    }
}

/// A square periodic grid of cells with the origin of its coordinates at the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Cells along a side.
    pub cells: usize,
    /// Side of a cell in millimetres.
    pub spacing_mm: f64,
}

impl Grid {
    /// Millimetres from the grid's centre to the centre of the cell with this index, along an axis.
    pub fn position(&self, index: usize) -> f64 {
        (index as f64 + 0.5 - self.cells as f64 / 2.0) * self.spacing_mm
    }

    /// Real-valued index of a position in millimetres: cell centres lie on whole numbers.
    pub fn index(&self, position_mm: f64) -> f64 {
        position_mm / self.spacing_mm + self.cells as f64 / 2.0 - 0.5
    }

    /// Number of cells of the whole grid.
    pub fn len(&self) -> usize {
        self.cells * self.cells
    }

    /// Whether the grid has no cell.
    pub fn is_empty(&self) -> bool {
        self.cells == 0
    }
}

/// Columns that one pass transforms together, so that whole cache lines are moved.
const COLUMN_BLOCK: usize = 8;

/// Maps pressures to displacements on a [`Grid`]. Plans and buffers are kept between calls.
pub struct Elasticity {
    grid: Grid,
    /// Response over wavenumber, `[cells/2 + 1 (kx)][cells (ky)]`, with the transforms' 1/n².
    kernel: Vec<f32>,
    row_forward: Arc<dyn RealToComplex<f32>>,
    row_inverse: Arc<dyn ComplexToReal<f32>>,
    column_forward: Arc<dyn Fft<f32>>,
    column_inverse: Arc<dyn Fft<f32>>,
    spectrum: Vec<Complex<f32>>,
    columns: Vec<Complex<f32>>,
    real: Vec<f32>,
    scratch: Vec<Complex<f32>>,
}

impl Elasticity {
    /// Plans the transforms of `grid` and tabulates the compliance of `layer` on it.
    pub fn new(layer: &Layer, grid: Grid) -> Self {
        Self::with_response(grid, |k| layer.compliance(k))
    }

    /// Plans a map from normal displacements in millimetres to the potential of the tangential
    /// ones, [`Layer::sideways`].
    pub fn sideways(layer: &Layer, grid: Grid) -> Self {
        Self::with_response(grid, |k| layer.sideways(k))
    }

    fn with_response(grid: Grid, response: impl Fn(f64) -> f64) -> Self {
        let n = grid.cells;
        let half = n / 2 + 1;
        let mut real_planner = RealFftPlanner::<f32>::new();
        let mut planner = FftPlanner::<f32>::new();
        let row_forward = real_planner.plan_fft_forward(n);
        let row_inverse = real_planner.plan_fft_inverse(n);
        let column_forward = planner.plan_fft_forward(n);
        let column_inverse = planner.plan_fft_inverse(n);

        let step = std::f64::consts::TAU / (n as f64 * grid.spacing_mm);
        let normalisation = 1.0 / grid.len() as f64;
        let mut kernel = Vec::with_capacity(half * n);
        for kx in 0..half {
            for ky in 0..n {
                let ky = ky.min(n - ky);
                let k = step * (kx as f64).hypot(ky as f64);
                kernel.push((response(k) * normalisation) as f32);
            }
        }
        let scratch = [
            row_forward.get_scratch_len(),
            row_inverse.get_scratch_len(),
            column_forward.get_inplace_scratch_len(),
            column_inverse.get_inplace_scratch_len(),
        ]
        .into_iter()
        .max()
        .unwrap_or(0);
        Self {
            grid,
            kernel,
            row_forward,
            row_inverse,
            column_forward,
            column_inverse,
            spectrum: vec![Complex::zero(); n * half],
            columns: vec![Complex::zero(); n * COLUMN_BLOCK],
            real: vec![0.0; n],
            scratch: vec![Complex::zero(); scratch],
        }
    }

    /// The grid that pressures and displacements lie on.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Writes to `displacement` the displacement in millimetres under `pressure` in megapascals,
    /// both `[cells][cells]` row by row.
    ///
    /// Only the rows marked in `loaded` may hold pressure, and only the rows marked in `wanted`
    /// are written: rows left out cost no transform.
    ///
    /// # Panics
    /// If a slice is not as long as the grid (`loaded`, `wanted`: one entry a row).
    pub fn displacement(
        &mut self,
        pressure: &[f32],
        loaded: &[bool],
        wanted: &[bool],
        displacement: &mut [f32],
    ) {
        let n = self.grid.cells;
        let half = n / 2 + 1;
        assert!(pressure.len() == n * n && displacement.len() == n * n);
        assert!(loaded.len() == n && wanted.len() == n);

        for (y, spectrum) in self.spectrum.chunks_exact_mut(half).enumerate() {
            if loaded[y] {
                self.real.copy_from_slice(&pressure[y * n..(y + 1) * n]);
                self.row_forward
                    .process_with_scratch(&mut self.real, spectrum, &mut self.scratch)
                    .expect("buffers were made for this plan");
            }
        }
        for x0 in (0..half).step_by(COLUMN_BLOCK) {
            let width = COLUMN_BLOCK.min(half - x0);
            for (y, &loaded) in loaded.iter().enumerate() {
                let row = &self.spectrum[y * half + x0..][..width];
                for (i, &value) in row.iter().enumerate() {
                    self.columns[i * n + y] = if loaded { value } else { Complex::zero() };
                }
            }
            for i in 0..width {
                let column = &mut self.columns[i * n..(i + 1) * n];
                self.column_forward.process_with_scratch(column, &mut self.scratch);
                let kernel = &self.kernel[(x0 + i) * n..(x0 + i + 1) * n];
                for (value, &k) in column.iter_mut().zip(kernel) {
                    *value *= k;
                }
                self.column_inverse.process_with_scratch(column, &mut self.scratch);
            }
            for (y, _) in wanted.iter().enumerate().filter(|(_, wanted)| **wanted) {
                let row = &mut self.spectrum[y * half + x0..][..width];
                for (i, value) in row.iter_mut().enumerate() {
                    *value = self.columns[i * n + y];
                }
            }
        }
        for (y, spectrum) in self.spectrum.chunks_exact_mut(half).enumerate() {
            if wanted[y] {
                // A real signal has real values here; rounding leaves a trace that realfft refuses.
                spectrum[0].im = 0.0;
                if n.is_multiple_of(2) {
                    spectrum[half - 1].im = 0.0;
                }
                self.row_inverse
                    .process_with_scratch(
                        spectrum,
                        &mut displacement[y * n..(y + 1) * n],
                        &mut self.scratch,
                    )
                    .expect("buffers were made for this plan");
            }
        }
    }
}
