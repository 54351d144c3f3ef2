//! On maps of four channels a texel.

use super::{SPAN, SPANS};
use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Recording, Work, layout, of_maps,
};
use crate::engine::ops::ApplyGates;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        map: layout::Quads,
        /// Quads of a workgroup.
        group_quads: u32,
        channel_gate_stride: u32,
        pooled_stride: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "apply_gates/quads",
    source: include_str!("../../../../wgsl/apply_gates/quads.wgsl"),
    params: PARAMS,
};

/// Workgroups that keep an adapter with many cores busy. Those that share pixels each compute their spatial gates.
const ENOUGH: u32 = 128;
/// The same of a software adapter.
const FEW: u32 = 4;

/// Workgroups for the pixels of a map.
fn tiles(map: &layout::Quads) -> u32 {
    (map.height * map.width.div_ceil(SPAN as u32)).div_ceil(SPANS)
}

/// Each workgroup computes the spatial gates of its pixels, and goes over some quads.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "apply_gates/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        of_maps(&SHADER)
    }

    fn fits(&self, work: &Work) -> bool {
        // Gates are read four at a time.
        let channels = work.inputs[0].shape.0[0];
        let map = work.quads(&work.inputs[0]);
        channels.is_multiple_of(4) && map.is_some_and(|map| tiles(&map) <= MAX_WORKGROUPS)
    }

    fn reads(&self, _work: &Work, index: usize) -> Layout {
        if index == 0 { Layout::Quads } else { Layout::Planar }
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let _op: &ApplyGates = work.op()?;
        let map = recording.quads(inputs[0])?;
        let tiles = tiles(&map);
        let enough = if work.caps.has_many_cores() { ENOUGH } else { FEW };
        let group_quads = map.quads.div_ceil(enough.div_ceil(tiles).min(map.quads));
        let params = Params {
            map,
            group_quads,
            channel_gate_stride: recording.stride(inputs[1]),
            pooled_stride: recording.stride(inputs[2]),
        };
        let bindings = work.bindings((inputs, outputs));
        let groups = map.quads.div_ceil(group_quads);
        let grid = Grid::Workgroups([tiles, groups, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch, inputs[0], outputs[0]);
        Ok(())
    }
}
