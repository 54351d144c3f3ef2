//! What the tests share: the one device, and running an operation's cases.

use std::sync::{Arc, OnceLock};

use smr_gpu::Precision;
use smr_gpu::engine::gpu::{Gpu, GpuOptions};
use smr_gpu::engine::graph::Graph;
use smr_gpu::engine::kernels::Caps;
use smr_gpu::engine::lower::{KernelChoice, Request, lower};
use smr_gpu::engine::ops::{self, Case, Op};
use smr_gpu::engine::shape::{Extent, TensorSpec};
use smr_gpu::verify::check::{Selection, Target, rows_of};

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
    check_cases(gpu(), name, |_| true);
}

/// [`check_op`] of the `wanted` cases on an adapter.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn check_cases(gpu: &Arc<Gpu>, name: &str, wanted: impl Fn(&Case) -> bool) {
    let entry = ops::find(name).expect("a registered operation");
    let cases: Vec<Case> = (entry.cases)().into_iter().filter(wanted).collect();
    assert!(cases.iter().any(|c| c.by_hand.is_some()), "{name} has no case by hand");
    let target = Target::Gpu(gpu.clone());
    let rows = pollster::block_on(rows_of(&target, entry.name, &cases, &Selection::default()));
    let rows = rows.expect("a device that stays");
    assert!(rows.iter().any(|row| row.cases == cases.len()), "{name}: a case ran nowhere");
    let failures: Vec<String> = rows.into_iter().flat_map(|row| row.failures).collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// What an operation says to inputs that it must refuse.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn refusal(op: &dyn Op, inputs: &[TensorSpec]) -> String {
    op.infer(inputs).expect_err("an error").to_string()
}

/// What comes of recording an operation on inputs that are known for each run alone.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn record(op: impl Op + 'static, inputs: &[TensorSpec]) -> smr_gpu::Result<()> {
    let mut graph = Graph::default();
    let ids = inputs.iter().map(|s| graph.input("tensor", s.clone(), Extent::Exact));
    let ids: Vec<_> = ids.collect();
    let outputs = graph.apply("op", op, &ids).expect("inputs that fit");
    outputs.iter().for_each(|id| graph.mark_output(*id));
    let (caps, kernels) = (Caps::default(), KernelChoice::default());
    lower(
        &graph,
        &Request { keep: &[], batch: 1, precision: Precision::F32, caps: &caps, kernels: &kernels },
    )
    .map(|_| ())
}

/// What an operation says when it is recorded with inputs past its shader's capacity.
#[allow(dead_code, reason = "not every test crate runs operations")]
pub fn recording_error(op: impl Op + 'static, inputs: &[TensorSpec]) -> String {
    record(op, inputs).expect_err("an error").to_string()
}
