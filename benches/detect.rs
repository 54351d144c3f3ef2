//! Whole pictures with the large network, on the adapter and on the CPU, and on the adapter several one by one
//! and given together.

use criterion::{Criterion, criterion_group, criterion_main};
use image::{DynamicImage, RgbImage};
use smr_gpu::engine::gpu::AdapterChoice;
use smr_gpu::{Config, Device, Frame, GpuDetector, Savings};

/// Pictures that are given together.
const MANY: usize = 8;

fn detect(criterion: &mut Criterion) {
    // Any picture costs the same but for the count of proposals.
    let ramp = RgbImage::from_fn(1000, 1000, |x, y| image::Rgb([x, y, x + y].map(|v| v as u8)));
    let picture = DynamicImage::ImageRgb8(ramp);
    let mut group = criterion.benchmark_group("detect");
    group.sample_size(10);
    for (name, device) in [("adapter", Device::Gpu(AdapterChoice::Auto)), ("cpu", Device::Cpu)] {
        let mut config =
            Config::new(concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet.safetensors"));
        config.device = device;
        // A ramp touches nothing.
        config.savings = Savings::NONE;
        let detector = GpuDetector::new(config).expect("a detector");
        group.bench_function(name, |b| b.iter(|| detector.detect(&picture).expect("detections")));
        if name == "adapter" {
            let frames: Vec<Frame> = (0..MANY).map(|_| Frame::from(&picture)).collect();
            let alone = || {
                let found = frames.iter().map(|frame| detector.detect(frame));
                found.for_each(|found| drop(found.expect("detections")));
            };
            group.bench_function("one by one", |b| b.iter(alone));
            let together = || {
                let found = detector.detect_many(frames.iter().cloned());
                found.for_each(|found| drop(found.expect("detections")));
            };
            group.bench_function("together", |b| b.iter(together));
        }
    }
}

criterion_group!(benches, detect);
criterion_main!(benches);
