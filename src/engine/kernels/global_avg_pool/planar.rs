//! The definition, on planar maps.

use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work};
use crate::engine::ops::GlobalAvgPool;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        channels: u32,
        area: u32,
        first: u32,
        /// Always 0; see shared/reduce.wgsl.
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "global_avg_pool/planar",
    source: include_str!("../../../../wgsl/global_avg_pool/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "global_avg_pool/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &GlobalAvgPool = work.op()?;
        let mut first = 0;
        for input in inputs {
            let [channels, height, width] = [0, 1, 2].map(|i| recording.dims(*input)[i] as u32);
            let params = Params { channels, area: height * width, first, zero: 0 };
            let bindings = [("input", *input), ("output", outputs[0])];
            let grid = Grid::linear(channels as usize, 1);
            recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
            first += channels;
        }
        Ok(())
    }
}
