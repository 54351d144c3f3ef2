//! Each operation's shader against its CPU reference, on poisoned and guarded buffers.

#[path = "support/mod.rs"]
mod support;

#[path = "ops/apply_gates.rs"]
mod apply_gates;
#[path = "ops/box_voting.rs"]
mod box_voting;
#[path = "ops/channel_gate.rs"]
mod channel_gate;
#[path = "ops/channel_pool.rs"]
mod channel_pool;
#[path = "ops/contact_map.rs"]
mod contact_map;
#[path = "ops/conv2d.rs"]
mod conv2d;
#[path = "ops/crop_resize.rs"]
mod crop_resize;
#[path = "ops/decode_detections.rs"]
mod decode_detections;
#[path = "ops/decode_pose.rs"]
mod decode_pose;
#[path = "ops/decode_proposals.rs"]
mod decode_proposals;
#[path = "ops/gather_rows.rs"]
mod gather_rows;
#[path = "ops/global_avg_pool.rs"]
mod global_avg_pool;
#[path = "ops/indirect_grid.rs"]
mod indirect_grid;
#[path = "ops/linear.rs"]
mod linear;
#[path = "ops/max_pool2d.rs"]
mod max_pool2d;
#[path = "ops/nms.rs"]
mod nms;
#[path = "ops/not_finite.rs"]
mod not_finite;
#[path = "ops/roi_align.rs"]
mod roi_align;
#[path = "ops/softmax.rs"]
mod softmax;
#[path = "ops/spatial_pool.rs"]
mod spatial_pool;
#[path = "ops/top_k.rs"]
mod top_k;
#[path = "ops/upsample_bilinear.rs"]
mod upsample_bilinear;
#[path = "ops/weighted_sum.rs"]
mod weighted_sum;

/// Runs the cases with outputs by hand on a device.
fn run_by_hand(gpu: &std::sync::Arc<smr_gpu::engine::gpu::Gpu>) {
    for entry in smr_gpu::engine::ops::OPS {
        support::check_cases(gpu, entry.name, |case| case.by_hand.is_some());
    }
}

/// The cases with outputs by hand alone: `tests/run.sh quick` runs these.
#[test]
fn cases_by_hand() {
    run_by_hand(support::gpu());
}

/// As compilers read the shaders that know how long loops are: this adapter's does not, if it is lavapipe.
#[test]
fn loops_of_known_length_keep_the_bounds() {
    use smr_gpu::engine::shader::Replacement;
    let text = "fn bound(n: u32, zero: u32) -> u32 { return n; }\n".into();
    let seen = Replacement { file: "shared/bound".into(), text };
    run_by_hand(&support::gpu().with_replacement(seen));
}

/// Bounds checks may change no bit, so that what the tests find with them holds without.
#[test]
fn bounds_checks_change_no_bit() {
    use smr_gpu::engine::gpu::{Gpu, GpuOptions};
    use smr_gpu::engine::ops::OPS;
    use smr_gpu::verify::check::run_each;
    let options = GpuOptions { bounds_checks: true, ..GpuOptions::default() };
    let bounds_checks = pollster::block_on(Gpu::open(options)).expect("an adapter");
    let mut different = Vec::new();
    for case in OPS.iter().flat_map(|entry| (entry.cases)()) {
        let inputs: Vec<_> = case.inputs.iter().collect();
        let run = |gpu| run_each(gpu, &case).expect("a run");
        let (with, without) = (run(&bounds_checks), run(support::gpu()));
        assert_eq!(with.len(), without.len(), "{}: the kernels that fit", case.name);
        for ((kernel, with), (_, without)) in with.iter().zip(&without) {
            let defined = case.op.defined(&without.iter().collect::<Vec<_>>(), &inputs);
            for ((a, b), n) in with.iter().zip(without).zip(defined) {
                if a.bytes()[..4 * n] != b.bytes()[..4 * n] {
                    different.push(format!("{kernel} / {}", case.name));
                }
            }
        }
    }
    assert!(different.is_empty(), "{}", different.join("\n"));
}

#[cfg(feature = "cpu")]
#[test]
fn every_case_is_within_its_bound_on_cores() {
    use smr_gpu::engine::ops::OPS;
    use smr_gpu::verify::check::{Selection, Target, rows};
    let of = |entry| rows(&Target::Cpu, entry, &Selection::default()).expect("legal cases");
    let rows = OPS.iter().flat_map(|entry| of(entry));
    let failures: Vec<String> = rows.flat_map(|row| row.failures).collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
