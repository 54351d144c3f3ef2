//! Frames of a press through a [`CachingDetector`], beside the whole network at each of them.
//!
//! ```sh
//! smr-gpu simulate --out out/press --count 500 --seed 2006 --kind a --press
//! cargo run --release --example stream -- cpu weights/smrnet-s.safetensors out/press
//! ```
//!
//! Prints for both: time from the call with a frame to its result, its median, 95th percentile and longest;
//! how many frames kept their detections, and how many had no contact or were looked at in parts; labelled
//! snaps found (a box of their class above a score of 0.5 that overlaps by at least half), boxes on frames
//! without a label, and the largest and median distance of a centre from the label's.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use smr_gpu::evaluation::Seen;
use smr_gpu::evaluation::coco::{self, Dataset};
use smr_gpu::evaluation::metrics::quantile;
use smr_gpu::{CachingDetector, Config, Detections, Device, Frame, GpuDetector, Savings, picture};

/// Scores above this count.
const SCORE: f32 = 0.5;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [device, weights, folder] = &args[..] else {
        return Err("expected DEVICE WEIGHTS FOLDER".into());
    };
    let device: Device = device.parse()?;
    let folder = Path::new(folder);
    let data = coco::parse(&std::fs::read(folder.join("annotations.json"))?)?;
    let read = |labelled: &coco::Picture| picture::read(labelled.find_in(folder));
    let pictures: Vec<_> = data.pictures.iter().map(read).collect::<Result<_, _>>()?;
    let frames = data.pictures.iter().zip(&pictures);
    let frames: Vec<Frame> = frames.map(|(label, shown)| label.state(Frame::from(shown))).collect();
    println!(
        "| | ms, median | 95 % | longest | reused | no contact | in parts | found | false | centre, mm | largest |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, savings) in [("every frame whole", Savings::NONE), ("stream", Savings::ALL)] {
        let config =
            Config { device: device.clone(), savings, score: SCORE, ..Config::new(weights) };
        let detector = Arc::new(GpuDetector::new(config)?);
        // Builds what the sizes need, as the first frames of a stream would.
        for frame in frames.iter().step_by(10) {
            detector.detect(frame)?;
        }
        let found: Vec<Detections> = match savings == Savings::NONE {
            true => frames.iter().map(|f| detector.detect(f)).collect::<Result<_, _>>()?,
            false => {
                let mut camera = CachingDetector::new(detector.clone());
                frames.iter().map(|f| camera.detect(f)).collect::<Result<_, _>>()?
            }
        };
        print(name, &found, &data.clone().of_classes(&detector.model().classes)?);
    }
    Ok(())
}

fn print(name: &str, found: &[Detections], data: &Dataset) {
    let ms: Vec<f64> = found.iter().map(|f| f.wall.as_secs_f64() * 1e3).collect();
    let at = |values: &[f64], share| quantile(values, share).unwrap_or(f64::NAN);
    let (mut snaps, mut wrong, mut errors) = (0, 0, Vec::new());
    for (found, picture) in found.iter().zip(&data.pictures) {
        if picture.labels.is_empty() {
            wrong += found.detections.len();
        }
        let seen = Seen::new(picture, found);
        let best = seen.best(SCORE.into());
        snaps += best.len();
        let right = best.iter().filter_map(|(_, right)| right.as_ref());
        errors.extend(right.map(|right| right.off_mm[0].hypot(right.off_mm[1])));
    }
    let right = errors.len();
    let count = |of: fn(&Detections) -> bool| found.iter().filter(|found| of(found)).count();
    println!(
        "| {name} | {:.1} | {:.1} | {:.1} | {} | {} | {} | {right} of {snaps} | {wrong} | {:.3} | {:.3} |",
        at(&ms, 0.5),
        at(&ms, 0.95),
        at(&ms, 1.0),
        count(|f| f.reused),
        count(|f| f.contact == Some(false)),
        count(|f| f.regions.as_ref().is_some_and(|parts| !parts.is_empty())),
        at(&errors, 0.5),
        at(&errors, 1.0),
    );
}
