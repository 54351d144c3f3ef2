//! The definition, on planar maps.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::ChannelPool;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        channels: u32,
        area: u32,
        /// Always 0; see shared/reduce.wgsl.
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "channel_pool/planar",
    source: include_str!("../../../../wgsl/channel_pool/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "channel_pool/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let _op: &ChannelPool = work.op()?;
    let [channels, height, width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
    let params = Params { channels, area: height * width, zero: 0 };
    let bindings = [("input", inputs[0]), ("output", outputs[0])];
    let grid = Grid::linear(channels as usize, 1);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
