//! Winograd's minimal filtering F(4×4, 3×3): 36 products a tile of 16 outputs, where the definition
//! takes 144.
//!
//! With the points 0, ±1, ±2, ∞ (Lavin and Gray, "Fast Algorithms for Convolutional Neural
//! Networks", 2016, §4.3): output = Aᵀ [ (G g Gᵀ) ⊙ (Bᵀ d B) ] A, where the elementwise product
//! over all channels is 36 matrix products.

use std::sync::Arc;

use super::epilogue::{Epilogue, MapShape};
use super::gemm::{Inputs, Panels, order, vectorised};
use super::packs::Pack;
use super::scratch::Scratch;
use super::words::Numbers;
use crate::engine::cores::{each, each_with, threads};
use crate::engine::ops::Conv2d;
use crate::engine::ops::winograd::{IN, OUT, POINTS, error_bound, point_weight};
use crate::engine::tensor::Tensor;
use crate::error::Result;

/// Channels that are transformed together.
const LANES: usize = 16;
/// Pixels below which the transformed weights, four times as many, cost more than they save.
const LEAST_PIXELS: usize = 256;
/// Tiles that a thread transforms, multiplies and transforms back while they are in its cache.
const BLOCK: usize = 32;

type Lanes = [f32; LANES];

/// G g Gᵀ of each point and pair of channels.
fn transformed(shape: MapShape, weight: &Tensor) -> Vec<f32> {
    let MapShape { in_c, out_c, .. } = shape;
    let mut packed = vec![0.0; POINTS * in_c * out_c];
    each(packed.chunks_mut(in_c * out_c).enumerate(), |(point, packed)| {
        Panels::fill(packed, in_c, |o, i| {
            point_weight(&weight.data()[(o * in_c + i) * 9..][..9], point)
        });
    });
    packed
}

/// A convolution's weights, transformed.
#[derive(Debug)]
pub(super) struct Winograd {
    shape: MapShape,
    /// G g Gᵀ of each of the 36 points, in [`Panels`].
    weight: Arc<Vec<f32>>,
}

impl Winograd {
    /// Whether the algorithm computes this convolution, and pays.
    pub fn fits(op: &Conv2d, shape: &MapShape) -> bool {
        (shape.kh, shape.kw, op.stride, op.padding, op.dilation) == (3, 3, 1, 1, 1)
            && shape.in_c.is_multiple_of(LANES)
            && shape.out_c.is_multiple_of(LANES)
            && shape.pixels() >= LEAST_PIXELS
    }

    /// Transforms the weight `[O, I, 3, 3]`, in f64, where no plan has.
    ///
    /// # Errors
    /// As [`Pack::get`].
    pub fn new(shape: MapShape, pack: Pack) -> Result<Self> {
        let weight = pack.get("winograd", Numbers::F32, |weight| transformed(shape, weight))?;
        Ok(Self { shape, weight })
    }

    /// How far each output may be from the definition's, `[O, H, W]`, for absolute values of the
    /// inputs `[I, H, W]`.
    pub fn tolerance(
        &self,
        input: &Tensor,
        bias: Option<&Tensor>,
        residual: Option<&Tensor>,
    ) -> Vec<f64> {
        let MapShape { in_c, out_c, .. } = self.shape;
        let weight = |point, i, o| self.of_point(point).at(o, i);
        error_bound(input, out_c, weight, bias, residual, order(Numbers::F32, in_c, 0))
    }

    fn tiles(&self) -> (usize, usize) {
        (self.shape.out_h.div_ceil(OUT), self.shape.out_w.div_ceil(OUT))
    }

