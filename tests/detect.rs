//! End to end: the detector on the sample pictures, whose labels lie beside them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;
use smr_gpu::engine::gpu::AdapterChoice;
use smr_gpu::evaluation::metrics::{box_iou, center};
use smr_gpu::{
    Config, Detections, Device, Error, Frame, Gel, GpuDetector, PixelFormat, Rect, WeightSource,
};

/// COCO labels, as far as these tests read them.
#[derive(Deserialize)]
struct Labels {
    images: Vec<LabelledImage>,
    annotations: Vec<Annotation>,
    categories: Vec<Category>,
}

#[derive(Deserialize)]
struct LabelledImage {
    id: u64,
    file_name: String,
}

#[derive(Deserialize)]
struct Annotation {
    image_id: u64,
    category_id: u64,
    bbox: [f64; 4],
    center_mm: [f64; 2],
}

#[derive(Deserialize)]
struct Category {
    id: u64,
    name: String,
}

fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn config() -> Config {
    let mut config = Config::new(file("weights/smrnet.safetensors"));
    config.device = Device::Gpu(AdapterChoice::Auto);
    config.score = 0.5;
    config
}

fn samples() -> Labels {
    let text = std::fs::read(file("samples/annotations.json")).expect("the samples' labels");
    serde_json::from_slice(&text).expect("COCO labels")
}

fn sample(image: &LabelledImage) -> image::DynamicImage {
    image::open(file("samples").join(&image.file_name)).expect("a sample")
}

