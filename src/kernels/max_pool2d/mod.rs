//! 2-D maximum pooling.

mod planar;
mod quads;

pub(super) use planar::Planar;
pub(super) use quads::Quads;
