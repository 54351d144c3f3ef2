//! The same picture, device and configuration give the same bits: again and again, from several threads,
//! in detectors built anew, whatever else is looked at beside.

#[path = "support/mod.rs"]
mod support;

use std::path::Path;
use std::thread;

use image::DynamicImage;
use smr_gpu::engine::gpu::{Gpu, GpuOptions};
use smr_gpu::{Config, Detections, Device, GpuDetector};

const THREADS: usize = 8;
/// Pictures that each thread looks at: 200 in all.
const EACH: usize = 25;

/// A small network with a small input that shows all it has, so that many bits are compared.
fn config() -> Config {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = Config::new(root.join("weights/smrnet-s.safetensors"));
    Config { input_size: Some(96), score: 0.001, in_flight: 4, ..config }
}

/// Pictures with different snaps.
fn pictures() -> Vec<DynamicImage> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let open = |name| image::open(root.join("samples").join(name)).expect("a sample");
    ["mixed.png", "hooks.png", "stud.png"].map(open).into()
}

/// All that is found, to the bit.
fn bits(found: &Detections) -> Vec<u32> {
    let each = found.detections.iter().flat_map(|d| {
        let told = [d.yaw_deg, d.yaw_std_deg, d.whole].into_iter().flatten();
        let placed =
            d.bbox.into_iter().chain(d.center_mm).chain(d.center_std_mm.into_iter().flatten());
        let numbers = [d.score].into_iter().chain(told).chain(placed).map(f32::to_bits);
        std::iter::once(d.class_index as u32).chain(numbers).collect::<Vec<_>>()
    });
    each.chain([found.proposals]).collect()
}

fn look(detector: &GpuDetector, picture: &DynamicImage) -> Vec<u32> {
    bits(&detector.detect(picture).expect("detections"))
}

/// Holds 200 looks of eight threads at three pictures, and those of `anew`, to the first of each picture.
fn same_bits(detector: &GpuDetector, anew: &[GpuDetector]) {
    let pictures = pictures();
    let expected: Vec<Vec<u32>> = pictures.iter().map(|picture| look(detector, picture)).collect();
    let found: usize = expected.iter().map(Vec::len).sum();
    assert!(found > 100, "only {found} words to compare");
    assert!(expected[0] != expected[1] && expected[1] != expected[2]);
    let (pictures, expected) = (&pictures, &expected);
    thread::scope(|scope| {
        for thread in 0..THREADS {
            scope.spawn(move || {
                for run in 0..EACH {
                    let at = (thread + run) % pictures.len();
                    assert_eq!(look(detector, &pictures[at]), expected[at], "{thread}: run {run}");
                }
            });
        }
    });
    for detector in anew {
        for (picture, expected) in pictures.iter().zip(expected) {
            assert_eq!(look(detector, picture), *expected, "a detector built anew");
        }
        // Given together.
        let frames: Vec<_> = pictures.iter().map(smr_gpu::Frame::from).collect();
        for (found, expected) in detector.detect_many(frames).zip(expected) {
            assert_eq!(bits(&found.expect("detections")), *expected, "given together");
        }
    }
}

#[test]
fn an_adapter_gives_the_same_bits() {
    let on = |gpu| pollster::block_on(GpuDetector::on_device(gpu, config())).expect("a detector");
    let other = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
    let gpu = support::gpu();
    same_bits(&on(gpu.clone()), &[on(gpu.clone()), on(other)]);
}

/// The program on one core and on all that there are.
#[cfg(target_os = "linux")]
#[test]
fn the_cpu_gives_the_same_bits_on_any_number_of_threads() {
    let run = |cores: &str, weights: &str| {
        let mut command = std::process::Command::new("taskset");
        command.args(["--cpu-list", cores, env!("CARGO_BIN_EXE_smr-gpu"), "detect", "--exact"]);
        command.args(["--device", "cpu", "--json", "--conf", "0.001", "--weights", weights]);
        command.args(["samples/mixed.png", "samples/hooks.png"]);
        let output = command.current_dir(env!("CARGO_MANIFEST_DIR")).output().expect("taskset");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let lines = String::from_utf8(output.stdout).expect("text");
        let of = |line| serde_json::from_str::<serde_json::Value>(line).expect("JSON");
        lines.lines().map(of).map(|found| found["detections"].clone()).collect::<Vec<_>>()
    };
    let last = thread::available_parallelism().map_or(1, usize::from) - 1;
    for weights in ["weights/smrnet.safetensors", "weights/smrnet-s.safetensors"] {
        let one = run("0", weights);
        let count = one.iter().flat_map(|found| found.as_array()).flatten().count();
        assert!(count > 2, "only {count} detections to compare");
        assert_eq!(one, run(&format!("0-{last}"), weights), "{weights}");
    }
}

#[test]
fn the_cpu_gives_the_same_bits() {
    let new = || GpuDetector::new(Config { device: Device::Cpu, ..config() }).expect("a detector");
    same_bits(&new(), &[new(), new()]);
}
