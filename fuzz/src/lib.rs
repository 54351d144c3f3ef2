//! What is tried with untrusted bytes. Each target is a function of bytes that panics
//! if something is wrong; `cargo fuzz` calls it, and so does `tests/fuzz.rs` without nightly.

pub mod annotations;
pub mod ops;
pub mod pictures;
pub mod sensors;
pub mod streams;
pub mod tables;
pub mod tuned;
pub mod weights;
