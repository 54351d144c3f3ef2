//! How much longer a picture takes on cores where frames are spaced, where other programs compute beside, and
//! where the frame is large.
//!
//! ```sh
//! cargo run --release --example spaced -- 10 samples/mixed.png weights/smrnet-s.safetensors weights/smrnet.safetensors
//! ```
//!
//! In each of so many rounds every network looks at the picture 10 times back to back, 10 times with a frame
//! every 0.1 s, 10 times so with 1.2 cores of other load, and at the picture repeated to 4000 × 4000. Prints the
//! medians in milliseconds, and their ratios to the first.

use std::error::Error;
use std::hint::black_box;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use smr_gpu::{Config, Detections, Device, Frame, GpuDetector, PixelFormat, Savings, picture};

const EACH: usize = 10;
const APART: Duration = Duration::from_millis(100);
const WAYS: [&str; 4] = ["back to back", "every 0.1 s", "with 1.2 cores of load", "4000 x 4000"];

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<_> = std::env::args_os().skip(1).collect();
    let [rounds, file, weights @ ..] = &args[..] else {
        return Err("expected ROUNDS PICTURE WEIGHTS...".into());
    };
    let rounds: usize = rounds.to_str().ok_or("expected a number")?.parse()?;
    let small = picture::read(file)?.to_rgb8();
    let (width, height) = small.dimensions();
    let large = smr_gpu::image::RgbImage::from_fn(4000, 4000, |x, y| {
        *small.get_pixel(x * width / 4000, y * height / 4000)
    });
    let small = Frame::new(small.into_raw(), width, height, PixelFormat::Rgb8);
    let large = Frame::new(large.into_raw(), 4000, 4000, PixelFormat::Rgb8)
        .scale(smr_gpu::Scale::stated(0.01));
    let detectors = weights.iter().map(|weights| {
        GpuDetector::new(Config {
            device: Device::Cpu,
            savings: Savings::NONE,
            ..Config::new(weights)
        })
    });
    let detectors: Vec<GpuDetector> = detectors.collect::<Result<_, _>>()?;
    let mut times = vec![[(); WAYS.len()].map(|()| Vec::new()); detectors.len()];
    for _ in 0..=rounds {
        for (detector, times) in detectors.iter().zip(&mut times) {
            look(detector, &small, Duration::ZERO)?;
            times[0].extend(look(detector, &small, Duration::ZERO)?);
            times[1].extend(look(detector, &small, APART)?);
            times[2].extend(loaded(|| look(detector, &small, APART))??);
            times[3].extend(look(detector, &large, Duration::ZERO)?);
        }
    }
    for (weights, times) in weights.iter().zip(&mut times) {
        println!("{}", weights.display());
        // The first round makes ready.
        let medians = times.each_mut().map(|times| median(&mut times[EACH..]));
        for (way, ms) in WAYS.iter().zip(medians) {
            println!("  {way:24} {ms:7.1} ms {:5.2}", ms / medians[0]);
        }
    }
    Ok(())
}

/// Milliseconds of ten looks, which begin `apart`.
fn look(
    detector: &GpuDetector,
    frame: &Frame,
    apart: Duration,
) -> Result<Vec<f64>, smr_gpu::Error> {
    let look = |_| {
        let start = Instant::now();
        let found: Detections = detector.detect(frame)?;
        let took = start.elapsed();
        black_box(found);
        thread::sleep(apart.saturating_sub(took));
        Ok(took.as_secs_f64() * 1e3)
    };
    (0..EACH).map(look).collect()
}

/// What `work` gives while one thread computes all the time and another a fifth of it.
fn loaded<T: Send>(work: impl FnOnce() -> T) -> Result<T, Box<dyn Error>> {
    let over = AtomicBool::new(false);
    let compute = |busy: Duration, idle: Duration| {
        while !over.load(Ordering::Relaxed) {
            let start = Instant::now();
            while start.elapsed() < busy {
                black_box((0..1000).fold(0u64, |sum, i| black_box(sum ^ i)));
            }
            thread::sleep(idle);
        }
    };
    thread::scope(|scope| {
        scope.spawn(|| compute(Duration::from_millis(10), Duration::ZERO));
        scope.spawn(|| compute(Duration::from_millis(2), Duration::from_millis(8)));
        thread::sleep(Duration::from_millis(50));
        let done = work();
        over.store(true, Ordering::Relaxed);
        Ok(done)
    })
}

/// The middle one.
fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
