//! Proposals from the region proposal head.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::DecodeProposals;
use crate::engine::shader::{Shader, shader_params};
use crate::engine::tensor::Tensor;
use crate::error::Result;

shader_params! {
    struct Params {
        anchors: u32,
        height: u32,
        width: u32,
        capacity: u32,
        stride: f32,
        picture_width: f32,
        picture_height: f32,
    }
}

static SHADER: Shader = Shader {
    stem: "decode_proposals",
    source: include_str!("../../../wgsl/decode_proposals.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(super) static PLANAR: Plain =
    Plain { id: "decode_proposals/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &DecodeProposals = work.op()?;
    let [height, width] = [1, 2].map(|i| recording.dims(inputs[0])[i] as u32);
    let capacity = recording.dims(inputs[1])[0];
    let cell = Tensor::new([op.anchors.len(), 4], op.anchors.concat())?;
    let anchors = recording.constant("anchors", cell);
    let params = Params {
        anchors: op.anchors.len() as u32,
        height,
        width,
        capacity: capacity as u32,
        stride: op.stride as f32,
        picture_width: op.width as f32,
        picture_height: op.height as f32,
    };
    let bindings = [
        ("deltas", inputs[0]),
        ("logits", inputs[1]),
        ("indices", inputs[2]),
        ("count", inputs[3]),
        ("anchors", anchors),
        ("boxes", outputs[0]),
        ("scores", outputs[1]),
    ];
    let grid = Grid::linear(capacity, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
