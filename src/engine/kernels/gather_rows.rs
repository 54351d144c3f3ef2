//! Rows of a tensor by index.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::GatherRows;
use crate::engine::ops::gather_rows::layout;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        rows: u32,
        columns: u32,
        capacity: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "gather_rows",
    source: include_str!("../../../wgsl/gather_rows.wgsl"),
    params: PARAMS,
};

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "gather_rows/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let _op: &GatherRows = work.op()?;
    let (rows, columns) = layout(recording.dims(inputs[0])).unwrap_or((1, 1));
    let capacity = recording.dims(inputs[1])[0];
    let params = Params { rows: rows as u32, columns: columns as u32, capacity: capacity as u32 };
    let bindings =
        [("rows", inputs[0]), ("indices", inputs[1]), ("count", inputs[2]), ("output", outputs[0])];
    // Not indirect: a copy costs less than the dispatch that would save it.
    let grid = Grid::linear(capacity * columns, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
