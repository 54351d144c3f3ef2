//! The k highest scores and where they are.

use crate::engine::kernels::count::count_tensor;
use crate::engine::kernels::{Dispatch, Grid, Io, Plain, Recording, Work};
use crate::engine::ops::TopK;
use crate::engine::ops::top_k::layout;
use crate::engine::shader::{Shader, shader_params};
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        channels: u32,
        area: u32,
        k: u32,
        /// k rounded up to a power of two.
        sort_size: u32,
        /// Always 0: bounds that the compiler does not know keep it from unrolling loops.
        zero: u32,
    }
}

static SHADER: Shader =
    Shader { stem: "top_k", source: include_str!("../../../wgsl/top_k.wgsl"), params: PARAMS };

/// Pairs that the shader sorts in workgroup memory.
const MAX_K: usize = 1024;

/// Scores whose index fits in the shader's 24 bits.
const MAX_SCORES: usize = 1 << 24;

/// The definition.
pub(super) static PLANAR: Plain = Plain { id: "top_k/planar", shader: &SHADER, dispatch };

fn dispatch(work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<Dispatch> {
    let op: &TopK = work.op()?;
    best(op.k, recording, (inputs, outputs))
}

/// What finds the `most` best.
pub(super) fn best(
    most: usize,
    recording: &mut Recording,
    (inputs, outputs): Io,
) -> Result<Dispatch> {
    let n = recording.info(inputs[0]).spec.shape.elements();
    let (channels, area) = layout(recording.dims(inputs[0])).unwrap_or((1, n));
    let k = most.min(n);
    let limits = [("scores to sort (`k` of top_k)", k, MAX_K), ("scores", n, MAX_SCORES)];
    for (what, needed, available) in limits {
        if needed > available {
            return Err(Error::Capacity {
                what: what.into(),
                needed: needed as u64,
                available: available as u64,
            });
        }
    }
    let count = count_tensor(recording, inputs.get(1).copied(), n);
    let params = Params {
        channels: channels as u32,
        area: area as u32,
        k: k as u32,
        sort_size: k.next_power_of_two() as u32,
        zero: 0,
    };
    let bindings = [
        ("scores", inputs[0]),
        ("input_count", count),
        ("values", outputs[0]),
        ("indices", outputs[1]),
        ("output_count", outputs[2]),
    ];
    let grid = Grid::Workgroups([1, 1, 1]);
    Ok(Dispatch::new(&SHADER, "main", &params, &bindings, grid))
}
