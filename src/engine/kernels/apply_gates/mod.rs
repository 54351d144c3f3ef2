//! CBAM's gating.

mod planar;
mod quads;

pub(super) use planar::PLANAR;
pub(super) use quads::Quads;

/// Pixels of a row that one invocation computes the spatial gates of.
const SPAN: usize = 8;
/// Invocations of a workgroup, and so its spans.
const SPANS: u32 = 64;
