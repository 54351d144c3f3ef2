//! Box voting.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::BoxVoting;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        candidates: u32,
        /// Candidates that a row speaks for.
        share: u32,
        columns: u32,
        capacity: u32,
        iou_threshold: f32,
    }
}

static SHADER: Shader = Shader {
    stem: "box_voting",
    source: include_str!("../../../wgsl/box_voting.wgsl"),
    params: PARAMS,
};

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "box_voting/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &BoxVoting = work.op()?;
    let [rows, columns] = [0, 1].map(|i| recording.dims(inputs[0])[i]);
    let candidates = recording.dims(inputs[1])[0];
    let capacity = recording.dims(inputs[4])[0];
    let params = Params {
        candidates: candidates as u32,
        share: (candidates / rows) as u32,
        columns: columns as u32,
        capacity: capacity as u32,
        iou_threshold: op.iou_threshold,
    };
    let bindings = [
        ("rows", inputs[0]),
        ("boxes", inputs[1]),
        ("scores", inputs[2]),
        ("classes", inputs[3]),
        ("keep", inputs[4]),
        ("kept", inputs[5]),
        ("count", inputs[6]),
        ("output", outputs[0]),
    ];
    // Not indirect: the invocations of rows that are not kept end at once.
    let grid = Grid::linear(capacity * columns, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
