//! What adds up the parts of a split sum.

use crate::engine::graph::TensorId;
use crate::engine::kernels::{Dispatch, Grid, Quads, Recording, texels};
use crate::engine::ops::Conv2d;
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        output: Quads,
        splits: u32,
        has_residual: u32,
        relu: u32,
        pictures: u32,
    }
}

pub(super) static SHADER: Shader = Shader {
    stem: "conv2d/join",
    source: include_str!("../../../../wgsl/conv2d/join.wgsl"),
    params: PARAMS,
};

/// Invocations of a workgroup.
const LANES: u32 = 64;

/// Appends what adds `splits` parts of each picture, bias, residual, stored in `precision`, and ReLU.
pub(super) fn record(
    op: &Conv2d,
    recording: &mut Recording,
    precision: Precision,
    splits: u32,
    [parts, bias, residual, output]: [TensorId; 4],
    map: Quads,
) {
    let params = Params {
        output: map,
        splits,
        has_residual: u32::from(op.residual),
        relu: u32::from(op.relu),
        pictures: recording.batch(),
    };
    let bindings = [("parts", parts), ("bias", bias), ("residual", residual), ("output", output)];
    let invocations = map.width as usize * map.height as usize * map.quads as usize;
    let grid = Grid::linear(invocations * recording.batch() as usize, LANES);
    let written = recording.info(output).precision;
    let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
    recording.dispatch(dispatch.variant(texels(Variant::default(), precision, written)));
}
