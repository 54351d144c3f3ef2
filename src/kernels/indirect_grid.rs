//! Workgroups of an indirect dispatch from a count on the device.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::{IndirectGrid, Op};
use crate::shader::{Shader, Variant, shader_params};
use crate::shape::TensorSpec;

shader_params! {
    struct Params {
        capacity: u32,
        items_per_count: u32,
        workgroup_size: u32,
        layers: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "indirect_grid",
    source: include_str!("../../wgsl/indirect_grid.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "indirect_grid/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(
        &self,
        work: &Work,
        recording: &mut Recording,
        inputs: &[TensorId],
        outputs: &[TensorId],
    ) -> Result<()> {
        record(work.op()?, recording, inputs[0], outputs[0]);
        Ok(())
    }
}

/// Records the grid for `count` in a tensor of its own.
pub(super) fn scratch(
    op: &IndirectGrid,
    recording: &mut Recording,
    count: TensorId,
) -> Result<TensorId> {
    op.infer(&[recording.info(count).spec.clone()])?;
    let grid = recording.scratch("grid", TensorSpec::u32([3]));
    record(op, recording, count, grid);
    Ok(grid)
}

fn record(op: &IndirectGrid, recording: &mut Recording, count: TensorId, grid: TensorId) {
    let params = Params {
        capacity: op.capacity as u32,
        items_per_count: op.items_per_count,
        workgroup_size: op.workgroup_size,
        layers: op.layers,
    };
    let bindings = [("count", count), ("grid", grid)];
    let one = Grid::Workgroups([1, 1, 1]);
    recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, one));
}
