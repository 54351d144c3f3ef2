//! The definition, on planar maps.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::MaxPool2d;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        channels: u32,
        in_height: u32,
        in_width: u32,
        out_height: u32,
        out_width: u32,
        kernel: u32,
        stride: u32,
        padding: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "max_pool2d/planar",
    source: include_str!("../../../wgsl/max_pool2d/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
#[derive(Debug)]
pub(in crate::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "max_pool2d/planar"
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
        let op: &MaxPool2d = work.op()?;
        let [channels, in_height, in_width] =
            [0, 1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
        let [out_height, out_width] = [1, 2].map(|i| recording.dims(outputs[0])[i] as u32);
        let params = Params {
            channels,
            in_height,
            in_width,
            out_height,
            out_width,
            kernel: op.kernel as u32,
            stride: op.stride as u32,
            padding: op.padding as u32,
        };
        let bindings = [("input", inputs[0]), ("output", outputs[0])];
        let grid = Grid::linear(recording.info(outputs[0]).spec.shape.elements(), 64);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
