//! What the device must survive or report: its loss, a time limit, sizes past its limits.

use std::time::Duration;

use smr_gpu::Error;
use smr_gpu::gpu::{AdapterChoice, Gpu, GpuOptions, Plan, PlanOptions, Recording, Role};
use smr_gpu::shape::TensorSpec;

fn open(change: impl FnOnce(&mut GpuOptions)) -> smr_gpu::Result<std::sync::Arc<Gpu>> {
    let mut options = GpuOptions::default();
    change(&mut options);
    pollster::block_on(Gpu::open(options))
}

#[test]
fn a_lost_device_is_a_typed_error() {
    let gpu = open(|_| ()).expect("an adapter");
    let mut recording = Recording::default();
    recording.tensor("output", TensorSpec::f32([4]), Role::Output);
    let mut plan =
        pollster::block_on(Plan::new(&gpu, &recording, PlanOptions::default())).expect("a plan");
    plan.run(&[]).expect("a run while the device lives");
    gpu.destroy();
    let result = plan.run(&[]);
    assert!(matches!(result, Err(Error::DeviceLost(_))), "{result:?}");
    let again = pollster::block_on(Plan::new(&gpu, &recording, PlanOptions::default()));
    assert!(matches!(again, Err(Error::DeviceLost(_))), "{again:?}");
}

#[test]
fn an_adapter_that_is_not_there_is_named() {
    for choice in [AdapterChoice::Index(99), AdapterChoice::Name("no such adapter".into())] {
        let message = open(|o| o.adapter = choice.clone()).expect_err("no adapter").to_string();
        assert!(message.contains(&choice.to_string()) && message.contains("found"), "{message}");
    }
}

#[test]
fn a_tensor_past_the_binding_limit_is_refused() {
    let gpu = open(|o| o.timeout = Duration::from_secs(30)).expect("an adapter");
    let mut recording = Recording::default();
    recording.tensor("too large", TensorSpec::f32([64 * 1024 * 1024]), Role::Output);
    let result = pollster::block_on(Plan::new(&gpu, &recording, PlanOptions::default()));
    match result {
        Err(Error::Capacity { needed, available, what }) => {
            assert_eq!(needed, 256 * 1024 * 1024);
            assert_eq!(available, 128 * 1024 * 1024);
            assert!(what.contains("too large"), "{what}");
        }
        other => panic!("{other:?}"),
    }
}
