//! Values that are no finite number.

use crate::engine::kernels::count::count_tensor;
use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work};
use crate::engine::ops::NotFinite;
use crate::engine::ops::not_finite::CHUNK;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        rows: u32,
        row_elements: u32,
        chunks: u32,
        input_stride: u32,
        count_stride: u32,
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "not_finite",
    source: include_str!("../../../wgsl/not_finite.wgsl"),
    params: PARAMS,
};

fn variant() -> Variant {
    Variant::of(&[("CHUNK", CHUNK as u32)])
}

/// The definition, a workgroup a chunk.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "not_finite/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, variant())]
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &NotFinite = work.op()?;
        let rows = recording.dims(inputs[0])[0];
        let row_elements = recording.dims(inputs[0])[1..].iter().product::<usize>();
        let chunks = recording.dims(outputs[0])[0];
        let count = count_tensor(recording, inputs.get(1).copied(), rows);
        let params = Params {
            rows: rows as u32,
            row_elements: row_elements as u32,
            chunks: chunks as u32,
            input_stride: recording.stride(inputs[0]),
            count_stride: recording.stride(count),
            output_stride: recording.stride(outputs[0]),
        };
        let bindings = [("input", inputs[0]), ("count", count), ("output", outputs[0])];
        let grid = Grid::linear(chunks, 1).pictures(recording.batch());
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch(dispatch.variant(variant()));
        Ok(())
    }
}
