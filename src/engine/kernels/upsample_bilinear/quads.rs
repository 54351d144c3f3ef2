//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Recording, Work, layout, of_maps,
};
use crate::engine::ops::UpsampleBilinear;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        input: layout::Quads,
        output: layout::Quads,
        /// Quads of a block, and blocks of a picture.
        block: u32,
        blocks: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "upsample_bilinear/quads",
    source: include_str!("../../../../wgsl/upsample_bilinear/quads.wgsl"),
    params: PARAMS,
};

/// Quads of an invocation.
const BLOCK: u32 = 16;

/// Each invocation computes a pixel of some quads, which share where it lies.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "upsample_bilinear/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        let blocks = work.inputs[0].shape.0[0].div_ceil(4 * BLOCK as usize);
        work.has_quads(&work.inputs[0])
            && work.has_quads(&work.outputs[0])
            && blocks * work.batch as usize <= MAX_WORKGROUPS as usize
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
        let _op: &UpsampleBilinear = work.op()?;
        let (input, output) = (recording.quads(inputs[0])?, recording.quads(outputs[0])?);
        let blocks = input.quads.div_ceil(BLOCK);
        let params = Params { input, output, block: BLOCK, blocks };
        let bindings = [("input", inputs[0]), ("output", outputs[0])];
        let [across, down] = [output.width, output.height].map(|n| n.div_ceil(8));
        let grid = Grid::Workgroups([across, down, blocks * recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }
}
