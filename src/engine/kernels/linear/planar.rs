//! Without subgroups.

use crate::engine::kernels::count::{count_tensor, row_grid};
use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work};
use crate::engine::ops::linear::{rows, slices};
use crate::engine::ops::{Linear, Op};
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Tensor;
use crate::error::Result;

shader_params! {
    struct Params {
        rows: u32,
        inner: u32,
        /// vec4 in a row of inputs, padded.
        inner_quads: u32,
        outputs: u32,
        slices: u32,
        slice_quads: u32,
        relu: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "linear/planar",
    source: include_str!("../../../../wgsl/linear/planar.wgsl"),
    params: PARAMS,
};

/// Rows that one workgroup computes.
const ROWS: u32 = 8;

/// Invocations of a workgroup, each with four outputs.
const LANES: usize = 64;

/// The definition.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "linear/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &Linear = work.op()?;
        let name = recording.info(inputs[1]).name.clone();
        let weight = recording.weights(op.name(), inputs[1])?;
        let bias = recording.weights(op.name(), inputs[2])?;
        let [outs, inner] = [0, 1].map(|i| weight.spec().shape.0[i]);
        let rows = rows(&work.inputs[0].shape);
        let quads = outs.div_ceil(4);
        let inner_quads = inner.div_ceil(4);
        let (slices, slice_quads) = slices(inner);
        let columns = quads.div_ceil(LANES);

        let packed = weight.packed(TensorSpec::f32([inner_quads * 4, quads * 4]), pack_weight);
        let packed = recording.constant(format!("{name} (packed)"), packed);
        let bias = bias.packed(TensorSpec::f32([quads * 4]), pad_bias);
        let bias = recording.constant(format!("{name} (bias)"), bias);
        let partials = recording.scratch("partials", TensorSpec::f32([slices, rows, quads * 4]));
        let given = inputs.get(3).copied();
        let count = count_tensor(recording, given, rows);
        let params = Params {
            rows: rows as u32,
            inner: inner as u32,
            inner_quads: inner_quads as u32,
            outputs: outs as u32,
            slices: slices as u32,
            slice_quads: slice_quads as u32,
            relu: u32::from(op.relu),
        };

        let mut input = inputs[0];
        if inner % 4 != 0 {
            let padded = recording.scratch("padded", TensorSpec::f32([rows, inner_quads * 4]));
            let bindings = [("count", count), ("unpadded", input), ("padded", padded)];
            let grid = Grid::linear(rows * inner_quads * 4, LANES as u32);
            recording.dispatch(Dispatch::new(&SHADER, "pad", &params, &bindings, grid));
            input = padded;
        }
        let tiles = row_grid(recording, given, rows, [1, columns * slices], ROWS)?;
        let bindings =
            [("count", count), ("input", input), ("weight", packed), ("partials", partials)];
        recording.dispatch(Dispatch::new(&SHADER, "partial", &params, &bindings, tiles));
        let grid = row_grid(recording, given, rows, [quads, 1], LANES as u32)?;
        let bindings =
            [("count", count), ("partials", partials), ("bias", bias), ("output", outputs[0])];
        recording.dispatch(Dispatch::new(&SHADER, "finish", &params, &bindings, grid));
        Ok(())
    }
}

/// `[O, K]` to `[K, O]`, with zeros up to whole numbers of four.
fn pack_weight(weight: &Tensor) -> Tensor {
    let [outs, inner] = [0, 1].map(|i| weight.dims()[i]);
    let [to_outs, to_inner] = [outs, inner].map(|n| n.next_multiple_of(4));
    let mut packed = Tensor::zeros([to_inner, to_outs]);
    for (o, row) in weight.data().chunks_exact(inner).enumerate() {
        for (k, w) in row.iter().enumerate() {
            packed.data_mut()[k * to_outs + o] = *w;
        }
    }
    packed
}

fn pad_bias(bias: &Tensor) -> Tensor {
    let padded = bias.data().len().next_multiple_of(4);
    Tensor::from_fn([padded], |i| bias.data().get(i).copied().unwrap_or(0.0))
}
