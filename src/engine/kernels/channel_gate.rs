//! CBAM's channel gate.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::{ChannelGate, Op};
use crate::engine::shader::{Shader, shader_params};
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        channels: u32,
        hidden: u32,
        /// Always 0; see shared/reduce.wgsl.
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "channel_gate",
    source: include_str!("../../../wgsl/channel_gate.wgsl"),
    params: PARAMS,
};

/// Hidden units that fit in the shader's workgroup memory.
const CAPACITY: usize = 1024;

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "channel_gate/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &ChannelGate = work.op()?;
    let [hidden, channels] = [0, 1].map(|i| recording.dims(inputs[1])[i]);
    if hidden > CAPACITY {
        return Err(Error::Capacity {
            what: format!("{}: hidden units", op.name()),
            needed: hidden as u64,
            available: CAPACITY as u64,
        });
    }
    let params = Params { channels: channels as u32, hidden: hidden as u32, zero: 0 };
    let bindings = work.bindings((inputs, outputs));
    let grid = Grid::Workgroups([1, 1, 1]);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
