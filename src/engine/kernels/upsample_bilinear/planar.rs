//! The definition, on planar maps.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::UpsampleBilinear;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        channels: u32,
        in_height: u32,
        in_width: u32,
        out_height: u32,
        out_width: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "upsample_bilinear/planar",
    source: include_str!("../../../../wgsl/upsample_bilinear/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "upsample_bilinear/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &UpsampleBilinear = work.op()?;
    let [channels, in_height, in_width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
    let params = Params {
        channels,
        in_height,
        in_width,
        out_height: op.out_height as u32,
        out_width: op.out_width as u32,
    };
    let bindings = [("input", inputs[0]), ("output", outputs[0])];
    let grid = Grid::linear(recording.info(outputs[0]).spec.shape.elements(), 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
