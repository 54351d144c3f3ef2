//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, of_maps,
};
use crate::engine::ops::CropResize;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        capacity: u32,
        shift_r: f32,
        shift_g: f32,
        shift_b: f32,
        rest_r: f32,
        rest_g: f32,
        rest_b: f32,
        std_r: f32,
        std_g: f32,
        std_b: f32,
    }
}

static SHADER: Shader = Shader {
    stem: "crop_resize/quads",
    source: include_str!("../../../../wgsl/crop_resize/quads.wgsl"),
    params: PARAMS,
};

/// Each invocation computes four pixels of a column.
///
/// Each picture of a batch lies in a buffer of its own, so each has a dispatch of its own.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "crop_resize/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        work.has_quads(&work.outputs[0])
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &CropResize = work.op()?;
        let map = recording.quads(outputs[0])?;
        let [shift_r, shift_g, shift_b] = op.shift().map(|(shift, _)| f32::from(shift));
        let [rest_r, rest_g, rest_b] = op.shift().map(|(_, rest)| rest as f32);
        let [std_r, std_g, std_b] = op.std;
        let params = Params {
            map,
            capacity: 4 * recording.dims(inputs[0])[0] as u32,
            shift_r,
            shift_g,
            shift_b,
            rest_r,
            rest_g,
            rest_b,
            std_r,
            std_g,
            std_b,
        };
        let bindings = [("picture", inputs[0]), ("crop", inputs[1]), ("output", outputs[0])];
        let grid = Grid::Workgroups([map.width.div_ceil(8), map.height.div_ceil(32), 1]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }
}
