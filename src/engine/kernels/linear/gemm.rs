//! As a product of matrices, in registers.

use crate::engine::kernels::count::{count_tensor, row_grid};
use crate::engine::kernels::products::{Lanes, most_slices};
use crate::engine::kernels::weights::Packing;
use crate::engine::kernels::{Caps, Dispatch, Io, Kernel, MAX_WORKGROUPS, Recording, Work};
use crate::engine::ops::bounds::{magnitude, moved_sum};
use crate::engine::ops::linear::{rows, slices};
use crate::engine::ops::{Linear, Op, Tolerance};
use crate::engine::precision::{Precision, weight_errors};
use crate::engine::reference;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        rows: u32,
        inner: u32,
        /// vec4 in a row of inputs, padded to whole slices.
        inner_quads: u32,
        outputs: u32,
        slices: u32,
        slice_quads: u32,
        /// Slices of an invocation.
        rounds: u32,
        /// Columns of `weight`.
        weight_width: u32,
        relu: u32,
        /// Always 0.
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "linear/gemm",
    source: include_str!("../../../../wgsl/linear/gemm.wgsl"),
    params: PARAMS,
};

/// Rows that one workgroup computes.
const ROWS: u32 = 16;
/// Outputs that one invocation computes.
const OUTPUTS: usize = 4;
/// Slices that a workgroup sums side by side: on an adapter with few cores, which keep busy anyway, one.
fn side_by_side(lanes: Lanes, caps: &Caps) -> u32 {
    if caps.has_many_cores() { most_slices(lanes.workgroup) } else { 1 }
}

fn variant(lanes: Lanes, slices: u32, inner: usize, weights: Precision) -> Variant {
    let variant = Variant::of(&[("WORKGROUP", lanes.workgroup), ("SLICES", slices)]);
    Lanes::variant(Some(lanes), variant)
        .with("SPLIT", slices > 1)
        .with("ALIGNED", inner.is_multiple_of(4))
        .with("HALF_WEIGHT", weights.is_half())
}

/// A layer cut into workgroups.
#[derive(Clone, Copy, Debug)]
struct Plan {
    lanes: Lanes,
    outputs: usize,
    inner: usize,
    /// Outputs of a workgroup, and workgroups for all.
    tile: usize,
    tiles: usize,
    slices: usize,
    slice_quads: usize,
    /// Columns and rows of the packed weights.
    texels: [usize; 2],
}

impl Plan {
    /// `None` without subgroups, and for weights that fit no texture.
    fn of(work: &Work) -> Option<Self> {
        let lanes = Lanes::of(work.caps)?;
        let [outputs, inner] = [0, 1].map(|i| work.inputs[1].shape.0[i]);
        let tile = OUTPUTS * lanes.workgroup as usize;
        let tiles = outputs.div_ceil(tile);
        let (slices, slice_quads) = slices(inner);
        let side = work.caps.texture_side as usize;
        let all = tiles * tile * slices * slice_quads;
        let width = (side / tile * tile).min(all);
        let fits = width > 0
            && all.div_ceil(width.max(1)) <= side
            && tiles <= MAX_WORKGROUPS as usize
            && work.known[1]
            && work.known[2];
        let texels = [width, all.div_ceil(width.max(1))];
        fits.then_some(Self { lanes, outputs, inner, tile, tiles, slices, slice_quads, texels })
    }

    /// `[O, K]` to `[tile, quad, output of the tile, 4]`, in rows of texels, with zeros up to whole
    /// tiles, slices and rows.
    fn pack_weight(&self, weight: &Tensor) -> Tensor {
        let [width, height] = self.texels;
        let quads = self.slices * self.slice_quads;
        let mut packed = Tensor::zeros([height, width, 4]);
        let to = packed.data_mut();
        for (o, row) in weight.data().chunks_exact(self.inner).enumerate() {
            let first = o / self.tile * quads * self.tile + o % self.tile;
            for (k, value) in row.iter().enumerate() {
                to[(first + k / 4 * self.tile) * 4 + k % 4] = *value;
            }
        }
        packed
    }
}

/// Weights are read once for sixteen rows.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Gemm;

