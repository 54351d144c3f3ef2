//! What the device must survive or report: its loss, a time limit, sizes past its limits.

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Waker};
use std::time::Duration;

use smr_gpu::engine::gpu::{AdapterChoice, Deadline, Gpu, GpuOptions, ProgramOptions, Slot, wgpu};
use smr_gpu::engine::graph::{Graph, TensorId};
use smr_gpu::engine::ops::case::random;
use smr_gpu::engine::ops::{Conv2d, MaxPool2d};
use smr_gpu::engine::shape::{Extent, TensorSpec};
use smr_gpu::engine::tensor::{Tensor, Value};
use smr_gpu::{Device, Error};

fn open(change: impl FnOnce(&mut GpuOptions)) -> smr_gpu::Result<std::sync::Arc<Gpu>> {
    let mut options = GpuOptions::default();
    change(&mut options);
    pollster::block_on(Gpu::open(options))
}

/// Pools a map `[1, 4, 4]` to `[1, 2, 2]`.
fn pooling() -> (Graph, TensorId, TensorId) {
    let mut graph = Graph::default();
    let input = graph.input("input", TensorSpec::f32([1, 4, 4]), Extent::Exact);
    let op = MaxPool2d { kernel: 2, stride: 2, padding: 0 };
    let output = graph.apply1("pool", op, &[input]).expect("a map");
    graph.mark_output(output);
    (graph, input, output)
}

fn slot(gpu: &std::sync::Arc<Gpu>, graph: &Graph) -> smr_gpu::Result<Slot> {
    pollster::block_on(Slot::of(gpu, graph, &[], ProgramOptions::default()))
}

#[test]
fn a_lost_device_is_a_typed_error() {
    let gpu = open(|_| ()).expect("an adapter");
    let (graph, input, _) = pooling();
    let value = Value::from(Tensor::<f32>::zeros([1, 4, 4]));
    let mut running = slot(&gpu, &graph).expect("a slot");
    running.run(&[(input, &value)]).expect("a run while the device lives");
    gpu.destroy();
    let result = running.run(&[(input, &value)]);
    assert!(matches!(result, Err(Error::DeviceLost(_))), "{result:?}");
    let again = slot(&gpu, &graph);
    assert!(matches!(again, Err(Error::DeviceLost(_))), "{again:?}");
}

/// A keyword in any case; a number is an index, and of no other use.
#[test]
fn a_device_is_read_as_it_is_meant() {
    let of = |text: &str| text.parse::<Device>();
    for (text, device) in [("CPU", Device::Cpu), ("Auto", Device::Auto), (" cpu ", Device::Cpu)] {
        assert_eq!(of(text).expect("a device"), device, "{text}");
    }
    assert_eq!(of("GPU").expect("a device"), Device::Gpu(AdapterChoice::Auto));
    assert_eq!(of("Reference").expect("a device"), Device::Reference);
    for (text, index) in [("7", 7), ("007", 7), (" 4090 ", 4090)] {
        assert_eq!(of(text).expect("an index"), Device::Gpu(AdapterChoice::Index(index)), "{text}");
    }
    for name in ["RTX 4090", "4090 D", "7x"] {
        assert_eq!(of(name).expect("a name"), Device::Gpu(AdapterChoice::Name(name.into())));
    }
    for wrong in ["", " ", "-1", "-", "99999999999999999999999"] {
        let message = of(wrong).expect_err("no device").to_string();
        assert!(message.contains("an adapter's index") && message.contains(wrong), "{message}");
    }
}

#[test]
fn an_adapter_that_is_not_there_is_named() {
    // Most names of adapters have a digit.
    let indices = (90..100).map(AdapterChoice::Index);
    for choice in indices.chain([AdapterChoice::Name("no such adapter".into())]) {
        let message = open(|o| o.adapter = choice.clone()).expect_err("no adapter").to_string();
        assert!(message.contains(&choice.to_string()) && message.contains("found"), "{message}");
    }
}

