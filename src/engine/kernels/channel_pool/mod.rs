//! CBAM's pooling over space.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;
