//! What an adapter does at best: no operation, but the measure of all.

use crate::engine::kernels::{Dispatch, Grid, Recording, Role};
use crate::engine::shader::{Shader, shader_params};
use crate::engine::shape::TensorSpec;

shader_params! {
    struct Params {
        rounds: u32,
        factor: f32,
        texels: u32,
        pad: u32,
    }
}

pub(super) static SHADER: Shader =
    Shader { stem: "roof", source: include_str!("../../../wgsl/roof.wgsl"), params: PARAMS };

/// Invocations that multiply, in workgroups of 64.
const INVOCATIONS: u32 = 1 << 14;
/// Rounds of each, of sixteen multiply-adds.
const ROUNDS: u32 = 1024;
/// Texels of 16 bytes that are copied: more than a cache holds.
const TEXELS: u32 = 4 << 20;

/// Multiply-adds of the first dispatch.
pub(crate) const MULTIPLY_ADDS: f64 = INVOCATIONS as f64 * ROUNDS as f64 * 16.0;
/// Bytes that the second reads and writes.
pub(crate) const BYTES: f64 = TEXELS as f64 * 32.0;

/// Appends two dispatches: multiply-adds in registers, and a copy.
pub(crate) fn record(recording: &mut Recording) {
    let sums = recording.tensor("sums", TensorSpec::f32([INVOCATIONS as usize]), Role::Transient);
    let texels = TensorSpec::f32([TEXELS as usize, 4]);
    let [read, written] =
        ["texels_in", "texels_out"].map(|n| recording.tensor(n, texels.clone(), Role::Transient));
    let params = Params { rounds: ROUNDS, factor: 0.999, texels: TEXELS, pad: 0 };
    let grid = Grid::Workgroups([INVOCATIONS / 64, 1, 1]);
    let sums = [("sums", sums)];
    recording.dispatch(Dispatch::new(&SHADER, "multiply_add", &params, &sums, grid));
    let copied = [("texels_in", read), ("texels_out", written)];
    let grid = Grid::linear(TEXELS as usize, 64);
    recording.dispatch(Dispatch::new(&SHADER, "copy", &params, &copied, grid));
}
