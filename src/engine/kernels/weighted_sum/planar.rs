//! The definition, on planar maps.

use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::WeightedSum;
use crate::engine::ops::weighted_sum::MAPS;
use crate::engine::shader::{Shader, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        elements: u32,
        maps: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "weighted_sum/planar",
    source: include_str!("../../../../wgsl/weighted_sum/planar.wgsl"),
    params: PARAMS,
};

/// The definition, on planar maps.
pub(in crate::engine::kernels) static PLANAR: Plain =
    Plain { id: "weighted_sum/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &WeightedSum = work.op()?;
    let elements = recording.info(outputs[0]).spec.shape.elements();
    let params = Params { elements: elements as u32, maps: op.maps as u32 };
    let mut bindings = vec![("weights", inputs[0])];
    for (k, name) in MAPS.into_iter().enumerate() {
        // Any readable buffer serves behind the last map: it is not read.
        bindings.push((name, *inputs.get(k + 1).unwrap_or(&inputs[1])));
    }
    bindings.push(("output", outputs[0]));
    let grid = Grid::linear(elements, 64);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
