//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, of_maps,
};
use crate::engine::ops::ApplyGates;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        channel_gate_stride: u32,
        spatial_gate_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "apply_gates/quads",
    source: include_str!("../../../../wgsl/apply_gates/quads.wgsl"),
    params: PARAMS,
};

/// Each workgroup computes eight rows of four channels.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "apply_gates/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        // Gates are read four at a time.
        let channels = work.inputs[0].shape.0[0];
        channels.is_multiple_of(4) && work.has_quads(&work.inputs[0])
    }

    fn reads(&self, _work: &Work, index: usize) -> Layout {
        if index == 0 { Layout::Quads } else { Layout::Planar }
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &ApplyGates = work.op()?;
        let map = recording.quads(inputs[0])?;
        let params = Params {
            map,
            channel_gate_stride: recording.stride(inputs[1]),
            spatial_gate_stride: recording.stride(inputs[2]),
        };
        let bindings = [
            ("input", inputs[0]),
            ("channel_gate", inputs[1]),
            ("spatial_gate", inputs[2]),
            ("output", outputs[0]),
        ];
        let grid = Grid::Workgroups([map.height.div_ceil(8), map.quads, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }
}
