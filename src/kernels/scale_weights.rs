//! RW-Net's weight of each scale.

use crate::error::{Error, Result};
use crate::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::ops::{Op, ScaleWeights};
use crate::shader::{Shader, shader_params};

shader_params! {
    struct Params {
        inputs: u32,
        hidden: u32,
        scales: u32,
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "scale_weights",
    source: include_str!("../../wgsl/scale_weights.wgsl"),
    params: PARAMS,
};

/// Hidden units that fit in the shader's workgroup memory.
const CAPACITY: usize = 1024;

/// Invocations of the shader's workgroup, each of which computes a scale.
const MAX_SCALES: usize = 256;

/// The definition, on planar maps.
pub(super) static PLANAR: Plain = Plain { id: "scale_weights/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &ScaleWeights = work.op()?;
    let [hidden, length] = [0, 1].map(|i| recording.dims(inputs[1])[i]);
    let scales = recording.dims(outputs[0])[0];
    let limits = [("hidden units", hidden, CAPACITY), ("scales", scales, MAX_SCALES)];
    for (what, needed, available) in limits {
        if needed > available {
            return Err(Error::Capacity {
                what: format!("{}: {what}", op.name()),
                needed: needed as u64,
                available: available as u64,
            });
        }
    }
    let params =
        Params { inputs: length as u32, hidden: hidden as u32, scales: scales as u32, zero: 0 };
    let mut bindings: Vec<_> = op.inputs().into_iter().zip(inputs.iter().copied()).collect();
    bindings.push(("output", outputs[0]));
    let grid = Grid::Workgroups([1, 1, 1]);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
