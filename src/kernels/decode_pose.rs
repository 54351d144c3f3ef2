//! The pose of each detection.

use crate::error::Result;
use crate::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::ops::DecodePose;
use crate::shader::{Shader, shader_params};

shader_params! {
    struct Params {
        rows: u32,
        capacity: u32,
        classes: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "decode_pose",
    source: include_str!("../../wgsl/decode_pose.wgsl"),
    params: PARAMS,
};

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "decode_pose/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &DecodePose = work.op()?;
    let rows = recording.dims(inputs[0])[0] as u32;
    let capacity = recording.dims(inputs[1])[0];
    let params = Params { rows, capacity: capacity as u32, classes: op.classes as u32 };
    let bindings =
        [("rows", inputs[0]), ("keep", inputs[1]), ("count", inputs[2]), ("output", outputs[0])];
    // Not indirect: so few invocations cost less than the dispatch that would save them.
    let grid = Grid::linear(capacity, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
