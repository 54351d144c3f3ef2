//! Winograd's F(4 × 4, 3 × 3), which several kernels compute: its constants and its error.

use std::array::from_fn;

use crate::engine::ops::bounds::SumOrder;
use crate::engine::tensor::Tensor;

/// Outputs on each side of a tile.
pub(crate) const OUT: usize = 4;
/// Inputs on each side of a tile, and points.
pub(crate) const IN: usize = 6;
/// Products a tile and channel.
pub(crate) const POINTS: usize = IN * IN;

const G: [[f64; 3]; IN] = [
    [1.0 / 4.0, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// Absolute values of Bᵀ, the input's transform.
const B: [[f64; IN]; IN] = [
    [4.0, 0.0, 5.0, 0.0, 1.0, 0.0],
    [0.0, 4.0, 4.0, 1.0, 1.0, 0.0],
    [0.0, 4.0, 4.0, 1.0, 1.0, 0.0],
    [0.0, 2.0, 1.0, 2.0, 1.0, 0.0],
    [0.0, 2.0, 1.0, 2.0, 1.0, 0.0],
    [0.0, 4.0, 0.0, 5.0, 0.0, 1.0],
];

/// Absolute values of Aᵀ, the output's transform.
const A: [[f64; IN]; OUT] = [
    [1.0, 1.0, 1.0, 1.0, 1.0, 0.0],
    [0.0, 1.0, 1.0, 2.0, 2.0, 0.0],
    [0.0, 1.0, 1.0, 4.0, 4.0, 0.0],
    [0.0, 1.0, 1.0, 8.0, 8.0, 1.0],
];

/// T m Tᵀ.
fn both_sides<const R: usize>(t: &[[f64; IN]; R], m: &[[f64; IN]; IN]) -> [[f64; R]; R] {
    let dot = |a: &[f64; IN], b: [f64; IN]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let half: [[f64; IN]; R] = from_fn(|r| from_fn(|x| dot(&t[r], from_fn(|y| m[y][x]))));
    from_fn(|r| from_fn(|c| dot(&t[c], half[r])))
}

/// G g Gᵀ of the nine taps of a kernel, at a point, in f64.
pub(crate) fn point_weight(taps: &[f32], point: usize) -> f32 {
    let (row, column) = (G[point / IN], G[point % IN]);
    let terms = (0..9).map(|t| row[t / 3] * column[t % 3] * f64::from(taps[t]));
    terms.sum::<f64>() as f32
}

/// How far each output may be from the definition's, `[O, H, W]`, for absolute values of the inputs
/// `[I, H, W]`, bias and residual. `weight` gives G g Gᵀ by point, input and output channel, `order` is
/// that of the sums over channels.
///
/// Each product passes the input's transform in two steps of at most 4 roundings, the rounding of its
/// weight, its own and those of the sum over channels, the output's transform in two steps of at most
/// 6, and the epilogue. So the error is at most γ of these times what the same algorithm gives for
/// absolute values of everything, constants too (Barabasz, Anderson, Soodhalter and Gregg, "Error
/// Analysis and Improving the Accuracy of Winograd Convolution for Deep Neural Networks", 2020, §4).
pub(crate) fn error_bound(
    input: &Tensor,
    out_c: usize,
    weight: impl Fn(usize, usize, usize) -> f32,
    bias: Option<&Tensor>,
    residual: Option<&Tensor>,
    order: SumOrder,
) -> Vec<f64> {
    let around = SumOrder { more: 2 * 4 + 1 + 2 * 6 + 2, ..order };
    let mut errors = magnitudes(input, out_c, weight, bias, residual);
    errors.iter_mut().for_each(|error| *error = around.error(*error));
    errors
}

/// What the algorithm gives for absolute values of everything, constants too.
pub(crate) fn magnitudes(
    input: &Tensor,
    out_c: usize,
    weight: impl Fn(usize, usize, usize) -> f32,
    bias: Option<&Tensor>,
    residual: Option<&Tensor>,
) -> Vec<f64> {
    // Padded by one, the output is as large as the input.
    let [in_c, height, width] = [0, 1, 2].map(|i| input.dims()[i]);
    let (tile_rows, tile_columns) = (height.div_ceil(OUT), width.div_ceil(OUT));
    let mut sums = vec![0.0; out_c * height * width];
    for tile in 0..tile_rows * tile_columns {
        let (top, left) = (tile / tile_columns * OUT, tile % tile_columns * OUT);
        let mut products = vec![0.0; POINTS * out_c];
        for i in 0..in_c {
            let mut d = [[0.0; IN]; IN];
            for (y, row) in d.iter_mut().enumerate() {
                for (x, d) in row.iter_mut().enumerate() {
                    let (y, x) = ((top + y).wrapping_sub(1), (left + x).wrapping_sub(1));
                    if y < height && x < width {
                        *d = f64::from(input.data()[(i * height + y) * width + x]);
                    }
                }
            }
            let points = both_sides(&B, &d);
            for (point, value) in points.as_flattened().iter().enumerate() {
                let sums = &mut products[point * out_c..][..out_c];
                for (o, sum) in sums.iter_mut().enumerate() {
                    *sum += value * f64::from(weight(point, i, o).abs());
                }
            }
        }
        for o in 0..out_c {
            let m = from_fn(|y| from_fn(|x| products[(y * IN + x) * out_c + o]));
            for (y, row) in both_sides(&A, &m).iter().enumerate() {
                for (x, sum) in row.iter().enumerate() {
                    if top + y < height && left + x < width {
                        let at = (o * height + top + y) * width + left + x;
                        let added = bias.map_or(0.0, |b| b.data()[o])
                            + residual.map_or(0.0, |r| r.data()[at]);
                        sums[at] = sum + f64::from(added);
                    }
                }
            }
        }
    }
    sums
}
