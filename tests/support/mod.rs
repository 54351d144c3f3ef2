//! What the tests share: the one device, and running an operation's cases.

use std::sync::{Arc, OnceLock};

use smr_gpu::gpu::{Gpu, GpuOptions, Recording, Role};
use smr_gpu::ops::{self, Op, check};
use smr_gpu::shape::TensorSpec;

/// The device that all tests of a process share; no adapter is a failure, never a skip.
pub fn gpu() -> &'static Arc<Gpu> {
    static DEVICE: OnceLock<Arc<Gpu>> = OnceLock::new();
    DEVICE.get_or_init(|| {
        pollster::block_on(Gpu::open(GpuOptions::default()))
            .expect("a Vulkan adapter; tests/run.sh installs one")
    })
}

/// Runs every case of the operation and reports all that fail.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn check_op(name: &str) {
    let entry = ops::find(name).expect("a registered operation");
    let cases = (entry.cases)();
    assert!(cases.iter().any(|c| c.by_hand.is_some()), "{name} has no case by hand");
    let mut failures = Vec::new();
    for case in &cases {
        match check(gpu(), case) {
            Ok(report) => failures.extend(report.failures),
            Err(e) => failures.push(format!("{} / {}: {e}", name, case.name)),
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// What an operation says to inputs that it must refuse.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn refusal(op: &dyn Op, inputs: &[TensorSpec]) -> String {
    op.infer(inputs).expect_err("an error").to_string()
}

/// What an operation says when it is recorded with inputs past its shader's capacity.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn recording_error(op: &dyn Op, inputs: &[TensorSpec]) -> String {
    let mut recording = Recording::default();
    let outputs = op.infer(inputs).expect("inputs that fit");
    let mut add = |specs: &[TensorSpec]| -> Vec<_> {
        specs.iter().map(|s| recording.tensor("tensor", s.clone(), Role::Transient)).collect()
    };
    let (inputs, outputs) = (add(inputs), add(&outputs));
    op.record(&mut recording, &inputs, &outputs).expect_err("an error").to_string()
}
