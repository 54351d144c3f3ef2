//! Softmax over rows.

use crate::engine::kernels::count::{count_tensor, row_grid};
use crate::engine::kernels::{Dispatch, Io, Plain, Recording, Work};
use crate::engine::ops::Softmax;
use crate::engine::ops::softmax::rows_and_columns;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        rows: u32,
        columns: u32,
        /// One by the temperature.
        scale: f32,
        /// Always 0; see shared/reduce.wgsl.
        zero: u32,
    }
}

static SHADER: Shader =
    Shader { stem: "softmax", source: include_str!("../../../wgsl/softmax.wgsl"), params: PARAMS };

/// Invocations of the workgroup that computes a row.
const LANES: u32 = 64;

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "softmax/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &Softmax = work.op()?;
    let [rows, columns] = rows_and_columns(&work.inputs[0].shape);
    let given = inputs.get(1).copied();
    let count = count_tensor(recording, given, rows);
    let grid = row_grid(recording, given, rows, [LANES as usize, 1], LANES)?;
    let bindings = [("input", inputs[0]), ("count", count), ("output", outputs[0])];
    let params =
        Params { rows: rows as u32, columns: columns as u32, scale: 1.0 / op.temperature, zero: 0 };
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
