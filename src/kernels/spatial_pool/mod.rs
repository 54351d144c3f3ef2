//! CBAM's pooling over channels.

mod planar;
mod quads;

pub(super) use planar::Planar;
pub(super) use quads::Quads;
