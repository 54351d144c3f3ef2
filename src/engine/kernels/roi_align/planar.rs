//! The definition, on planar maps.

use crate::engine::kernels::count::{count_tensor, row_grid};
use crate::engine::kernels::{Dispatch, Io, Plain, Recording, Work};
use crate::engine::ops::RoiAlign;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        channels: u32,
        height: u32,
        width: u32,
        rois: u32,
        size: u32,
        ratio: u32,
        scale: f32,
    }
}

static SHADER: Shader = Shader {
    stem: "roi_align/planar",
    source: include_str!("../../../../wgsl/roi_align/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "roi_align/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &RoiAlign = work.op()?;
    let [channels, height, width] = [0, 1, 2].map(|i| recording.dims(inputs[0])[i]);
    let rois = recording.dims(inputs[1])[0];
    let given = inputs.get(2).copied();
    let count = count_tensor(recording, given, rois);
    let items = op.output_size * op.output_size * channels.div_ceil(4);
    let grid = row_grid(recording, given, rois, [items, 1], 64)?;
    let params = Params {
        channels: channels as u32,
        height: height as u32,
        width: width as u32,
        rois: rois as u32,
        size: op.output_size as u32,
        ratio: op.sampling_ratio as u32,
        scale: op.spatial_scale,
    };
    let bindings =
        [("features", inputs[0]), ("boxes", inputs[1]), ("count", count), ("output", outputs[0])];
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
