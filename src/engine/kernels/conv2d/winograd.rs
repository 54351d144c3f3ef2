//! By Winograd's F(4 × 4, 3 × 3), in three passes: a quarter of the products.

use std::borrow::Cow;

use super::direct::Products;
use super::{Sizes, padded_bias, weights_known};
use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Quads, Recording, Work, all_texels,
    texels,
};
use crate::engine::ops::bounds::{magnitude, moved_sum};
use crate::engine::ops::winograd::{OUT, POINTS, error_bound, magnitudes, point_weight};
use crate::engine::ops::{Conv2d, Op, Tolerance};
use crate::engine::precision::{Precision, weight_error, weight_powers};
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

mod input {
    use super::{Quads, Shader, shader_params};

    shader_params! {
        struct Params {
            input: Quads,
            /// Channels of point after point; a tile is a pixel.
            points: Quads,
            tile_columns: u32,
        }
    }

    pub static SHADER: Shader = Shader {
        stem: "conv2d/winograd_input",
        source: include_str!("../../../../wgsl/conv2d/winograd_input.wgsl"),
        params: PARAMS,
    };

    pub fn params(input: Quads, points: Quads, tile_columns: u32) -> impl bytemuck::NoUninit {
        Params { input, points, tile_columns }
    }
}

mod output {
    use super::{Conv2d, Quads, Shader, shader_params};

    shader_params! {
        struct Params {
            /// Channels of point after point; a tile is a pixel.
            points: Quads,
            output: Quads,
            tile_columns: u32,
            has_residual: u32,
            relu: u32,
        }
    }

    pub static SHADER: Shader = Shader {
        stem: "conv2d/winograd_output",
        source: include_str!("../../../../wgsl/conv2d/winograd_output.wgsl"),
        params: PARAMS,
    };

    pub fn params(
        op: &Conv2d,
        points: Quads,
        output: Quads,
        tile_columns: u32,
    ) -> impl bytemuck::NoUninit {
        let [has_residual, relu] = [op.residual, op.relu].map(u32::from);
        Params { points, output, tile_columns, has_residual, relu }
    }
}

/// Invocations of a workgroup of the first and the last pass, each with a tile.
const WORKGROUP: usize = 16;
/// Where it pays: fewest channels in and out, and fewest tiles.
const LEAST_CHANNELS: usize = 128;
const LEAST_TILES: usize = 20;

/// Transformed tiles, and a product for each of their points.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Winograd;

/// A convolution cut into tiles.
#[derive(Clone, Copy, Debug)]
struct Plan {
    sizes: Sizes,
    tile_columns: usize,
    tiles: usize,
    products: Products,
}

impl Plan {
    fn of(work: &Work) -> Option<Self> {
        let op: &Conv2d = work.op().ok()?;
        let sizes = Sizes::of(op, work);
        let Sizes { in_c, out_c, kh, kw, out_h, out_w } = sizes;
        let tile_columns = out_w.div_ceil(OUT);
        let tiles = out_h.div_ceil(OUT) * tile_columns;
        let same = [kh, kw, op.stride, op.padding, op.dilation] == [3, 3, 1, 1, 1];
        let fits = same
            && weights_known(op, work.known)
            && work.has_quads(&work.inputs[0])
            && work.has_quads(&work.outputs[0])
            && tiles.div_ceil(WORKGROUP) <= MAX_WORKGROUPS as usize;
        let products = Products::of(POINTS, [in_c, out_c], tiles, work)?;
        fits.then_some(Self { sizes, tile_columns, tiles, products })
    }
}

