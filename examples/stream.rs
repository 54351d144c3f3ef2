//! Frames of a press through [`GpuDetector::detect_stream`], beside the whole network at each of them.
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

use smr_gpu::coco::{self, Picture};
use smr_gpu::metrics::{box_iou, center, quantile};
use smr_gpu::{Config, Detections, Device, Frame, GpuDetector, PixelFormat, Scene, picture};

/// Scores above this count.
const SCORE: f32 = 0.5;
/// A box with this overlap finds its snap.
const RIGHT: f64 = 0.5;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [device, weights, folder] = &args[..] else {
        return Err("expected DEVICE WEIGHTS FOLDER".into());
    };
    let device: Device = device.parse()?;
    let folder = Path::new(folder);
    let data = coco::parse(&std::fs::read(folder.join("annotations.json"))?)?;
    let mut frames = Vec::new();
    for picture in &data.pictures {
        let decoded = picture::read(folder.join("images").join(&picture.file))
            .or_else(|_| picture::read(folder.join(&picture.file)))?
            .into_rgb8();
        let (width, height) = decoded.dimensions();
        let mut frame = Frame::new(decoded.into_raw(), width, height, PixelFormat::Rgb8);
        frame.mm_per_pixel = picture.mm_per_pixel;
        frames.push(frame);
    }
    println!(
        "| | ms, median | 95 % | longest | reused | no contact | in parts | found | false | centre, mm | largest |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, scene) in [("every frame whole", Scene::FULL), ("stream", Scene::SAVING)] {
        let config = Config::new(weights).device(device.clone()).scene(scene).score(SCORE);
        let detector = GpuDetector::new(config)?;
        // Builds what the sizes need, as the first frames of a stream would.
        for frame in frames.iter().step_by(10) {
            detector.detect_frame(frame)?;
        }
        let found: Vec<Detections> = match scene == Scene::FULL {
            true => frames.iter().map(|f| detector.detect_frame(f)).collect::<Result<_, _>>()?,
            false => detector.detect_stream(frames.iter().cloned()).collect::<Result<_, _>>()?,
        };
        print(name, &found, &data.pictures, &data.categories);
    }
    Ok(())
}

fn print(name: &str, found: &[Detections], pictures: &[Picture], categories: &[String]) {
    let ms: Vec<f64> = found.iter().map(|f| f.wall.as_secs_f64() * 1e3).collect();
    let at = |values: &[f64], share| quantile(values, share).unwrap_or(f64::NAN);
    let (mut labelled, mut right, mut wrong, mut errors) = (0, 0, 0, Vec::new());
    for (found, picture) in found.iter().zip(pictures) {
        let mm = f64::from(found.mm_per_pixel);
        if picture.labels.is_empty() {
            wrong += found.detections.len();
        }
        for label in &picture.labels {
            labelled += 1;
            let class = &categories[label.category];
            let of_class = found.detections.iter().filter(|d| d.class.eq_ignore_ascii_case(class));
            let judged = of_class.map(|d| d.bbox.map(f64::from));
            let judged = judged.map(|bbox| (box_iou(label.truth.bbox, bbox), bbox));
            if let Some((iou, bbox)) = judged.max_by(|a, b| a.0.total_cmp(&b.0))
                && iou >= RIGHT
            {
                right += 1;
                let [a, b] = [center(bbox), center(label.truth.bbox)];
                errors.push((a[0] - b[0]).hypot(a[1] - b[1]) * mm);
            }
        }
    }
    let count = |of: fn(&Detections) -> bool| found.iter().filter(|found| of(found)).count();
    println!(
        "| {name} | {:.1} | {:.1} | {:.1} | {} | {} | {} | {right} of {labelled} | {wrong} | {:.3} | {:.3} |",
        at(&ms, 0.5),
        at(&ms, 0.95),
        at(&ms, 1.0),
        count(|f| f.reused),
        count(|f| f.contact == Some(false)),
        count(|f| f.regions.is_some()),
        at(&errors, 0.5),
        at(&errors, 1.0),
    );
}