    /// `output [H, W, O]` from `input [H, W, I]`.
    pub fn run(
        &self,
        input: &[f32],
        residual: Option<&[f32]>,
        epilogue: &Epilogue,
        output: &mut [f32],
    ) {
        let MapShape { in_c, out_c, out_w, .. } = self.shape;
        let (tile_rows, tile_columns) = self.tiles();
        let tiles = tile_rows * tile_columns;
        // Threads share the tiles where each gets many, else the points, so that each reads its part
        // of the weights alone.
        if tiles >= 2 * BLOCK * threads() {
            // Whole rows of tiles, so that each block's outputs are a slice.
            let rows = (BLOCK / tile_columns).max(1);
            let block = rows * tile_columns;
            let scratch = || [in_c, out_c].map(|channels| Scratch::new(POINTS * block * channels));
            each_with(
                output.chunks_mut(rows * OUT * out_w * out_c).enumerate(),
                scratch,
                |[points, sums], (index, output)| {
                    let first = index * block;
                    let count = block.min(tiles - first);
                    let points = &mut points[..POINTS * count * in_c];
                    let sums = &mut sums[..POINTS * count * out_c];
                    for (t, tile) in (first..first + count).enumerate() {
                        vectorised(
                            #[inline(always)]
                            || self.transform_input(input, tile, t, count, points),
                        );
                    }
                    for (point, (sums, points)) in sums
                        .chunks_exact_mut(count * out_c)
                        .zip(points.chunks_exact(count * in_c))
                        .enumerate()
                    {
                        let points = Inputs::floats(points, in_c);
                        self.of_point(point).multiply(sums, &points, 0..count);
                    }
                    let above = index * rows * OUT * out_w * out_c;
                    let residual = residual.map(|r| &r[above..above + output.len()]);
                    vectorised(
                        #[inline(always)]
                        || {
                            self.transform_outputs(sums, count, residual, epilogue, output);
                        },
                    );
                },
            );
            return;
        }
        // [tiles][36, I], so that threads write slices of their own.
        let mut by_tile = Scratch::new(tiles * POINTS * in_c);
        each(by_tile.chunks_mut(POINTS * in_c).enumerate(), |(tile, points)| {
            vectorised(
                #[inline(always)]
                || self.transform_input(input, tile, 0, 1, points),
            );
        });
        let mut sums = Scratch::new(POINTS * tiles * out_c);
        each_with(
            sums.chunks_mut(tiles * out_c).enumerate(),
            || Scratch::new(tiles * in_c),
            |points, (point, sums)| {
                let from = by_tile.chunks_exact(POINTS * in_c);
                for (to, from) in points.chunks_exact_mut(in_c).zip(from) {
                    to.copy_from_slice(&from[point * in_c..][..in_c]);
                }
                self.of_point(point).multiply(sums, &Inputs::floats(points, in_c), 0..tiles);
            },
        );
        each(output.chunks_mut(OUT * out_w * out_c).enumerate(), |(row, output)| {
            let above = row * OUT * out_w * out_c;
            let residual = residual.map(|r| &r[above..above + output.len()]);
            vectorised(
                #[inline(always)]
                || {
                    let first = row * tile_columns;
                    self.transform_row(&sums, first, tiles, residual, epilogue, output);
                },
            );
        });
    }