impl Kernel for Winograd {
    fn id(&self) -> &'static str {
        "conv2d/winograd"
    }

    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        // Its products are dispatches of `conv2d/direct`.
        let first = all_texels(&caps.input_variant()).map(|variant| (&input::SHADER, variant));
        let last = all_texels(&Variant::default()).map(|variant| (&output::SHADER, variant));
        first.into_iter().chain(last).collect()
    }

    fn fits(&self, work: &Work) -> bool {
        Plan::of(work).is_some()
    }

    fn preferred(&self, work: &Work) -> bool {
        // Its weights are four times as many. Where they lie in the host's memory and the host makes
        // them before its first picture, that is for `tune` to choose.
        work.caps.has_many_cores()
            && Plan::of(work).is_some_and(|plan| {
                let Sizes { in_c, out_c, .. } = plan.sizes;
                in_c.min(out_c) >= LEAST_CHANNELS && plan.tiles >= LEAST_TILES
            })
    }

    fn reads(&self, work: &Work, index: usize) -> Layout {
        match (index, work.inputs[index].shape.rank()) {
            (0, _) => work.caps.input_layout(),
            // The residual; weights are repacked.
            (_, 3) => Layout::Quads,
            _ => Layout::Planar,
        }
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &Conv2d = work.op()?;
        let none = || Error::tensor(op.name(), "weight", "one that fits a texture", "a larger one");
        let plan = Plan::of(work).ok_or_else(none)?;
        let Sizes { in_c, out_c, .. } = plan.sizes;
        let (&input, &weight, bias, residual) = op.split(inputs);
        let name = recording.info(weight).name.clone();
        let weight = recording.weights(op.name(), weight)?;
        let bias = padded_bias(op, recording, bias, out_c, 4)?;
        let bias = recording.constant(format!("{name} (bias)"), bias);

        // Points are up to a hundred times the inputs, of whose digits they must keep more than f16 has.
        let single = Precision::F32;
        let before = TensorSpec::f32([POINTS * in_c, 1, plan.tiles]);
        let after = TensorSpec::f32([POINTS * out_c, 1, plan.tiles]);
        let written = recording.map("points", before.clone(), Layout::Quads, single)?;
        let sums = recording.map("points (sums)", after, Layout::Quads, single)?;
        let across = plan.tiles.div_ceil(WORKGROUP) as u32;
        let columns = plan.tile_columns as u32;
        let batch = recording.batch();

        let from = recording.quads(input)?;
        let params = input::params(from, recording.quads(written)?, columns);
        let bindings = [("input", input), ("points", written)];
        let grid = Grid::Workgroups([across, from.quads, batch]);
        let dispatch = Dispatch::new(&input::SHADER, "main", &params, &bindings, grid)
            .variant(work.caps.input_variant());
        recording.dispatch_maps(dispatch, input, written);
        let read = match work.caps.input_layout() {
            Layout::Texture => {
                let texture = recording.map("points", before, Layout::Texture, single)?;
                recording.copy(written, texture);
                texture
            }
            _ => written,
        };

        let weight = (&weight, work.precision);
        plan.products.record(recording, &name, read, weight, transform_weight, sums)?;

        let to = recording.quads(outputs[0])?;
        let params = output::params(op, recording.quads(sums)?, to, columns);
        // Any readable buffer serves where there is no residual: it is not read.
        let residual = residual.copied().unwrap_or(bias);
        let bindings =
            [("points", sums), ("bias", bias), ("residual", residual), ("output", outputs[0])];
        let grid = Grid::Workgroups([across, to.quads, batch]);
        let dispatch = Dispatch::new(&output::SHADER, "main", &params, &bindings, grid);
        let written = recording.info(outputs[0]).precision;
        let variant = texels(Variant::default(), work.precision, written);
        recording.dispatch(dispatch.variant(variant));
        Ok(())
    }

    fn tolerance(
        &self,
        op: &dyn Op,
        inputs: &[&Value],
        _reference: &[Value],
        precision: Precision,
    ) -> Result<Option<Vec<Tolerance>>> {
        let any: &dyn std::any::Any = op;
        let Some(op) = any.downcast_ref::<Conv2d>() else { return Ok(None) };
        let (input, weight, bias, residual) = op.split(inputs);
        let weight = weight.f32()?;
        let [out_c, in_c] = [0, 1].map(|i| weight.dims()[i]);
        let bias = bias.map(|v| magnitude(v)).transpose()?;
        let residual = residual.map(|v| magnitude(v)).transpose()?;
        // By input channel first, as the bound reads them.
        let points: Vec<f32> = (0..POINTS * in_c * out_c)
            .map(|at| {
                let (point, i, o) = (at / (in_c * out_c), at / out_c % in_c, at % out_c);
                point_weight(&weight.data()[(o * in_c + i) * 9..][..9], point)
            })
            .collect();
        let at = |point: usize, i: usize, o: usize| points[(point * in_c + i) * out_c + o];
        let (input, order) = (magnitude(input)?, Products::order(in_c));
        let mut errors = error_bound(&input, out_c, at, bias.as_ref(), residual.as_ref(), order);
        if precision.is_half() {
            let powers = weight_powers(weight);
            let rounded = |point, i, o| weight_error(at(point, i, o), powers[o]);
            let moved = magnitudes(&input, out_c, rounded, None, None);
            errors.iter_mut().zip(moved).for_each(|(e, m)| *e += moved_sum(m));
        }
        Ok(Some(vec![Tolerance::Each(errors)]))
    }
}

/// `[O, I, 3, 3]` to `[36 · O, I, 1, 1]`.
fn transform_weight(weight: &Tensor) -> Cow<'_, Tensor> {
    let [out_c, in_c] = [0, 1].map(|i| weight.dims()[i]);
    Cow::Owned(Tensor::from_fn([POINTS * out_c, in_c, 1, 1], |at| {
        let (point, kernel) = (at / (out_c * in_c), at % (out_c * in_c));
        point_weight(&weight.data()[kernel * 9..][..9], point)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a kernel of ones in the middle alone, G g Gᵀ is G's middle column times itself.
    #[test]
    fn weights_lie_point_by_point() {
        let middle = [0.0, -1.0 / 6.0, 1.0 / 6.0, 1.0 / 12.0, -1.0 / 12.0, 0.0];
        let weight =
            Tensor::from_fn([2, 3, 3, 3], |at| if at % 9 == 4 { (at / 9 + 1) as f32 } else { 0.0 });
        let points = transform_weight(&weight);
        assert_eq!(points.dims(), [72, 3, 1, 1]);
        for (at, value) in points.data().iter().enumerate() {
            let (point, kernel) = (at / 6, at % 6);
            let expected = middle[point / 6] * middle[point % 6] * (kernel + 1) as f64;
            assert!((f64::from(*value) - expected).abs() < 1e-7, "{point} of {kernel}");
        }
    }
}
