//! A device that fails at any of the engine's calls: each failure is a typed error of the run that it
//! befell, or is made good, and the next run is right.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use smr_gpu::engine::gpu::{
    AdapterChoice, Call, Deadline, Fault, Faults, Gpu, GpuOptions, ProgramOptions, Slot,
};
use smr_gpu::engine::graph::{Graph, TensorId};
use smr_gpu::engine::ops::case::random;
use smr_gpu::engine::ops::{Conv2d, MaxPool2d};
use smr_gpu::engine::shape::{Extent, TensorSpec};
use smr_gpu::engine::tensor::Value;
use smr_gpu::{Config, Detection, Device, Error, Frame, GpuDetector, PixelFormat, Savings};

const WEIGHTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet.safetensors");

/// One test at a time: they measure the process's memory, and wait for time limits.
fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open(faults: &Faults) -> Arc<Gpu> {
    let options = GpuOptions { faults: Some(faults.clone()), ..GpuOptions::default() };
    pollster::block_on(Gpu::open(options)).expect("an adapter")
}

/// What may befall a call of this kind.
fn kinds(call: Call) -> Vec<Fault> {
    let mut kinds = vec![Fault::Invalid, Fault::OutOfMemory, Fault::Lost];
    if call == Call::Map {
        kinds.extend([Fault::Refused, Fault::Aborted]);
    }
    kinds
}

#[track_caller]
fn check<T: std::fmt::Debug>(result: Result<T, Error>, fault: Fault, what: &str) {
    match (&result, fault) {
        (Err(Error::DeviceLost(_)), Fault::Lost) | (Err(Error::Timeout { .. }), Fault::Late(_)) => {
        }
        (Err(Error::Driver { .. }), _) if !matches!(fault, Fault::Lost | Fault::Late(_)) => {}
        _ => panic!("{what}: {fault:?} gave {result:?}"),
    }
}

/// A convolution and a pooling: buffers, textures, copies and several pipelines.
struct Small {
    graph: Graph,
    input: TensorId,
    value: Value,
}

impl Small {
    fn new() -> Self {
        let mut graph = Graph::default();
        let input = graph.input("input", TensorSpec::f32([8, 16, 16]), Extent::Exact);
        let weight = graph.constant("weight", random(1, [8, 8, 3, 3]));
        let op = Conv2d { padding: 1, bias: false, ..Conv2d::default() };
        let map = graph.apply1("conv", op, &[input, weight]).expect("a map");
        let op = MaxPool2d { kernel: 2, stride: 2, padding: 0 };
        let output = graph.apply1("pool", op, &[map]).expect("a map");
        graph.mark_output(output);
        Self { graph, input, value: random(2, [8, 16, 16]).into() }
    }

    fn slot(&self, gpu: &Arc<Gpu>) -> smr_gpu::Result<Slot> {
        pollster::block_on(Slot::of(gpu, &self.graph, &[], ProgramOptions::default()))
    }

    fn run(&self, slot: &mut Slot) -> smr_gpu::Result<Value> {
        let mut values = slot.run(&[(self.input, &self.value)])?.first();
        let (_, value) = values.drain().next().expect("an output");
        Ok(value)
    }
}