#[test]
fn a_tensor_past_the_binding_limit_is_refused() {
    let gpu = open(|o| o.timeout = Duration::from_secs(30)).expect("an adapter");
    let mut graph = Graph::default();
    let input = graph.input("too large", TensorSpec::f32([1, 8192, 8192]), Extent::Exact);
    let op = MaxPool2d { kernel: 2, stride: 2, padding: 0 };
    let output = graph.apply1("pool", op, &[input]).expect("a map");
    graph.mark_output(output);
    match slot(&gpu, &graph) {
        Err(Error::Capacity { needed, available, what }) => {
            assert_eq!(needed, 256 * 1024 * 1024);
            assert_eq!(available, 128 * 1024 * 1024);
            assert!(what.contains("too large"), "{what}");
        }
        other => panic!("{other:?}"),
    }
}

const LONG: Duration = Duration::from_secs(60);

/// A slot of a convolution that takes a device some milliseconds, with a time limit.
fn convolution(timeout: Duration) -> Slot {
    let gpu = open(|o| o.timeout = timeout).expect("an adapter");
    let mut graph = Graph::default();
    let op = Conv2d { padding: 1, bias: false, ..Conv2d::default() };
    let input = graph.constant("input", random(1, [64, 80, 80]));
    let weight = graph.constant("weight", random(2, [64, 64, 3, 3]));
    let output = graph.apply1("conv", op, &[input, weight]).expect("a map");
    graph.mark_output(output);
    slot(&gpu, &graph).expect("a slot")
}

/// After a time limit ran out the same slot runs again: nothing is left pending.
#[test]
fn a_time_limit_is_a_typed_error_and_leaves_the_slot_usable() {
    let mut hurried = convolution(Duration::ZERO);
    for result in [hurried.run(&[]), hurried.run(&[])] {
        assert!(matches!(result, Err(Error::Timeout { .. })), "{result:?}");
    }
    let mut slot = convolution(LONG);
    pollster::block_on(slot.submit(&[&[]])).expect("a submission");
    let result = pollster::block_on(slot.receive(Deadline::after(Duration::ZERO)));
    assert!(matches!(result, Err(Error::Timeout { .. })), "{result:?}");
    slot.run(&[]).expect("a run");
}

/// Who drops the future of a run leaves its slot busy until the device is done, not free with a buffer that
/// is still to be mapped.
#[test]
fn a_run_that_is_given_up_is_waited_for() {
    let mut slot = convolution(LONG);
    pollster::block_on(slot.submit(&[&[]])).expect("a submission");
    let mut given_up = Box::pin(slot.receive(Deadline::after(LONG)));
    let polled = given_up.as_mut().poll(&mut Context::from_waker(Waker::noop()));
    assert!(polled.is_pending());
    drop(given_up);
    assert!(pollster::block_on(slot.submit(&[&[]])).is_err(), "the run is under way");
    slot.run(&[]).expect("a run");
}

