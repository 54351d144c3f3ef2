//! CBAM's pooling over channels.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;