#[test]
fn every_call_of_a_program_may_fail() {
    let _one = alone();
    let small = Small::new();
    let faults = Faults::default();
    let mut gpu = open(&faults);
    let want = small.run(&mut small.slot(&gpu).expect("a slot")).expect("a run");
    let counts = Call::ALL.map(|call| (call, faults.calls(call)));
    for (call, count) in counts {
        assert!(count > 0, "the program makes no {call:?}");
        for at in 0..count {
            for fault in kinds(call) {
                let what = format!("{call:?} {at}");
                if call == Call::Pipeline {
                    // Those that are compiled are not compiled again.
                    gpu = open(&faults);
                }
                faults.fail(call, at, fault);
                let mut slot = small.slot(&gpu);
                let result = match &mut slot {
                    Ok(slot) => small.run(slot).map(|_| ()),
                    Err(_) => slot.as_ref().map(|_| ()).map_err(|e| match e {
                        Error::DeviceLost(why) => Error::DeviceLost(why.clone()),
                        e => Error::Driver { stage: "building".into(), message: e.to_string() },
                    }),
                };
                check(result, fault, &what);
                assert!(!faults.is_due(), "{what}: {fault:?} did not come about");
                faults.watch();
                if fault == Fault::Lost {
                    // It is gone for good, whoever asks.
                    if let Ok(slot) = &mut slot {
                        check(small.run(slot), fault, &what);
                    }
                    check(small.slot(&gpu), fault, &what);
                    gpu = open(&faults);
                }
                // The same slot, where there is one, and another.
                if let (Ok(slot), true) = (&mut slot, fault != Fault::Lost) {
                    assert_eq!(small.run(slot).expect(&what), want, "{what}: after {fault:?}");
                }
                let mut other = small.slot(&gpu).expect(&what);
                assert_eq!(small.run(&mut other).expect(&what), want, "{what}: after {fault:?}");
                assert_eq!(faults.strays(), [""; 0], "{what}: {fault:?}");
            }
        }
    }
}

/// A device that is destroyed while it works tells so when it is done; nobody takes it for another
/// fault until then.
#[test]
fn a_device_that_is_destroyed_at_work_is_lost_at_once() {
    let _one = alone();
    let small = Small::new();
    let faults = Faults::default();
    let gpu = open(&faults);
    let mut slots = [0; 4].map(|_| small.slot(&gpu).expect("a slot"));
    for slot in &mut slots {
        pollster::block_on(slot.submit(&[&[(small.input, &small.value)]])).expect("submitted");
    }
    gpu.destroy();
    check(small.slot(&gpu), Fault::Lost, "a program");
    for slot in &mut slots {
        // What was under way may still have come.
        match pollster::block_on(slot.receive(Deadline::after(Duration::from_secs(60)))) {
            Ok(_) | Err(Error::DeviceLost(_)) => {}
            Err(e) => panic!("{e}"),
        }
        check(small.run(slot), Fault::Lost, "a run");
    }
    assert_eq!(faults.strays(), [""; 0]);
}

#[test]
fn a_slot_waits_for_a_late_run_no_longer_than_it_may() {
    let _one = alone();
    let small = Small::new();
    let faults = Faults::default();
    let gpu = open(&faults);
    let mut slot = small.slot(&gpu).expect("a slot");
    let want = small.run(&mut slot).expect("a run");
    // Later than both waits end, however slow the machine.
    let fault = Fault::Late(Duration::from_secs(4));
    faults.fail(Call::Map, 0, fault);
    let soon = || Deadline::after(Duration::from_millis(20));
    pollster::block_on(slot.submit(&[&[(small.input, &small.value)]])).expect("submitted");
    check(pollster::block_on(slot.receive(soon())), fault, "the run");
    let waited = pollster::block_on(slot.recover(soon())).expect_err("still under way");
    assert!(waited.to_string().contains("an earlier picture"), "{waited}");
    assert_eq!(small.run(&mut slot).expect("a run"), want);
}

/// The network at its smallest, and nothing before it.
fn config(change: impl FnOnce(Config) -> Config) -> Config {
    let gpu = Device::Gpu(AdapterChoice::Auto);
    change(Config {
        device: gpu,
        input_size: Some(64),
        score: 0.0,
        savings: Savings::NONE,
        ..Config::new(WEIGHTS)
    })
}

fn with_faults(faults: &Faults, change: impl FnOnce(Config) -> Config) -> Config {
    config(|config| {
        let mut config = change(config);
        config.faults = Some(faults.clone());
        config
    })
}