impl Kernel for Gemm {
    fn id(&self) -> &'static str {
        "linear/gemm"
    }

    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        let lanes = Lanes::of(caps);
        let all = [4, 1]
            .into_iter()
            .flat_map(|inner| [Precision::F32, Precision::F16].map(|weights| (inner, weights)));
        let all = all.flat_map(|(inner, weights)| {
            lanes.map(|l| variant(l, side_by_side(l, caps), inner, weights))
        });
        all.map(|variant| (&SHADER, variant)).collect()
    }

    fn fits(&self, work: &Work) -> bool {
        Plan::of(work).is_some()
    }

    fn preferred(&self, work: &Work) -> bool {
        // Compiled for AMD, `planar` has fewer instructions a product: broadcasts are instructions too.
        !work.caps.has_scalar_registers()
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &Linear = work.op()?;
        let none = || Error::tensor(op.name(), "weight", "one that fits a texture", "a larger one");
        let plan = Plan::of(work).ok_or_else(none)?;
        let Plan { lanes, tiles, slices, slice_quads, texels: [width, height], .. } = plan;
        let name = recording.info(inputs[1]).name.clone();
        let rows = rows(&work.inputs[0].shape);
        let weight = recording.weights(op.name(), inputs[1])?;
        let packing = Packing {
            texels: TensorSpec::f32([height, width, 4]),
            outputs: plan.outputs,
            tile: plan.tile,
            copies: 1,
            pack: move |weight: &Tensor| plan.pack_weight(weight),
        };
        let weight = packing.record(recording, &name, &weight, work.precision);
        let bias = recording.weights(op.name(), inputs[2])?;
        let bias = recording.constant(format!("{name} (bias)"), bias);
        let given = inputs.get(3).copied();
        let count = count_tensor(recording, given, rows);
        let side = side_by_side(lanes, work.caps);
        let params = Params {
            rows: rows as u32,
            inner: plan.inner as u32,
            inner_quads: (slices * slice_quads) as u32,
            outputs: plan.outputs as u32,
            slices: slices as u32,
            slice_quads: slice_quads as u32,
            rounds: (slices as u32).div_ceil(side),
            weight_width: width as u32,
            relu: u32::from(op.relu),
            zero: 0,
        };
        let grid = row_grid(recording, given, rows, [1, tiles], ROWS)?;
        let bindings = [
            ("count", count),
            ("input", inputs[0]),
            ("weight", weight.texels),
            ("bias", bias),
            ("output", outputs[0]),
        ];
        let bindings = weight.scaled(&bindings);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch(dispatch.variant(variant(lanes, side, plan.inner, work.precision)));
        Ok(())
    }

    fn tolerance(
        &self,
        op: &dyn Op,
        inputs: &[&Value],
        reference: &[Value],
        precision: Precision,
    ) -> Result<Option<Vec<Tolerance>>> {
        if !precision.is_half() {
            return Ok(None);
        }
        let bounds = op.tolerance(inputs, reference)?;
        let moved = moved(inputs)?;
        let add = |bound: Tolerance| {
            let each = moved.iter().enumerate().map(|(i, m)| bound.limit(i) + m);
            Tolerance::Each(each.collect())
        };
        Ok(Some(bounds.into_iter().map(add).collect()))
    }
}

/// How far each output may be moved by weights that are stored in f16.
fn moved(inputs: &[&Value]) -> Result<Vec<f64>> {
    let rounded = weight_errors(inputs[1].f32()?);
    let (input, none) = (magnitude(inputs[0])?, Tensor::zeros([rounded.dims()[0]]));
    let rows = rows(input.shape());
    let moved = reference::linear(&input, &rounded, &none, rows, false);
    Ok(moved.data().iter().map(|m| moved_sum(f64::from(*m))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 33 outputs of 5 inputs for 8 lanes: output o of input k is 10o + k + 1.
    #[test]
    fn weights_lie_as_they_are_read() {
        let (slices, slice_quads) = slices(5);
        let lanes = Lanes::of(&Caps::default().with_subgroups([8, 8])).expect("subgroups");
        let plan = Plan {
            lanes,
            outputs: 33,
            inner: 5,
            tile: 32,
            tiles: 2,
            slices,
            slice_quads,
            texels: [64, slice_quads],
        };
        assert_eq!(slices, 1);
        let weight = Tensor::from_fn([33, 5], |at| (at / 5 * 10 + at % 5 + 1) as f32);
        let packed = plan.pack_weight(&weight);
        let texel = |at: usize| packed.data()[at * 4..][..4].to_vec();
        assert_eq!(texel(0), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(texel(31), [311.0, 312.0, 313.0, 314.0]);
        assert_eq!(texel(32), [5.0, 0.0, 0.0, 0.0]);
        assert_eq!(texel(64), [0.0; 4]);
        let second = 32 * slice_quads;
        assert_eq!(texel(second), [321.0, 322.0, 323.0, 324.0]);
        assert_eq!(texel(second + 1), [0.0; 4]);
    }
}
