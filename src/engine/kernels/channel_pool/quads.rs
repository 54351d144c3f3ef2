//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, over_space,
};
use crate::engine::ops::{ChannelPool, Op, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::tensor::Value;
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        /// Elements of a picture of the output.
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "channel_pool/quads",
    source: include_str!("../../../../wgsl/channel_pool/quads.wgsl"),
    params: PARAMS,
};

/// Each workgroup goes over four channels.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "channel_pool/quads"
    }

    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        over_space::shaders(&SHADER, caps)
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
        let map = recording.quads(inputs[0])?;
        let params = Params { map, output_stride: recording.stride(outputs[0]) };
        let bindings = [("input", inputs[0]), ("output", outputs[0])];
        let grid =
            Grid::Workgroups([over_space::workgroups(map.quads, work.caps), 1, recording.batch()]);
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
        ChannelPool::averaged(inputs, over_space::order).map(Some)
    }
}
