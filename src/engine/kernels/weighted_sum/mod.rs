//! Weighted sum of maps.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;
