//! Average pooling over all of space.

mod planar;
mod quads;

pub(super) use planar::Planar;
pub(super) use quads::Quads;
