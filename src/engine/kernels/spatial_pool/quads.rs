//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, Recording, Work, layout, of_maps,
};
use crate::engine::ops::bounds::SumOrder;
use crate::engine::ops::{Op, SpatialPool, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::tensor::Value;
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        /// log2 of the slices of the channels, at most 3.
        slice_bits: u32,
        slice_quads: u32,
        gate_stride: u32,
        /// Elements of a picture of the output.
        output_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "spatial_pool/quads",
    source: include_str!("../../../../wgsl/spatial_pool/quads.wgsl"),
    params: PARAMS,
};

/// Invocations that share a pixel's channels: 1, 2, 4 or 8, with 16 quads each at least.
fn slices(quads: u32) -> u32 {
    1 << (quads / 16).max(1).ilog2().min(3)
}

/// Some invocations share the channels of a pixel where they are many.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "spatial_pool/quads"
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

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &SpatialPool = work.op()?;
        let map = recording.quads(inputs[0])?;
        let slices = slices(map.quads);
        let params = Params {
            map,
            slice_bits: slices.ilog2(),
            slice_quads: map.quads.div_ceil(slices),
            gate_stride: recording.stride(inputs[1]),
            output_stride: recording.stride(outputs[0]),
        };
        let bindings = [("input", inputs[0]), ("channel_gate", inputs[1]), ("output", outputs[0])];
        let [across, down] = [map.width.div_ceil(16), map.height.div_ceil(8 / slices)];
        let grid = Grid::Workgroups([across, down, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
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
        // The quads of a slice, the four of a quad, the slices.
        let order = |channels: usize| {
            let quads = channels.div_ceil(4) as u32;
            let slices = slices(quads);
            let [slice_quads, slices] = [quads.div_ceil(slices), slices].map(|n| n as usize);
            SumOrder::nested(slice_quads, [4, slices, 1])
        };
        SpatialPool::averaged(inputs, order).map(Some)
    }
}