    fn of_point(&self, point: usize) -> Panels<'_> {
        let MapShape { in_c, out_c, .. } = self.shape;
        let weight = &self.weight[point * in_c * out_c..][..in_c * out_c];
        Panels::of(weight, (out_c, in_c), Numbers::F32)
    }

    /// Bᵀ d B of `tile`, written as tile `to` of `count` in `points` `[36, count, I]`.
    #[inline(always)]
    fn transform_input(
        &self,
        input: &[f32],
        tile: usize,
        to: usize,
        count: usize,
        points: &mut [f32],
    ) {
        let MapShape { in_c, in_h, in_w, .. } = self.shape;
        let columns = self.tiles().1;
        let (top, left) = (tile / columns * OUT, tile % columns * OUT);
        for c in (0..in_c).step_by(LANES) {
            // One row and column of zeros on each side; wraps below zero.
            let mut columns = [[[0.0; LANES]; IN]; IN];
            for (x, column) in columns.iter_mut().enumerate() {
                for (y, lanes) in column.iter_mut().enumerate() {
                    let (y, x) = ((top + y).wrapping_sub(1), (left + x).wrapping_sub(1));
                    if y < in_h && x < in_w {
                        lanes.copy_from_slice(&input[(y * in_w + x) * in_c + c..][..LANES]);
                    }
                }
                *column = input_transform(column);
            }
            for y in 0..IN {
                let row = row_of(&columns, y);
                for (x, value) in input_transform(&row).iter().enumerate() {
                    let at = ((y * IN + x) * count + to) * in_c + c;
                    points[at..at + LANES].copy_from_slice(value);
                }
            }
        }
    }

    /// Aᵀ m A of whole rows of tiles from the first, and the epilogue.
    #[inline(always)]
    fn transform_outputs(
        &self,
        sums: &[f32],
        count: usize,
        residual: Option<&[f32]>,
        epilogue: &Epilogue,
        output: &mut [f32],
    ) {
        let MapShape { out_c, out_w, .. } = self.shape;
        let columns = self.tiles().1;
        let row = OUT * out_w * out_c;
        for (i, output) in output.chunks_mut(row).enumerate() {
            let residual = residual.map(|r| &r[i * row..][..output.len()]);
            self.transform_row(sums, i * columns, count, residual, epilogue, output);
        }
    }

    /// Aᵀ m A of one row of tiles, which is `first` and on of `count` in `sums` `[36, count, O]`.
    #[inline(always)]
    fn transform_row(
        &self,
        sums: &[f32],
        first: usize,
        count: usize,
        residual: Option<&[f32]>,
        epilogue: &Epilogue,
        output: &mut [f32],
    ) {
        let MapShape { out_c, out_w, .. } = self.shape;
        let rows = output.len() / (out_w * out_c);
        for column in 0..self.tiles().1 {
            for o in (0..out_c).step_by(LANES) {
                let mut columns = [[[0.0; LANES]; OUT]; IN];
                for (x, to) in columns.iter_mut().enumerate() {
                    let mut points = [[0.0; LANES]; IN];
                    for (y, lanes) in points.iter_mut().enumerate() {
                        let at = ((y * IN + x) * count + first + column) * out_c + o;
                        lanes.copy_from_slice(&sums[at..at + LANES]);
                    }
                    *to = output_transform(&points);
                }
                for y in 0..rows.min(OUT) {
                    let row = row_of(&columns, y);
                    let values = output_transform(&row);
                    for (x, value) in values.iter().enumerate().take(out_w - column * OUT) {
                        let at = (y * out_w + column * OUT + x) * out_c + o;
                        let residual = residual.map(|r| &r[at..at + LANES]);
                        epilogue.apply(&mut output[at..at + LANES], value, o, residual);
                    }
                }
            }
        }
    }
}

/// A row of a tile that is given by columns. (A loop: closures that `from_fn` calls may stay functions of
/// their own, which have no wide registers.)
#[inline(always)]
fn row_of<const R: usize, const C: usize>(columns: &[[Lanes; R]; C], y: usize) -> [Lanes; C] {
    let mut row = [[0.0; LANES]; C];
    for (lanes, column) in row.iter_mut().zip(columns) {
        *lanes = column[y];
    }
    row
}

/// Bᵀ d.
#[inline(always)]
fn input_transform(d: &[Lanes; IN]) -> [Lanes; IN] {
    let mut t = [[0.0; LANES]; IN];
    for l in 0..LANES {
        let [d0, d1, d2, d3, d4, d5] = [d[0][l], d[1][l], d[2][l], d[3][l], d[4][l], d[5][l]];
        let (even, odd) = (d4 - 4.0 * d2, d3 - 4.0 * d1);
        let (near, far) = (d4 - d2, 2.0 * (d3 - d1));
        t[0][l] = 4.0 * d0 - 5.0 * d2 + d4;
        t[1][l] = even + odd;
        t[2][l] = even - odd;
        t[3][l] = near + far;
        t[4][l] = near - far;
        t[5][l] = 4.0 * d1 - 5.0 * d3 + d5;
    }
    t
}

/// Aᵀ m.
#[inline(always)]
fn output_transform(m: &[Lanes; IN]) -> [Lanes; OUT] {
    let mut t = [[0.0; LANES]; OUT];
    for l in 0..LANES {
        let (sum1, difference1) = (m[1][l] + m[2][l], m[1][l] - m[2][l]);
        let (sum2, difference2) = (m[3][l] + m[4][l], m[3][l] - m[4][l]);
        t[0][l] = m[0][l] + sum1 + sum2;
        t[1][l] = difference1 + 2.0 * difference2;
        t[2][l] = sum1 + 4.0 * sum2;
        t[3][l] = difference1 + 8.0 * difference2 + m[5][l];
    }
    t
}
