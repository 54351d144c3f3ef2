//! The operations: for each, its parameters, shape check, dispatches, reference and error bound.
//!
//! One operation is one stem in four places: `wgsl/<op>.wgsl`, `src/ops/<op>.rs`,
//! `src/cpu/<op>.rs` and `tests/ops/<op>.rs`.

pub mod case;
pub mod op;
pub mod params;

mod conv2d;

pub use case::{Case, Report, check};
pub use conv2d::Conv2d;
pub use op::{Entry, Op, Tolerance};
pub use params::Params;

/// Every operation, by name.
pub static OPS: &[&Entry] = &[&conv2d::ENTRY];

/// The operation called `name`.
pub fn find(name: &str) -> Option<&'static Entry> {
    OPS.iter().copied().find(|e| e.name == name)
}