/// A picture in which there is something everywhere.
fn frame(width: u32, height: u32, seed: u32) -> Frame<'static> {
    let pixel = |i: u32| (i.wrapping_add(seed * 7919).wrapping_mul(2_654_435_761) >> 24) as u8;
    let pixels: Vec<u8> = (0..width * height).map(pixel).collect();
    Frame::new(pixels, width, height, PixelFormat::Gray8)
}

fn detect(detector: &GpuDetector, frame: &Frame) -> smr_gpu::Result<Vec<Detection>> {
    detector.detect(frame).map(|found| found.detections)
}

/// First, middle and last.
fn some(count: usize) -> Vec<usize> {
    let mut some = vec![0, count / 2, count.saturating_sub(1)];
    some.dedup();
    some.truncate(count);
    some
}

#[test]
fn a_detection_that_fails_leaves_the_next_right() {
    let _one = alone();
    let faults = Faults::default();
    let detector = GpuDetector::new(with_faults(&faults, |c| c)).expect("a detector");
    let frame = frame(80, 70, 1);
    faults.watch();
    let want = detect(&detector, &frame).expect("a detection");
    assert!(!want.is_empty());
    // The first detection makes what later ones have.
    let counts = Call::ALL.map(|call| (call, faults.calls(call)));
    for (call, count) in counts {
        for at in some(count) {
            for fault in kinds(call) {
                if fault == Fault::Lost && at > 0 {
                    continue;
                }
                // What a slot has made is forgotten after a failure.
                faults.fail(Call::Submit, 0, Fault::Invalid);
                check(detect(&detector, &frame), Fault::Invalid, "a submission");
                let what = format!("{call:?} {at}");
                faults.fail(call, at, fault);
                match fault {
                    // Made good by a new device.
                    Fault::Lost => assert_eq!(detect(&detector, &frame).expect(&what), want),
                    _ => check(detect(&detector, &frame), fault, &what),
                }
                assert!(!faults.is_due(), "{what}: {fault:?} did not come about");
                faults.watch();
                assert_eq!(detect(&detector, &frame).expect(&what), want, "{what}: {fault:?}");
                assert_eq!(faults.strays(), [""; 0], "{what}: {fault:?}");
            }
        }
    }
}

/// The first calls of a detection are those of the look for contact.
#[test]
fn a_look_for_contact_that_fails_leaves_the_next_right() {
    let _one = alone();
    let faults = Faults::default();
    let change = |c: Config| Config { savings: Savings { contact: true, ..Savings::NONE }, ..c };
    let detector = GpuDetector::new(with_faults(&faults, change)).expect("a detector");
    let frame = frame(80, 70, 1);
    let found = detector.detect(&frame).expect("a detection");
    assert!(found.contact == Some(true) && !found.detections.is_empty());
    for call in [Call::Submit, Call::Map] {
        for fault in kinds(call) {
            faults.fail(call, 0, fault);
            match fault {
                Fault::Lost => {
                    let again = detect(&detector, &frame).expect("on a new device");
                    assert_eq!(again, found.detections);
                }
                _ => check(detect(&detector, &frame), fault, &format!("{call:?}")),
            }
            assert!(!faults.is_due(), "{call:?}: {fault:?} did not come about");
            assert_eq!(detect(&detector, &frame).expect("the next"), found.detections);
        }
    }
}

#[test]
fn a_detector_that_cannot_be_built_says_why() {
    let _one = alone();
    let faults = Faults::default();
    let build =
        || GpuDetector::new(with_faults(&faults, |c| Config { rebuild_on_loss: false, ..c }));
    faults.watch();
    let detector = build().expect("a detector");
    let counts = Call::ALL.map(|call| (call, faults.calls(call)));
    let want = detect(&detector, &frame(80, 70, 1)).expect("a detection");
    drop(detector);
    for (call, count) in counts {
        // A program is built without these.
        assert_eq!(count == 0, matches!(call, Call::BindGroup | Call::Map), "{call:?}");
        let Some(last) = count.checked_sub(1) else { continue };
        for fault in kinds(call) {
            faults.fail(call, last, fault);
            check(build(), fault, &format!("{call:?} {last}"));
        }
    }
    faults.watch();
    let found = detect(&build().expect("a detector"), &frame(80, 70, 1)).expect("a detection");
    assert_eq!(found, want);
    assert_eq!(faults.strays(), [""; 0]);
}

