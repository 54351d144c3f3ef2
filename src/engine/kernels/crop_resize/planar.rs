//! The definition, on planar maps.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::CropResize;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        width: u32,
        height: u32,
        capacity: u32,
        shift_r: f32,
        shift_g: f32,
        shift_b: f32,
        rest_r: f32,
        rest_g: f32,
        rest_b: f32,
        std_r: f32,
        std_g: f32,
        std_b: f32,
    }
}

static SHADER: Shader = Shader {
    stem: "crop_resize/planar",
    source: include_str!("../../../../wgsl/crop_resize/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "crop_resize/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &CropResize = work.op()?;
    let [shift_r, shift_g, shift_b] = op.shift().map(|(shift, _)| f32::from(shift));
    let [rest_r, rest_g, rest_b] = op.shift().map(|(_, rest)| rest as f32);
    let [std_r, std_g, std_b] = op.std;
    let params = Params {
        width: op.width as u32,
        height: op.height as u32,
        capacity: 4 * recording.dims(inputs[0])[0] as u32,
        shift_r,
        shift_g,
        shift_b,
        rest_r,
        rest_g,
        rest_b,
        std_r,
        std_g,
        std_b,
    };
    let bindings = [("picture", inputs[0]), ("crop", inputs[1]), ("output", outputs[0])];
    let grid = Grid::linear(op.height * op.width, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
