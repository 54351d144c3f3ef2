//! What shaders with `wgsl/shared/over_space.wgsl` share.

use crate::engine::kernels::{Caps, all_texels};
use crate::engine::ops::bounds::SumOrder;
use crate::engine::shader::{Shader, Variant};

/// Rows that a workgroup goes over at a time, and its quads: many rows where there are many cores to keep busy.
fn rows_and_quads(caps: &Caps) -> [u32; 2] {
    if caps.has_many_cores() { [16, 1] } else { [4, 2] }
}

/// The variant for an adapter.
pub(super) fn variant(caps: &Caps) -> Variant {
    let [rows, quads] = rows_and_quads(caps);
    Variant::of(&[("ROWS", rows), ("QUADS", quads)])
}

/// A shader in all variants that an adapter may need.
pub(super) fn shaders(shader: &'static Shader, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
    all_texels(&variant(caps)).map(|variant| (shader, variant)).into()
}

/// Workgroups for so many quads.
pub(super) fn workgroups(quads: u32, caps: &Caps) -> u32 {
    quads.div_ceil(rows_and_quads(caps)[1])
}

/// The order of a sum over a map of this height and width, of whichever adapter: a part of a row, some of the rows,
/// eight such parts, those rows.
pub(super) fn order(height: usize, width: usize) -> SumOrder {
    SumOrder::nested(width.div_ceil(8), [height.div_ceil(4), 8, 16])
}
