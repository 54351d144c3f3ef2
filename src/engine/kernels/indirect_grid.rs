//! Workgroups of indirect dispatches from a count on the device.

use bytemuck::Zeroable;

use crate::engine::graph::TensorId;
use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::IndirectGrid;
use crate::engine::shader::{Shader, shader_params, shader_struct};
use crate::error::Result;

shader_struct! {
    struct Rule {
        capacity: u32,
        items_per_count: u32,
        workgroup_size: u32,
        layers: u32,
    }
}

shader_params! {
    struct Params {
        rules: [Rule; MOST],
        used: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "indirect_grid",
    source: include_str!("../../../wgsl/indirect_grid.wgsl"),
    params: PARAMS,
};

/// Grids that one dispatch computes.
pub(crate) const MOST: usize = 16;

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "indirect_grid/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, _: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &IndirectGrid = work.op()?;
    Ok(table(&[*op], inputs[0], outputs[0]))
}

/// Writes the grid of each of at most [`MOST`] `rules` for `count` to a row of `grids`.
pub(crate) fn table(rules: &[IndirectGrid], count: TensorId, grids: TensorId) -> Dispatch {
    let mut params = Params::zeroed();
    params.used = rules.len() as u32;
    for (to, rule) in params.rules.iter_mut().zip(rules) {
        let IndirectGrid { capacity, items_per_count, workgroup_size, layers } = *rule;
        *to = Rule { capacity: capacity as u32, items_per_count, workgroup_size, layers };
    }
    let bindings = [("count", count), ("grids", grids)];
    Dispatch::new(&SHADER, "main", &params, &bindings, Grid::Workgroups([1, 1, 1]))
}
