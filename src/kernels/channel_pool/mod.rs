//! CBAM's pooling over space.

mod planar;
mod quads;

pub(super) use planar::Planar;
pub(super) use quads::Quads;