#[test]
fn a_lost_device_is_replaced_where_that_is_wanted_and_allowed() {
    let _one = alone();
    let faults = Faults::default();
    let frame = frame(80, 70, 1);
    let lose = || faults.fail(Call::Submit, 0, Fault::Lost);
    let stays = GpuDetector::new(with_faults(&faults, |c| Config { rebuild_on_loss: false, ..c }));
    let stays = stays.expect("a detector");
    let want = detect(&stays, &frame).expect("a detection");
    lose();
    for _ in 0..3 {
        check(detect(&stays, &frame), Fault::Lost, "without rebuilding");
    }
    // The caller's own device is the caller's to replace.
    let gpu = open(&faults);
    let foreign = GpuDetector::on_device(gpu.clone(), config(|c| c));
    let foreign = pollster::block_on(foreign).expect("a detector");
    assert_eq!(detect(&foreign, &frame).expect("a detection"), want);
    gpu.destroy();
    for _ in 0..3 {
        check(detect(&foreign, &frame), Fault::Lost, "on the caller's device");
    }
    let again = pollster::block_on(GpuDetector::on_device(gpu, config(|c| c)));
    check(again, Fault::Lost, "a detector on a lost device");
    // Many that lose their device together get one new one.
    let detector = GpuDetector::new(with_faults(&faults, |c| Config { in_flight: 4, ..c }))
        .expect("a detector");
    lose();
    std::thread::scope(|scope| {
        let found: Vec<_> = (0..4).map(|_| scope.spawn(|| detect(&detector, &frame))).collect();
        for found in found {
            let found = found.join().expect("no panic");
            assert_eq!(found.expect("a detection"), want);
        }
    });
}

#[test]
fn a_time_limit_counts_from_the_call_and_says_what_it_waited_for() {
    let _one = alone();
    let faults = Faults::default();
    let frame = frame(80, 70, 1);
    let patient = GpuDetector::new(with_faults(&faults, |c| c)).expect("a detector");
    detect(&patient, &frame).expect("what a driver compiles first");
    let start = Instant::now();
    let want = detect(&patient, &frame).expect("a detection");
    drop(patient);
    // Long enough for a run on a machine with other work.
    let limit = Duration::from_secs(3).max(20 * start.elapsed());
    let change = |c: Config| Config { timeout: limit, in_flight: 1, ..c };
    let detector = GpuDetector::new(with_faults(&faults, change)).expect("a detector");
    // Past the limits of this call and the next two, which begin while it waits or thereafter.
    faults.fail(Call::Map, 0, Fault::Late(limit * 5));
    std::thread::scope(|scope| {
        let first = scope.spawn(|| detect(&detector, &frame));
        while faults.is_due() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // It gets no further than the queue: the limit counts there, too.
        let queued = scope.spawn(|| detect(&detector, &frame));
        let first = first.join().expect("no panic").expect_err("too late");
        assert!(first.to_string().contains("did not finish the network"), "{first}");
        let queued = queued.join().expect("no panic").expect_err("too late");
        assert!(queued.to_string().contains("earlier pictures"), "{queued}");
    });
    // It waits for the abandoned run no longer than for one of its own.
    let next = detect(&detector, &frame).expect_err("the device is not back");
    assert!(next.to_string().contains("the device has not come back"), "{next}");
    // What came late is over in two more.
    let found = (0..5).find_map(|_| match detect(&detector, &frame) {
        Err(Error::Timeout { .. }) => None,
        other => Some(other),
    });
    assert_eq!(found.expect("the device is back").expect("a detection"), want);
}

