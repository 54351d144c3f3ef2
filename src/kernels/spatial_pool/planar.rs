//! The definition, on planar maps.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::SpatialPool;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        channels: u32,
        area: u32,
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "spatial_pool/planar",
    source: include_str!("../../../wgsl/spatial_pool/planar.wgsl"),
    params: PARAMS,
};

/// Pixels that one workgroup computes.
const PIXELS: usize = 32;

/// The definition, on planar maps.
#[derive(Debug)]
pub(in crate::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "spatial_pool/planar"
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
        let _op: &SpatialPool = work.op()?;
        let [channels, height, width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
        let params = Params { channels, area: height * width, zero: 0 };
        let bindings = [("input", inputs[0]), ("channel_gate", inputs[1]), ("output", outputs[0])];
        let grid = Grid::linear(params.area as usize, PIXELS as u32);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