#[test]
fn every_snap_of_the_samples_is_found_and_nothing_else() {
    let labels = samples();
    assert!(!labels.images.is_empty());
    let name_of: HashMap<u64, &str> =
        labels.categories.iter().map(|c| (c.id, c.name.as_str())).collect();
    let detector = GpuDetector::new(config()).expect("a detector");
    let mut wrong = Vec::new();
    for image in &labels.images {
        let found = detector.detect(&sample(image)).expect("detections").detections;
        let truths: Vec<_> = labels.annotations.iter().filter(|a| a.image_id == image.id).collect();
        if truths.len() != found.len() {
            wrong.push(format!("{}: {} snaps, found {found:?}", image.file_name, truths.len()));
        }
        for truth in truths {
            let [x, y, w, h] = truth.bbox;
            let class = name_of[&truth.category_id];
            let bbox = [x, y, x + w, y + h];
            // A box is right from an overlap of 0.5; well-placed ones pass 0.7. A tenth of the
            // smallest snap's footprint is 0.5 mm.
            let right = found.iter().any(|d| {
                let off = [0, 1].map(|i| f64::from(d.center_mm[i]) - truth.center_mm[i]);
                d.class.eq_ignore_ascii_case(class)
                    && box_iou(d.bbox.map(f64::from), bbox) > 0.7
                    && off[0].hypot(off[1]) < 0.5
            });
            if !right {
                wrong.push(format!("{}: {class} at {bbox:?}, found {found:?}", image.file_name));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn assert_same(a: &Detections, b: &Detections) {
    assert_eq!(a.detections, b.detections);
    assert_eq!((a.width, a.height, a.proposals), (b.width, b.height, b.proposals));
}

#[test]
fn one_detector_serves_threads_and_pictures_of_any_size() {
    fn is_shared<T: Send + Sync>(_: &T) {}
    let detector = GpuDetector::new(config()).expect("a detector");
    is_shared(&detector);
    let labels = samples();
    let picture = sample(&labels.images[0]);
    let first = detector.detect(&picture).expect("detections");

    // The same picture as a part of a wide frame: the network sees the same square, so the same boxes
    // come back, moved.
    let side = picture.width();
    let mut wide = image::RgbImage::new(side + 240, side);
    image::imageops::replace(&mut wide, &picture.to_rgb8(), 120, 0);
    let wide = image::DynamicImage::from(wide);
    let part = Rect { x: 120, y: 0, width: side, height: side };
    let moved = detector.detect(Frame::from(&wide).crop(part)).expect("detections");
    assert_eq!(first.detections.len(), moved.detections.len());
    for (a, b) in first.detections.iter().zip(&moved.detections) {
        assert_eq!((&a.class, a.score), (&b.class, b.score));
        let [p, q] = [a, b].map(|d| center(d.bbox.map(f64::from)));
        assert!((q[0] - p[0] - 120.0).abs() < 1e-3 && (q[1] - p[1]).abs() < 1e-3, "{p:?} {q:?}");
        assert!((a.center_mm[0] - b.center_mm[0]).abs() < 1e-4, "{a:?} {b:?}");
    }

    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..3)
            .map(|_| scope.spawn(|| detector.detect(&picture).expect("detections")))
            .collect();
        for thread in threads {
            assert_same(&first, &thread.join().expect("no panic"));
        }
    });
}

/// A camera's buffer: padded rows, blue first, and the gel in a part of it off the middle.
#[test]
fn a_frame_gives_what_its_picture_gives() {
    let detector = GpuDetector::new(config()).expect("a detector");
    let picture = sample(&samples().images[0]).to_rgb8();
    let (side, [left, top], stride) = (picture.width(), [40, 12], 3 * 1100 + 4);
    assert_eq!(picture.height(), side);
    let height = side + 20;
    let mut data = vec![0; stride * height as usize];
    for (x, y, pixel) in picture.enumerate_pixels() {
        let at = (y + top) as usize * stride + 3 * (x + left) as usize;
        let [r, g, b] = pixel.0;
        data[at..at + 3].copy_from_slice(&[b, g, r]);
    }
    let gel = Gel::Part(Rect { x: left, y: top, width: side, height: side });
    let frame = Frame::new(&data, 1100, height, PixelFormat::Bgr8).stride(stride).gel(gel);
    let want = detector.detect(&image::DynamicImage::from(picture)).expect("detections").detections;
    let found = detector.detect(&frame).expect("detections");
    assert_eq!((found.width, found.height), (1100, height));
    assert!(!want.is_empty());
    assert_eq!(found.detections.len(), want.len());
    for (a, b) in want.iter().zip(&found.detections) {
        assert_eq!((&a.class, a.score), (&b.class, b.score));
        assert_eq!(detector.model().classes[b.class_index], b.class);
        let moved = [left, top, left, top].map(|v| v as f32);
        for (i, by) in moved.into_iter().enumerate() {
            assert!((b.bbox[i] - a.bbox[i] - by).abs() < 1e-3, "{a:?} {b:?}");
        }
        let off = [0, 1].map(|i| (a.center_mm[i] - b.center_mm[i]).abs());
        assert!(off.iter().all(|mm| *mm < 1e-4), "{a:?} {b:?}");
    }
    let error = detector.detect(Frame::new(&data[..9], 2, 2, PixelFormat::Rgb8));
    assert!(matches!(error, Err(Error::Param { ref param, .. }) if param == "data"), "{error:?}");
}

#[test]
fn an_iterator_that_keeps_the_detector_gives_what_the_detector_does() {
    let detector = Arc::new(GpuDetector::new(config()).expect("a detector"));
    let pictures: Vec<_> = samples().images.iter().map(sample).collect();
    let alone: Vec<_> = pictures.iter().map(|p| detector.detect(p).expect("detections")).collect();
    let own = |p: &image::DynamicImage| {
        let bytes = p.to_rgb8().into_raw();
        Frame::new(bytes, p.width(), p.height(), PixelFormat::Rgb8)
    };
    let frames: Vec<Frame<'static>> = pictures.iter().map(own).collect();
    let found = detector.into_many(frames);
    let found: Vec<_> = found.map(|found| found.expect("detections")).collect();
    assert_eq!(found.len(), alone.len());
    found.iter().zip(&alone).for_each(|(a, b)| assert_same(a, b));
}

#[test]
fn options_choose_what_is_shown() {
    let labels = samples();
    let image = labels
        .images
        .iter()
        .max_by_key(|i| labels.annotations.iter().filter(|a| a.image_id == i.id).count());
    let picture = sample(image.expect("a sample"));
    let detect = |change: &dyn Fn(&mut Config)| {
        let mut config = config();
        change(&mut config);
        let detector = GpuDetector::new(config).expect("a detector");
        detector.detect(&picture).expect("detections").detections
    };
    let all = detect(&|c| {
        let bytes = std::fs::read(file("weights/smrnet.safetensors")).expect("the weights");
        c.weights = WeightSource::Bytes("memory".into(), Arc::from(bytes));
    });
    assert!(all.len() > 1 && all.is_sorted_by(|a, b| a.score >= b.score), "{all:?}");
    assert_eq!(detect(&|c| c.max_detections = 1), all[..1]);
    let wanted = all[0].class.clone();
    let expected: Vec<_> = all.iter().filter(|d| d.class == wanted).cloned().collect();
    assert_eq!(detect(&|c| c.classes = vec![wanted.to_lowercase()]), expected);
    assert_eq!(detect(&|c| c.score = 1.0), []);
}

#[test]
fn impossible_configurations_are_refused() {
    let refused = |change: &dyn Fn(&mut Config)| {
        let mut config = config();
        change(&mut config);
        GpuDetector::new(config).expect_err("refused")
    };
    for (name, error) in [
        ("score", refused(&|c| c.score = f32::NAN)),
        ("score", refused(&|c| c.score = 1.5)),
        ("iou", refused(&|c| c.iou = -0.1)),
        ("max_detections", refused(&|c| c.max_detections = 0)),
        ("max_detections", refused(&|c| c.max_detections = 101)),
        ("classes", refused(&|c| c.classes = vec!["screw".into()])),
        ("input_size", refused(&|c| c.input_size = Some(usize::MAX))),
    ] {
        assert!(matches!(&error, Error::Param { param, .. } if param == name), "{error}");
    }
    let error = refused(&|c| c.device = "no such adapter".parse::<Device>().expect("a device"));
    assert!(matches!(&error, Error::NoAdapter { wanted, .. } if wanted == "no such adapter"));
}

/// Between two kernels the CPU looks at the clock; how long one may take is no part of a test.
#[test]
fn the_cpu_is_held_to_the_time_limit() {
    let config = Config { device: Device::Cpu, timeout: std::time::Duration::ZERO, ..config() };
    let detector = GpuDetector::new(config).expect("a detector");
    let picture = image::open(file("samples/mixed.png")).expect("a sample");
    let error = detector.detect(&picture).expect_err("a limit");
    assert!(matches!(error, Error::Timeout { .. }), "{error}");
    let message = error.to_string();
    assert!(message.contains("did not finish the network, at stage `"), "{message}");
}

/// A frame whose bytes the CPU reads where they are has the detections of one that it copies.
#[test]
fn a_borrowed_frame_shows_what_a_copied_one_does() {
    let picture = image::open(file("samples/mixed.png")).expect("a sample").to_rgb8();
    let (width, height) = picture.dimensions();
    // Rows that begin at no pixel are copied.
    let row = 3 * width as usize;
    let mut apart = vec![7; (row + 1) * height as usize];
    for (to, from) in apart.chunks_exact_mut(row + 1).zip(picture.as_raw().chunks_exact(row)) {
        to[..row].copy_from_slice(from);
    }
    let detector =
        GpuDetector::new(Config { device: Device::Cpu, ..config() }).expect("a detector");
    let look = |frame: &Frame| detector.detect(frame).expect("detections");
    let borrowed = look(&Frame::new(picture.as_raw(), width, height, PixelFormat::Rgb8));
    let copied = Frame::new(&apart, width, height, PixelFormat::Rgb8).stride(row + 1);
    let copied = look(&copied);
    assert!(!borrowed.detections.is_empty());
    assert_eq!(borrowed.detections, copied.detections);
    assert_eq!(borrowed.stages[0].stage, "frame");
}
