//! The definition, on planar maps.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::ChannelPool;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        channels: u32,
        area: u32,
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "channel_pool/planar",
    source: include_str!("../../../wgsl/channel_pool/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
#[derive(Debug)]
pub(in crate::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "channel_pool/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(
        &self,
        work: &Work,
        recording: &mut Recording,
        inputs: &[TensorId],
        outputs: &[TensorId],
    ) -> Result<()> {
        let _op: &ChannelPool = work.op()?;
        let [channels, height, width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
        let params = Params { channels, area: height * width, zero: 0 };
        let bindings = [("input", inputs[0]), ("output", outputs[0])];
        let grid = Grid::linear(channels as usize, 1);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
