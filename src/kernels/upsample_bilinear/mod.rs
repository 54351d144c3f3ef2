//! Bilinear interpolation to another size.

mod planar;
mod quads;

pub(super) use planar::Planar;
pub(super) use quads::Quads;
