//! RoIAlign: features of each box on a grid of fixed size.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;
