//! Workgroups of an indirect dispatch from a count on the device.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::ops::{IndirectGrid, Op};
use crate::shader::{Shader, shader_params};
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
pub(super) static PLANAR: Plain = Plain { id: "indirect_grid/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, _: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &IndirectGrid = work.op()?;
    Ok(of(op, inputs[0], outputs[0]))
}

/// Records the grid for `count` in a tensor of its own.
pub(super) fn scratch(
    op: &IndirectGrid,
    recording: &mut Recording,
    count: TensorId,
) -> Result<TensorId> {
    op.infer(&[recording.info(count).spec.clone()])?;
    let grid = recording.scratch("grid", TensorSpec::u32([3]));
    recording.dispatch(of(op, count, grid));
    Ok(grid)
}

fn of(op: &IndirectGrid, count: TensorId, grid: TensorId) -> Dispatch {
    let params = Params {
        capacity: op.capacity as u32,
        items_per_count: op.items_per_count,
        workgroup_size: op.workgroup_size,
        layers: op.layers,
    };
    let bindings = [("count", count), ("grid", grid)];
    let one = Grid::Workgroups([1, 1, 1]);
    Dispatch::new(&SHADER, "main", &params, &bindings, one)
}
