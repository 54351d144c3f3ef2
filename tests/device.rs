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

/// After a time limit ran out the same plan runs again: nothing is left pending.
#[test]
fn a_time_limit_is_a_typed_error_and_leaves_the_plan_usable() {
    use smr_gpu::ops::case::random;
    use smr_gpu::ops::{Conv2d, Op};
    let run = |timeout| {
        let gpu = open(|o| o.timeout = timeout).expect("an adapter");
        let mut recording = Recording::default();
        let op = Conv2d { padding: 1, bias: false, ..Conv2d::default() };
        let input = recording.constant("input", random(1, [64, 80, 80]));
        let weight = recording.constant("weight", random(2, [64, 64, 3, 3]));
        let output = recording.tensor("output", TensorSpec::f32([64, 80, 80]), Role::Output);
        op.record(&mut recording, &[input, weight], &[output]).expect("a recording");
        let plan = Plan::new(&gpu, &recording, PlanOptions::default());
        let mut plan = pollster::block_on(plan).expect("a plan");
        [plan.run(&[]).map(|_| ()), plan.run(&[]).map(|_| ())]
    };
    for result in run(Duration::ZERO) {
        assert!(matches!(result, Err(Error::Timeout { .. })), "{result:?}");
    }
    for result in run(Duration::from_secs(60)) {
        result.expect("a run");
    }
}

/// One thread's wait may run another's callbacks: each thread must still get its own values, and
/// none may take a callback that another runs for a time limit that ran out.
#[test]
fn threads_share_a_device() {
    use smr_gpu::ops::{MaxPool2d, Op};
    use smr_gpu::shape::Extent;
    use smr_gpu::tensor::{Tensor, Value};
    const THREADS: usize = 8;
    const RUNS: usize = 200;
    let gpu = open(|_| ()).expect("an adapter");
    let thread = |index: usize| {
        let mut recording = Recording::default();
        let input =
            recording.tensor("input", TensorSpec::f32([1, 4, 4]), Role::Input(Extent::Exact));
        let output = recording.tensor("output", TensorSpec::f32([1, 2, 2]), Role::Output);
        let op = MaxPool2d { kernel: 2, stride: 2, padding: 0 };
        op.record(&mut recording, &[input], &[output]).expect("a recording");
        let plan = Plan::new(&gpu, &recording, PlanOptions::default());
        let mut plan = pollster::block_on(plan).expect("a plan");
        for run in 0..RUNS {
            let value = (index * RUNS + run) as f32;
            let given = Value::from(Tensor::from_fn([1, 4, 4], |_| value));
            let ran = plan.run(&[(input, &given)]).expect("a run");
            let pooled = Value::from(Tensor::from_fn([1, 2, 2], |_| value));
            assert_eq!(ran.values[&output], pooled, "thread {index}, run {run}");
        }
    };
    std::thread::scope(|scope| {
        for index in 0..THREADS {
            let thread = &thread;
            scope.spawn(move || thread(index));
        }
    });
}

/// Programs with an executor of their own move the future between threads.
#[test]
fn the_detector_and_its_future_can_be_sent() {
    fn sendable<T: Send>(value: T) -> T {
        value
    }
    fn shared<T: Send + Sync>() {}
    shared::<smr_gpu::GpuDetector>();
    drop(sendable(smr_gpu::GpuDetector::new_async(smr_gpu::Config::new("none"))));
}

#[test]
fn a_blank_name_is_part_of_no_adapters() {
    for blank in ["", " ", "\t\n"] {
        let name = AdapterChoice::Name(blank.into());
        let error = open(|options| options.adapter = name).expect_err("no adapter");
        // It names what there is, each with its index.
        let Error::NoAdapter { found, .. } = &error else { panic!("{error}") };
        assert!(found.starts_with("found 0: "), "{found}");
    }
}
