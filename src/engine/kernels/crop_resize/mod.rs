//! A part of a picture, resized and normalised.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;
