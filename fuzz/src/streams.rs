//! Streams: whatever frames follow one another, each has the detections that it has alone, or those of an equal
//! one, or an error.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use smr_gpu::detector::MOST_REUSED;
use smr_gpu::{CachingDetector, Config, Detections, Device, Frame, GpuDetector, PixelFormat, Rect};

/// Bytes that say what a frame is.
const WORDS: usize = 8;
/// Most frames of a run.
const FRAMES: usize = 2 * MOST_REUSED as usize;
const FORMATS: [PixelFormat; 9] = [
    PixelFormat::Gray8,
    PixelFormat::Rgb8,
    PixelFormat::Bgr8,
    PixelFormat::Rgba8,
    PixelFormat::BayerRggb8,
    PixelFormat::BayerGbrg8,
    PixelFormat::Gray16,
    PixelFormat::Yuyv,
    PixelFormat::Nv12,
];

/// Shows the detector the frames that the bytes describe.
pub fn run(data: &[u8]) {
    let detector = detector();
    let mut stream = CachingDetector::new(detector.clone());
    let mut before: Option<Detections> = None;
    let mut reused = 0;
    for words in data.as_chunks::<WORDS>().0.iter().take(FRAMES) {
        let frame = frame(words);
        let found = match stream.detect(&frame) {
            Ok(found) => found,
            Err(error) => {
                assert!(!error.to_string().is_empty());
                detector.detect(&frame).expect_err("what a stream refuses");
                continue;
            }
        };
        assert_eq!([found.width, found.height], [frame.width, frame.height]);
        reused = if found.reused { reused + 1 } else { 0 };
        assert!(reused <= MOST_REUSED);
        let same = match found.reused {
            true => before.take().expect("an earlier frame"),
            false => detector.detect(&frame).expect("what a stream takes"),
        };
        assert_eq!(found.detections, same.detections);
        assert_eq!([found.width, found.height], [same.width, same.height]);
        assert_eq!((found.gel, found.contact), (same.gel, same.contact));
        before = Some(found);
    }
}

/// One whose input is small enough for hundreds of frames.
fn detector() -> &'static Arc<GpuDetector> {
    static DETECTOR: OnceLock<Arc<GpuDetector>> = OnceLock::new();
    DETECTOR.get_or_init(|| {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let file = "weights/smrnet-s.safetensors";
        let weights =
            [here.join(file), here.join("..").join(file)].into_iter().find(|f| f.exists());
        let mut config =
            Config { device: Device::Cpu, ..Config::new(weights.expect("the weights")) };
        config.input_size = Some(32);
        config.score = 0.05;
        Arc::new(GpuDetector::new(config).expect("a detector"))
    })
}

/// A frame with a disc on even ground, perhaps one that cannot be.
fn frame(words: &[u8; WORDS]) -> Frame<'static> {
    let [kind, width, height, ground, disc, at, crop, seed] = words.map(u32::from);
    let (width, height) = (width % 97, height % 97);
    let format = FORMATS[kind as usize % FORMATS.len()];
    let bytes = format.bytes_per_pixel();
    let stride = width as usize * bytes + (kind as usize / 64) * 3;
    let level = |x: u32, y: u32| {
        let (dx, dy) = (x.abs_diff(at % 16 * 6), y.abs_diff(at / 16 * 6));
        let noise = (x * 31 + y * 17 + seed).wrapping_mul(2_654_435_761) >> 30;
        let mark = if dx * dx + dy * dy < 100 { disc } else { 0 };
        (ground / 2 + mark / 2 + noise) as u8
    };
    let mut data = vec![0; stride * height as usize];
    for (y, row) in (0..height).zip(data.chunks_mut(stride.max(1))) {
        for (x, pixel) in (0..width).zip(row.chunks_mut(bytes)) {
            pixel.fill(level(x, y));
        }
    }
    if kind == 255 {
        data.pop();
    }
    let frame = Frame::new(data, width, height, format).stride(stride);
    match crop {
        0..128 => frame,
        _ => {
            let (x, y) = (crop % 4 * 8, crop / 4 % 4 * 8);
            frame.crop(Rect { x, y, width: 16 + crop % 64, height: 16 + seed % 64 })
        }
    }
}
