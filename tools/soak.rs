//! Frames of changing size and lost devices, for as long as one likes, with the memory that the process
//! has: `cargo run --release --example soak -- FRAMES LOSSES`. It prints a line a tenth.

use smr_gpu::engine::gpu::{Call, Fault, Faults};
use smr_gpu::{Config, Device, Frame, GpuDetector, PixelFormat};

/// Megabytes of memory that the process has, where Linux tells.
fn resident() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split(' ').nth(1)?.parse().ok()?;
    Some(pages * 4096 / 1_000_000)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut counts = std::env::args().skip(1).map(|n| n.parse::<u32>());
    let frames = counts.next().unwrap_or(Ok(10_000))?;
    let losses = counts.next().unwrap_or(Ok(1000))?;
    let faults = Faults::default();
    let mut config = Config { input_size: Some(64), ..Config::new("weights/smrnet.safetensors") };
    config.device = Device::Gpu(Default::default());
    config.faults = Some(faults.clone());
    let detector = GpuDetector::new(config)?;
    let tell = |what: &str, done: u32, all: u32| {
        if done.is_multiple_of((all / 10).max(1)) {
            let memory = resident().map_or("unknown".to_owned(), |mb| format!("{mb} MB"));
            println!("{done} {what}: {memory}");
        }
    };
    let picture = |i: u32| {
        let (width, height) = (100 + 57 * (i % 7), 100 + 91 * (i % 5));
        let pixels: Vec<u8> = (0..width * height).map(|p| (p ^ i) as u8).collect();
        Frame::new(pixels, width, height, PixelFormat::Gray8)
    };
    for (found, done) in detector.detect_many((0..frames).map(picture)).zip(1..) {
        found?;
        tell("frames", done, frames);
    }
    for done in 1..=losses {
        faults.fail(Call::Submit, 0, Fault::Lost);
        detector.detect(picture(done))?;
        tell("lost devices", done, losses);
    }
    Ok(())
}
