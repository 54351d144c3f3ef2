//! On maps of four channels a texel.

use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Recording, Work, all_texels,
};
use crate::engine::ops::WeightedSum;
use crate::engine::ops::weighted_sum::MAPS;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        /// Texels of a picture.
        texels: u32,
        weight_stride: u32,
        /// Invocations of a picture.
        invocations: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "weighted_sum/quads",
    source: include_str!("../../../../wgsl/weighted_sum/quads.wgsl"),
    params: PARAMS,
};

/// Texels of an invocation.
const TEXELS: u32 = 4;

/// The shader for so many maps.
fn variant(maps: usize) -> Variant {
    let flags = ["MAP1", "MAP2", "MAP3", "MAP4"].into_iter().take(maps - 1);
    Variant { flags: flags.collect(), ..Variant::default() }
}

/// Texel by texel, wherever they lie.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Quads;

impl Kernel for Quads {
    fn id(&self) -> &'static str {
        "weighted_sum/quads"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        let all = (1..=MAPS.len()).flat_map(|maps| all_texels(&variant(maps)));
        all.map(|variant| (&SHADER, variant)).collect()
    }

    fn fits(&self, work: &Work) -> bool {
        work.has_quads(&work.outputs[0])
    }

    fn reads(&self, _work: &Work, index: usize) -> Layout {
        if index == 0 { Layout::Planar } else { Layout::Quads }
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &WeightedSum = work.op()?;
        let texels = recording.quads(outputs[0])?.texels() as u32;
        let groups = texels.div_ceil(TEXELS * 64).min(MAX_WORKGROUPS);
        let weight_stride = recording.stride(inputs[0]);
        let params = Params { texels, weight_stride, invocations: groups * 64 };
        let maps = MAPS.into_iter().zip(inputs[1..].iter().copied());
        let ends = [("weights", inputs[0]), ("output", outputs[0])];
        let bindings: Vec<_> = ends.into_iter().chain(maps).collect();
        let grid = Grid::Workgroups([groups, 1, recording.batch()]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        recording.dispatch_maps(dispatch.variant(variant(op.maps)), inputs[1], outputs[0]);
        Ok(())
    }
}