/// One thread's wait may run another's callbacks: each thread must still get its own values, and
/// none may take a callback that another runs for a time limit that ran out.
#[test]
fn threads_share_a_device() {
    const THREADS: usize = 8;
    const RUNS: usize = 200;
    let gpu = open(|_| ()).expect("an adapter");
    let thread = |index: usize| {
        let (graph, input, output) = pooling();
        let mut slot = slot(&gpu, &graph).expect("a slot");
        for run in 0..RUNS {
            let value = (index * RUNS + run) as f32;
            let given = Value::from(Tensor::from_fn([1, 4, 4], |_| value));
            let ran = slot.run(&[(input, &given)]).expect("a run").first();
            let pooled = Value::from(Tensor::from_fn([1, 2, 2], |_| value));
            assert_eq!(ran[&output], pooled, "thread {index}, run {run}");
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

/// A device as a program of its own opens it.
fn foreign(limits: wgpu::Limits) -> (wgpu::Device, wgpu::Queue) {
    let mut desc = wgpu::InstanceDescriptor::new_without_display_handle();
    desc.backends = wgpu::Backends::PRIMARY;
    pollster::block_on(async {
        let instance = wgpu::Instance::new(desc);
        let found = instance.enumerate_adapters(wgpu::Backends::PRIMARY).await;
        let adapter = found.first().expect("an adapter");
        let descriptor =
            wgpu::DeviceDescriptor { required_limits: limits, ..wgpu::DeviceDescriptor::default() };
        adapter.request_device(&descriptor).await.expect("a device")
    })
}

/// A program's own device runs what ours runs; its handlers hear of its own errors and of its loss, and
/// of nothing of ours.
#[test]
fn a_programs_own_device_keeps_its_handlers() {
    let (device, queue) = foreign(wgpu::Limits::default());
    let [errors, losses] = [0; 2].map(|_| Arc::new(AtomicUsize::new(0)));
    let heard = errors.clone();
    device.on_uncaptured_error(Arc::new(move |_| {
        heard.fetch_add(1, Ordering::SeqCst);
    }));
    let heard = losses.clone();
    device.set_device_lost_callback(move |_, _| {
        heard.fetch_add(1, Ordering::SeqCst);
    });
    let gpu = Gpu::from_device(device.clone(), queue, Duration::from_secs(60)).expect("a GPU");
    let (graph, input, output) = pooling();
    let given = Value::from(Tensor::from_fn([1, 4, 4], |i| i as f32));
    let mut running = slot(&gpu, &graph).expect("a slot");
    let ran = running.run(&[(input, &given)]).expect("a run").first();
    let pooled = Value::from(Tensor::from_fn([1, 2, 2], |i| [5.0, 7.0, 13.0, 15.0][i]));
    assert_eq!(ran[&output], pooled);
    assert_eq!(errors.load(Ordering::SeqCst), 0);
    // The program's own mistake.
    let _ = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: 4,
        usage: wgpu::BufferUsages::empty(),
        mapped_at_creation: false,
    });
    assert_eq!(errors.load(Ordering::SeqCst), 1);
    running.run(&[(input, &given)]).expect("a run after a mistake that is none of its own");
    // Nobody tells us of its loss.
    device.destroy();
    for _ in 0..2 {
        let result = running.run(&[(input, &given)]);
        assert!(matches!(result, Err(Error::DeviceLost(_))), "{result:?}");
    }
    let again = slot(&gpu, &graph);
    assert!(matches!(again, Err(Error::DeviceLost(_))), "{again:?}");
    let _ = device.poll(wgpu::PollType::Poll);
    assert_eq!([errors, losses].map(|n| n.load(Ordering::SeqCst)), [1, 1]);
}

#[test]
fn a_programs_own_device_must_have_what_the_kernels_use() {
    let limits =
        wgpu::Limits { max_storage_buffers_per_shader_stage: 2, ..wgpu::Limits::default() };
    let (device, queue) = foreign(limits);
    match Gpu::from_device(device, queue, Duration::from_secs(1)) {
        Err(Error::Device { message, .. }) => {
            let start = "max_storage_buffers_per_shader_stage: required ";
            assert!(message.starts_with(start) && message.ends_with(", actual 2"), "{message}");
        }
        other => panic!("{other:?}"),
    }
    // Smaller textures and buffers are made do with.
    let limits = wgpu::Limits { max_texture_dimension_2d: 2048, ..wgpu::Limits::default() };
    let (device, queue) = foreign(limits);
    let gpu = Gpu::from_device(device, queue, Duration::from_secs(1)).expect("a GPU");
    assert!((1024..2048).contains(&gpu.caps().texture_side));
}

/// The network on a device without timestamps and subgroups, whose indirect dispatches wgpu looks at.
#[test]
fn a_detector_runs_on_a_programs_own_device() {
    let (device, queue) = foreign(wgpu::Limits::default());
    let gpu = Gpu::from_device(device, queue, Duration::from_secs(120)).expect("a GPU");
    let weights = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet.safetensors");
    let config =
        smr_gpu::Config { input_size: Some(64), score: 0.0, ..smr_gpu::Config::new(weights) };
    let detector = pollster::block_on(smr_gpu::GpuDetector::on_device(gpu, config));
    let pixels: Vec<u8> =
        (0..80u32 * 70).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let frame = smr_gpu::Frame::new(pixels, 80, 70, smr_gpu::PixelFormat::Gray8);
    let found = detector.expect("a detector").detect(&frame).expect("a detection");
    assert!(!found.detections.is_empty(), "{found:?}");
    // Without timestamps only what the host does has a time.
    let stages: Vec<_> = found.stages.iter().map(|time| time.stage.as_str()).collect();
    assert_eq!(stages, ["frame"]);
}
