//! The definition, on planar maps.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::MaxPool2d;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        channels: u32,
        in_height: u32,
        in_width: u32,
        out_height: u32,
        out_width: u32,
        kernel: u32,
        stride: u32,
        padding: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "max_pool2d/planar",
    source: include_str!("../../../../wgsl/max_pool2d/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "max_pool2d/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &MaxPool2d = work.op()?;
    let [channels, in_height, in_width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
    let [out_height, out_width] = [1, 2].map(|i| recording.dims(outputs[0])[i] as u32);
    let params = Params {
        channels,
        in_height,
        in_width,
        out_height,
        out_width,
        kernel: op.kernel as u32,
        stride: op.stride as u32,
        padding: op.padding as u32,
    };
    let bindings = [("input", inputs[0]), ("output", outputs[0])];
    let grid = Grid::linear(recording.info(outputs[0]).spec.shape.elements(), 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