#[test]
fn many_pictures_give_the_same_bits_as_one_by_one() {
    let _one = alone();
    let faults = Faults::default();
    let detector = GpuDetector::new(with_faults(&faults, |c| c)).expect("a detector");
    let frames: Vec<Frame> = (0..8).map(|i| frame(60 + 9 * i, 90 - 7 * i, i)).collect();
    let look = |frame| detect(&detector, frame).expect("a detection");
    let want: Vec<_> = frames.iter().map(look).collect();
    assert!(want.windows(2).all(|pair| pair[0] != pair[1]), "pictures that differ");
    std::thread::scope(|scope| {
        for thread in 0..8 {
            let (frames, want) = (&frames, &want);
            scope.spawn(move || {
                for at in (0..8).map(|i| (i + thread) % 8) {
                    assert_eq!(look(&frames[at]), want[at], "thread {thread}, picture {at}");
                }
            });
        }
    });
    // One that is no picture. Pairs run together: the first pair's run fails, or that of the picture which
    // has none beside it.
    let empty = Frame::new(vec![0u8; 0], 0, 0, PixelFormat::Gray8);
    let mut given: Vec<Frame> = frames.clone();
    given.insert(3, empty);
    for (run, failed) in [(0, None), (1, Some(2))] {
        faults.fail(Call::Submit, run, Fault::Invalid);
        let found: Vec<_> = detector.detect_many(given.iter().cloned()).collect();
        assert!(!faults.is_due());
        assert_eq!(found.len(), 9);
        let mut errors = Vec::new();
        for (at, found) in found.into_iter().enumerate() {
            match found {
                Ok(found) => assert_eq!(found.detections, want[at - usize::from(at > 3)], "{at}"),
                Err(Error::Driver { .. }) => errors.push(at),
                Err(e) => assert!(at == 3 && matches!(e, Error::Picture { .. }), "{at}: {e}"),
            }
        }
        // Of a pair each is looked at again, alone.
        assert_eq!(errors, Vec::from_iter(failed));
    }
}

/// Bytes of memory that the process has.
#[cfg(target_os = "linux")]
fn resident() -> i64 {
    let statm = std::fs::read_to_string("/proc/self/statm").expect("statm");
    let pages = statm.split(' ').nth(1).and_then(|n| n.parse::<i64>().ok());
    // Of the usual size.
    pages.expect("a number of pages") * 4096
}

#[cfg(target_os = "linux")]
#[test]
fn memory_is_flat_over_frames_and_rebuilds() {
    let _one = alone();
    let faults = Faults::default();
    let detector = GpuDetector::new(with_faults(&faults, |c| c)).expect("a detector");
    let frames: Vec<Frame> =
        (0..10).map(|i| frame(100 + 57 * (i % 7), 100 + 91 * (i % 5), i)).collect();
    let look = |count: usize| {
        for result in detector.detect_many(frames.iter().cloned().cycle().take(count)) {
            result.expect("a detection");
        }
    };
    look(20);
    let before = resident();
    look(100);
    let grown = resident() - before;
    // The frames take 0.3 MB each on the device: 100 of them 30 MB, if they were kept.
    assert!(grown < 15 << 20, "{grown} bytes more after 100 frames");
    let rebuild = |count: usize| {
        for _ in 0..count {
            faults.fail(Call::Submit, 0, Fault::Lost);
            detect(&detector, &frames[0]).expect("a detection on a new device");
            assert!(!faults.is_due());
        }
    };
    rebuild(3);
    let before = resident();
    rebuild(5);
    let grown = resident() - before;
    // The weights alone are 80 MB and more: five devices would be 400 MB, if they were kept.
    assert!(grown < 150 << 20, "{grown} bytes more after 5 rebuilds");
}
