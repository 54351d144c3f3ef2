//! Whole pictures, on the adapter beside the CPU's f64 reference.

use criterion::{Criterion, criterion_group, criterion_main};
use image::{DynamicImage, RgbImage};
use smr_gpu::gpu::AdapterChoice;
use smr_gpu::{Config, Device, GpuDetector};

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
        let detector = GpuDetector::new(config).expect("a detector");
        group.bench_function(name, |b| b.iter(|| detector.detect(&picture).expect("detections")));
    }
}

criterion_group!(benches, detect);
criterion_main!(benches);
