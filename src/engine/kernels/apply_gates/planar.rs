//! The definition, on planar maps.

use super::{SPAN, SPANS};
use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::ApplyGates;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        channels: u32,
        height: u32,
        width: u32,
        /// Always 0.
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "apply_gates/planar",
    source: include_str!("../../../../wgsl/apply_gates/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "apply_gates/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let _op: &ApplyGates = work.op()?;
    let [channels, height, width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
    let params = Params { channels, height, width, zero: 0 };
    let bindings = work.bindings((inputs, outputs));
    let spans = height as usize * (width as usize).div_ceil(SPAN);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, Grid::linear(spans, SPANS)))
}
