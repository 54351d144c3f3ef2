//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, of_maps,
};
use crate::engine::ops::bounds::SumOrder;
use crate::engine::ops::{ChannelPool, Op, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        chunk_rows: u32,
        chunks: u32,
        divisor: f32,
        partial_stride: u32,
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "channel_pool/quads",
    source: include_str!("../../../../wgsl/channel_pool/quads.wgsl"),
    params: PARAMS,
};

/// Rows of a chunk, so that a map of the network's first stage keeps all of a processor busy.
const CHUNK_ROWS: usize = 20;

/// Rows of a chunk and chunks, about equal.
fn chunks(height: usize) -> [usize; 2] {
    let rows = height.div_ceil(height.div_ceil(CHUNK_ROWS));
    [rows, height.div_ceil(rows)]
}

/// Each workgroup goes over some rows of 32 channels.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "channel_pool/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        work.has_quads(&work.inputs[0])
    }

    fn reads(&self, _work: &Work, _index: usize) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &ChannelPool = work.op()?;
        let (input, output) = (inputs[0], outputs[0]);
        let map = recording.quads(input)?;
        let [chunk_rows, chunks] = chunks(map.height as usize).map(|n| n as u32);
        // With one chunk there is nothing to bring together.
        let (partials, divisor) = match chunks {
            1 => (output, (map.width * map.height) as f32),
            _ => {
                let spec = TensorSpec::f32([chunks as usize, 2, map.channels as usize]);
                (recording.scratch("partials", spec), 1.0)
            }
        };
        let mut params = Params {
            map,
            chunk_rows,
            chunks,
            divisor,
            partial_stride: recording.stride(partials),
            output_stride: recording.stride(output),
        };
        let bindings = [("input", input), ("partials", partials)];
        let grid = Grid::Workgroups([chunks, map.quads.div_ceil(8), recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch, input, output);
        if chunks > 1 {
            params.divisor = (map.width * map.height) as f32;
            let bindings = [("partials_in", partials), ("output", output)];
            let across = (2 * map.channels).div_ceil(64);
            let grid = Grid::Workgroups([across, 1, recording.batch()]);
            let dispatch = Dispatch::new(&SHADER, "finish", &params, &bindings, grid);
            recording.dispatch_maps(dispatch, input, output);
        }
        Ok(())
    }

    fn tolerance(
        &self,
        _op: &dyn Op,
        inputs: &[&Value],
        _reference: &[Value],
        _precision: Precision,
    ) -> Result<Option<Vec<Tolerance>>> {
        // A part of a row, the rows of a chunk, the eight parts, the chunks.
        let order = |height: usize, width: usize| {
            let [rows, chunks] = chunks(height);
            SumOrder::nested(width.div_ceil(8), [rows, 8, chunks])
        };
        ChannelPool::averaged(inputs, order).map(Some)
    }
}
