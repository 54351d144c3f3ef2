//! CBAM's spatial gate.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::SpatialGate;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        height: u32,
        width: u32,
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "spatial_gate",
    source: include_str!("../../wgsl/spatial_gate.wgsl"),
    params: PARAMS,
};

/// Pixels of a row that one invocation computes.
const PIXELS: usize = 8;

/// The definition, on planar maps.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "spatial_gate/planar"
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
        let _op: &SpatialGate = work.op()?;
        let [height, width] = [1, 2].map(|i| recording.dims(inputs[0])[i]);
        let params = Params { height: height as u32, width: width as u32, zero: 0 };
        let bindings = [
            ("pooled", inputs[0]),
            ("weight", inputs[1]),
            ("bias", inputs[2]),
            ("output", outputs[0]),
        ];
        let grid = Grid::linear(height * width.div_ceil(PIXELS), 64);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
