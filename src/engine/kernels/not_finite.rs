//! Values that are no finite number.

use bytemuck::Zeroable;

use crate::engine::kernels::count::count_tensor;
use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work, repeated};
use crate::engine::ops::NotFinite;
use crate::engine::ops::not_finite::{CHUNK, chunks};
use crate::engine::shader::{Shader, Variant, shader_params, shader_struct};
use crate::error::Result;

shader_struct! {
    struct Part {
        /// Rows, of which a count says how many are in use, and elements of a row.
        rows: u32,
        row_elements: u32,
        /// Chunks of this tensor and those before it.
        end: u32,
        /// Elements of a picture.
        stride: u32,
    }
}

shader_params! {
    struct Params {
        parts: [Part; INPUTS.len()],
        /// Tensors that there are; the other bindings are not read.
        used: u32,
        chunks: u32,
        /// Where the first chunk's number goes.
        first: u32,
        /// Elements of a picture.
        count_stride: u32,
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "not_finite",
    source: include_str!("../../../wgsl/not_finite.wgsl"),
    params: PARAMS,
};

/// Tensors of a dispatch. With the count and the output they take the eight storage buffers that a stage has.
const INPUTS: [&str; 6] = ["input0", "input1", "input2", "input3", "input4", "input5"];

fn variant() -> Variant {
    Variant::of(&[("CHUNK", CHUNK as u32)])
}

/// The definition, a workgroup a chunk, for six tensors at a time.
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
        let op: &NotFinite = work.op()?;
        let (values, count) = inputs.split_at(op.values);
        let rows = values.iter().map(|id| recording.dims(*id)[0]).max().unwrap_or(0);
        let count = count_tensor(recording, count.first().copied(), rows);
        let mut first = 0;
        for values in values.chunks(INPUTS.len()) {
            let mut params = Params::zeroed();
            for (part, id) in params.parts.iter_mut().zip(values) {
                let spec = &recording.info(*id).spec;
                let rows = spec.shape.0[0];
                params.chunks += chunks(spec) as u32;
                *part = Part {
                    rows: rows as u32,
                    row_elements: (spec.shape.elements() / rows) as u32,
                    end: params.chunks,
                    stride: recording.stride(*id),
                };
            }
            params.used = values.len() as u32;
            params.first = first;
            params.count_stride = recording.stride(count);
            params.output_stride = recording.stride(outputs[0]);
            first += params.chunks;
            let ends = [("count", count), ("output", outputs[0])];
            let bindings: Vec<_> = ends.into_iter().chain(repeated(INPUTS, values)).collect();
            let grid = Grid::linear(params.chunks as usize, 1).pictures(recording.batch());
            let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
            recording.dispatch(dispatch.variant(variant()));
        }
        Ok(())
    }
}
