//! Each operation's shader against its CPU reference, on poisoned and guarded buffers.

#[path = "support/mod.rs"]
mod support;

#[path = "ops/conv2d.rs"]
mod conv2d;
