//! On maps of four channels a texel.

use bytemuck::Zeroable;

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Recording, Work, layout, over_space,
    repeated,
};
use crate::engine::ops::global_avg_pool::MAPS;
use crate::engine::ops::{GlobalAvgPool, Op, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::tensor::Value;
use crate::error::Result;

shader_params! {
    struct Params {
        maps: [layout::Quads; MAPS.len()],
        used: u32,
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "global_avg_pool/quads",
    source: include_str!("../../../../wgsl/global_avg_pool/quads.wgsl"),
    params: PARAMS,
};

/// Each workgroup goes over four channels.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "global_avg_pool/quads"
    }

    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        over_space::shaders(&SHADER, caps)
    }

    fn fits(&self, work: &Work) -> bool {
        // A grid has so many quads on a side.
        let quads = work.inputs.iter().map(|map| work.quads(map).map(|map| map.quads));
        quads.sum::<Option<u32>>().is_some_and(|quads| quads <= MAX_WORKGROUPS)
    }

    fn reads(&self, _work: &Work, _index: usize) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &GlobalAvgPool = work.op()?;
        let mut params = Params::zeroed();
        params.used = inputs.len() as u32;
        params.output_stride = recording.stride(outputs[0]);
        let mut quads = 0;
        for (map, input) in params.maps.iter_mut().zip(inputs) {
            *map = recording.quads(*input)?;
            quads += map.quads;
        }
        let bindings: Vec<_> = repeated(MAPS, inputs).chain([("output", outputs[0])]).collect();
        let grid =
            Grid::Workgroups([over_space::workgroups(quads, work.caps), 1, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        let dispatch = dispatch.variant(over_space::variant(work.caps));
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }

    fn tolerance(
        &self,
        _op: &dyn Op,
        inputs: &[&Value],
        _reference: &[Value],
        _precision: Precision,
    ) -> Result<Option<Vec<Tolerance>>> {
        GlobalAvgPool::averaged(inputs, over_space::order).map(Some)
    }
}
