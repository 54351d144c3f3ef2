//! The pose of each detection.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::DecodePose;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        capacity: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "decode_pose",
    source: include_str!("../../../wgsl/decode_pose.wgsl"),
    params: PARAMS,
};

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "decode_pose/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let _op: &DecodePose = work.op()?;
    let capacity = recording.dims(inputs[0])[0];
    let params = Params { capacity: capacity as u32 };
    let bindings = [("rows", inputs[0]), ("count", inputs[1]), ("output", outputs[0])];
    // Not indirect: so few invocations cost less than the dispatch that would save them.
    let grid = Grid::linear(capacity, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
