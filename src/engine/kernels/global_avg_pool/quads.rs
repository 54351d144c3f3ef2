//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, of_maps,
};
use crate::engine::ops::bounds::SumOrder;
use crate::engine::ops::{GlobalAvgPool, Op, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::tensor::Value;
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        first: u32,
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "global_avg_pool/quads",
    source: include_str!("../../../../wgsl/global_avg_pool/quads.wgsl"),
    params: PARAMS,
};

/// Each workgroup goes over 32 channels.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "global_avg_pool/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        work.inputs.iter().all(|map| work.has_quads(map))
    }

    fn reads(&self, _work: &Work, _index: usize) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &GlobalAvgPool = work.op()?;
        let mut first = 0;
        for input in inputs {
            let map = recording.quads(*input)?;
            let output_stride = recording.stride(outputs[0]);
            let params = Params { map, first, output_stride };
            let bindings = [("input", *input), ("output", outputs[0])];
            let grid = Grid::Workgroups([1, map.quads.div_ceil(8), recording.batch()]);
            let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
            recording.dispatch_maps(dispatch, *input, outputs[0]);
            first += map.channels;
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
        // A part of a row, the rows, the eight parts.
        let order =
            |height: usize, width: usize| SumOrder::nested(width.div_ceil(8), [height, 8, 1]);
        GlobalAvgPool::averaged(inputs, order).map(Some)
    }
}
