//! The definition, on planar maps.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::UpsampleBilinear;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        channels: u32,
        in_height: u32,
        in_width: u32,
        out_height: u32,
        out_width: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "upsample_bilinear/planar",
    source: include_str!("../../../wgsl/upsample_bilinear/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
#[derive(Debug)]
pub(in crate::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "upsample_bilinear/planar"
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
        let op: &UpsampleBilinear = work.op()?;
        let [channels, in_height, in_width] =
            [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
        let params = Params {
            channels,
            in_height,
            in_width,
            out_height: op.out_height as u32,
            out_width: op.out_width as u32,
        };
        let bindings = [("input", inputs[0]), ("output", outputs[0])];
        let grid = Grid::linear(recording.info(outputs[0]).spec.shape.elements(), 64);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
