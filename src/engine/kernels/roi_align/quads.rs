//! On maps of four channels a texel.

use crate::engine::kernels::count::count_tensor;
use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Recording, Work, all_texels, layout,
};
use crate::engine::ops::RoiAlign;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        rois: u32,
        size: u32,
        ratio: u32,
        scale: f32,
        /// Elements of a picture of each buffer.
        box_stride: u32,
        count_stride: u32,
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "roi_align/quads",
    source: include_str!("../../../../wgsl/roi_align/quads.wgsl"),
    params: PARAMS,
};

/// Workgroups of 64 for the bins of all boxes.
fn bin_groups(op: &RoiAlign, rois: usize) -> usize {
    (rois * op.output_size * op.output_size).div_ceil(64)
}

/// Each invocation computes sixteen channels of a bin, which share their samples.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "roi_align/quads"
    }

    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        all_texels(&caps.input_variant()).map(|variant| (&SHADER, variant)).into()
    }

    fn fits(&self, work: &Work) -> bool {
        work.op()
            .is_ok_and(|op| bin_groups(op, work.inputs[1].shape.0[0]) <= MAX_WORKGROUPS as usize)
            && work.has_quads(&work.inputs[0])
    }

    fn reads(&self, work: &Work, index: usize) -> Layout {
        if index == 0 { work.caps.input_layout() } else { Layout::Planar }
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &RoiAlign = work.op()?;
        let map = recording.quads(inputs[0])?;
        let rois = recording.dims(inputs[1])[0];
        let count = count_tensor(recording, inputs.get(2).copied(), rois);
        let params = Params {
            map,
            rois: rois as u32,
            size: op.output_size as u32,
            ratio: op.sampling_ratio as u32,
            scale: op.spatial_scale,
            box_stride: recording.stride(inputs[1]),
            count_stride: recording.stride(count),
            output_stride: recording.stride(outputs[0]),
        };
        let bindings =
            [("input", inputs[0]), ("boxes", inputs[1]), ("count", count), ("output", outputs[0])];
        let [across, quads] = [bin_groups(op, rois) as u32, map.quads.div_ceil(4)];
        let grid = Grid::Workgroups([across, quads, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid)
            .variant(work.caps.input_variant());
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }
}
