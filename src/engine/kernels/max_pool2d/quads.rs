//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, of_maps,
};
use crate::engine::ops::MaxPool2d;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        input: layout::Quads,
        output: layout::Quads,
        kernel: u32,
        stride: u32,
        padding: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "max_pool2d/quads",
    source: include_str!("../../../../wgsl/max_pool2d/quads.wgsl"),
    params: PARAMS,
};

/// Each workgroup computes eight rows of eight channels.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "max_pool2d/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        work.has_quads(&work.inputs[0]) && work.has_quads(&work.outputs[0])
    }

    fn reads(&self, _work: &Work, _index: usize) -> Layout {
        Layout::Quads
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &MaxPool2d = work.op()?;
        let (input, output) = (recording.quads(inputs[0])?, recording.quads(outputs[0])?);
        let params = Params {
            input,
            output,
            kernel: op.kernel as u32,
            stride: op.stride as u32,
            padding: op.padding as u32,
        };
        let bindings = [("input", inputs[0]), ("output", outputs[0])];
        let [down, quads] = [output.height.div_ceil(8), output.quads.div_ceil(2)];
        let grid = Grid::Workgroups([down, quads, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }
}
