//! CBAM's spatial gate.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::SpatialGate;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        height: u32,
        width: u32,
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "spatial_gate",
    source: include_str!("../../../wgsl/spatial_gate.wgsl"),
    params: PARAMS,
};

/// Pixels of a row that one invocation computes.
const PIXELS: usize = 8;

/// The definition, on planar maps.
pub(super) static PLANAR: Plain = Plain { id: "spatial_gate/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let _op: &SpatialGate = work.op()?;
    let [height, width] = [1, 2].map(|i| recording.dims(inputs[0])[i]);
    let params = Params { height: height as u32, width: width as u32, zero: 0 };
    let bindings =
        [("pooled", inputs[0]), ("weight", inputs[1]), ("bias", inputs[2]), ("output", outputs[0])];
    let grid = Grid::linear(height * width.div_ceil(PIXELS), 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
