//! What the tests share: the one device, and running an operation's cases.

use std::sync::{Arc, OnceLock};

use smr_gpu::gpu::{Gpu, GpuOptions};
use smr_gpu::ops::{self, check};

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
