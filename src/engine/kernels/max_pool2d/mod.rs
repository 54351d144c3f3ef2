//! 2-D maximum pooling.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;
