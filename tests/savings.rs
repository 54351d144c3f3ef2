//! What is left out of pictures that do not need it, and that nothing else changes.

use std::path::{Path, PathBuf};

use smr_gpu::detector::MOST_REUSED;
use smr_gpu::engine::gpu::AdapterChoice;
use smr_gpu::evaluation::metrics::box_iou;
use smr_gpu::{
    CachingDetector, Config, Detections, Device, Frame, Gel, GpuDetector, PixelFormat, Precision,
    Rect, Savings, Scale, Sensor, picture,
};
use std::sync::Arc;

const SIDE: u32 = 1000;

fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn config(device: Device, savings: Savings) -> Config {
    Config { device, savings, score: 0.5, ..Config::new(file("weights/smrnet-s.safetensors")) }
}

/// Gel under uneven light, with noise of ±2 levels from a seed, where `mark` says how much brighter each
/// pixel is.
fn gel(seed: u32, gain: f32, mark: impl Fn(u32, u32) -> f32) -> Frame<'static> {
    let pixel = |i: u32| {
        let (x, y) = (i % SIDE, i / SIDE);
        // 40 levels from one corner to the other, and a vignette of 20.
        let light = 100.0 + 0.02 * (x + y) as f32;
        let [dx, dy] = [x, y].map(|at| (at as f32 - 500.0) / 500.0);
        let noise = (i ^ seed.wrapping_mul(0x9e37_79b9)).wrapping_mul(2_654_435_761) >> 24;
        let level = light - 10.0 * (dx * dx + dy * dy) + mark(x, y);
        (level * gain + (noise % 5) as f32 - 2.0).round() as u8
    };
    let pixels: Vec<u8> = (0..SIDE * SIDE).map(pixel).collect();
    Frame::new(pixels, SIDE, SIDE, PixelFormat::Gray8)
}

/// A disc of 3 mm radius round a place.
fn disc(cx: u32, cy: u32) -> impl Fn(u32, u32) -> f32 {
    move |x, y| {
        let [dx, dy] = [x.abs_diff(cx), y.abs_diff(cy)];
        if dx * dx + dy * dy < 75 * 75 { 30.0 } else { 0.0 }
    }
}

/// Printed dots of 0.6 mm, 2 mm apart.
fn dots(x: u32, y: u32) -> f32 {
    if x % 50 < 15 && y % 50 < 15 { -60.0 } else { 0.0 }
}

#[test]
fn without_contact_the_network_does_not_run() {
    let savings = Savings { contact: true, ..Savings::NONE };
    for device in [Device::Gpu(AdapterChoice::Auto), Device::Cpu, Device::Reference] {
        let detector = GpuDetector::new(config(device.clone(), savings)).expect("a detector");
        let bare = detector.detect(gel(1, 1.0, |_, _| 0.0)).expect("detections");
        assert_eq!((bare.contact, bare.detections.len()), (Some(false), 0), "{device:?}");
        assert_eq!(bare.regions, Some(vec![]), "nobody looked anywhere");
        let stages: Vec<_> = bare.stages.iter().map(|time| &time.stage[..]).collect();
        assert_eq!(stages, ["frame", "contact"]);
        assert_eq!((bare.width, bare.scale.mm_per_pixel, bare.proposals), (SIDE, 0.04, 0));
    }
    let detector = GpuDetector::new(config(Device::Cpu, savings)).expect("a detector");
    let touched = detector.detect(gel(1, 1.0, disc(500, 300))).expect("detections");
    assert_eq!(touched.contact, Some(true));
    assert!(touched.stages.len() > 2, "the network ran");
    let detector = GpuDetector::new(config(Device::Cpu, Savings::NONE)).expect("a detector");
    let bare = detector.detect(gel(1, 1.0, |_, _| 0.0)).expect("detections");
    assert_eq!(bare.contact, None, "nobody looked");
    assert!(bare.stages.len() > 1, "the network ran");
}

/// Dots look like contact, but not against a frame that has them too, in other light.
#[test]
fn a_reference_frame_tells_marks_from_contact() {
    let savings = Savings { contact: true, ..Savings::NONE };
    let contact = |config: Config, frame: &Frame| {
        let detector = GpuDetector::new(config).expect("a detector");
        detector.detect(frame).expect("detections").contact
    };
    let marked = gel(1, 1.0, dots);
    let own = config(Device::Cpu, savings);
    assert_eq!(contact(own.clone(), &marked), Some(true));
    let against = Config { reference: Some(Arc::new(gel(2, 0.8, dots))), ..own };
    assert_eq!(contact(against.clone(), &marked), Some(false));
    let pressed = gel(1, 1.0, |x, y| dots(x, y) + disc(300, 300)(x, y));
    assert_eq!(contact(against.clone(), &pressed), Some(true));
    // Frames of another size have no reference.
    let pixels = vec![128; 500 * 500];
    assert_eq!(contact(against, &Frame::new(pixels, 500, 500, PixelFormat::Gray8)), Some(false));
}

/// The library reads a sensor file's reference frame as the program does, and ignores none.
#[test]
fn a_sensor_file_brings_its_reference_frame() {
    let folder = tempfile::tempdir().expect("a folder");
    let untouched = gel(2, 0.8, dots);
    let picture =
        image::GrayImage::from_raw(SIDE, SIDE, untouched.data.to_vec()).expect("a picture");
    picture.save(folder.path().join("untouched.png")).expect("written");
    let text = format!(
        r#"{{ "name": "own", "frame": [{SIDE}, {SIDE}], "mm_per_pixel": 0.04, "reference": "untouched.png" }}"#
    );
    let file = folder.path().join("own.json");
    std::fs::write(&file, &text).expect("written");
    let sensor = Sensor::open(&file).expect("a sensor");
    let savings = Savings { contact: true, ..Savings::NONE };
    let build =
        |sensor| GpuDetector::new(Config { sensor: Some(sensor), ..config(Device::Cpu, savings) });
    let detector = build(sensor).expect("a detector");
    let contact = |frame: &Frame| detector.detect(frame).expect("detections").contact;
    assert_eq!(contact(&gel(1, 1.0, dots)), Some(false));
    let pressed = gel(1, 1.0, |x, y| dots(x, y) + disc(300, 300)(x, y));
    assert_eq!(contact(&pressed), Some(true));
    // Of text alone the file is not known.
    let alone = build(Sensor::parse(&text).expect("a sensor")).expect_err("an error").to_string();
    assert!(alone.contains("reference: expected its frame, from `Sensor::open`"), "{alone}");
    std::fs::write(&file, text.replace("1000, 1000", "1000, 900")).expect("written");
    let other = Sensor::open(&file).expect_err("an error").to_string();
    assert!(other.contains("expected 1000 × 900 pixels as the sensor's frames"), "{other}");
}

/// A press that fades in by less than one frame shows, 3.5 % of the brightness at its edge, is looked at
/// within two means of four frames.
#[test]
fn a_stream_sees_what_fades_in() {
    let savings = Savings { contact: true, ..Savings::NONE };
    let detector = GpuDetector::new(config(Device::Cpu, savings)).expect("a detector");
    let mut stream = CachingDetector::new(Arc::new(detector));
    let frame = |seed: u32| {
        let share = (seed as f32 / 3.0).min(1.0) * 4.0 / 30.0;
        gel(seed, 1.0, move |x, y| share * disc(400, 400)(x, y))
    };
    let reused: Vec<bool> =
        (0..9).map(|seed| stream.detect(frame(seed)).expect("detections").reused).collect();
    let computed: Vec<usize> = (1..reused.len()).filter(|i| !reused[*i]).collect();
    assert!(computed.len() == 1 && computed[0] <= 8, "{reused:?}");
}

/// A crop of a frame is found where the whole frame has it, in pixels and in millimetres.
#[test]
fn a_crop_changes_no_position() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/samples/stud.png");
    let picture = smr_gpu::picture::read(file).expect("a picture");
    let detector = GpuDetector::new(config(Device::Cpu, Savings::NONE)).expect("a detector");
    let snap = |frame: &Frame| {
        let found = detector.detect(frame).expect("detections").detections;
        found.into_iter().find(|d| d.class == "B" && d.score > 0.9).expect("the stud")
    };
    let whole = snap(&Frame::from(&picture));
    let crop = Rect { x: 0, y: 500, width: 480, height: 480 };
    let cut = snap(&Frame::from(&picture).crop(crop));
    // The network sees less around it: half a millimetre of a box's sides, not a factor of two.
    for (a, b) in whole.bbox.into_iter().zip(cut.bbox) {
        assert!((a - b).abs() < 12.0, "{:?} {:?}", whole.bbox, cut.bbox);
    }
    for (a, b) in whole.center_mm.into_iter().zip(cut.center_mm) {
        assert!((a - b).abs() < 0.3, "{:?} {:?}", whole.center_mm, cut.center_mm);
    }
}

/// Standard deviations are those of the weights' own scale, and unknown at another.
#[test]
fn deviations_hold_at_the_weights_scale_alone() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/samples/stud.png");
    let picture = smr_gpu::picture::read(file).expect("a picture");
    for (size, stated) in [(None, true), (Some(320), true), (Some(352), false), (Some(256), false)]
    {
        let mut config = Config { score: 0.5, ..config(Device::Cpu, Savings::NONE) };
        config.input_size = size;
        let detector = GpuDetector::new(config).expect("a detector");
        let found = detector.detect(&picture).expect("detections").detections;
        assert!(!found.is_empty(), "{size:?}");
        assert!(found.iter().all(|d| d.center_std_mm.is_some() == stated), "{size:?}: {found:?}");
    }
}

/// A sensor's frames at half their size, and its gel alone, are held to the reference too.
#[test]
fn a_reference_frame_is_scaled_and_cropped_as_the_frames_are() {
    let gel_part = Rect { x: 100, y: 200, width: 800, height: 600 };
    let untouched = gel(2, 0.8, dots);
    let frame = Some([SIDE; 2]);
    let sensor = Sensor { frame, gel: Some(gel_part), mm_per_pixel: Some(0.04), ..Sensor::plain() };
    let config = Config {
        sensor: Some(sensor),
        ..config(Device::Cpu, Savings { contact: true, ..Savings::NONE })
    };
    let detector = GpuDetector::new(Config { reference: Some(Arc::new(untouched)), ..config })
        .expect("a detector");
    let contact = |frame: Frame| detector.detect(&frame).expect("detections").contact;
    let halved = |frame: &Frame| {
        let (half, side) = (SIDE / 2, SIDE as usize);
        let mean = |i: u32| {
            let at = (i / half * 2) as usize * side + (i % half * 2) as usize;
            let four = [at, at + 1, at + side, at + side + 1].map(|at| u32::from(frame.data[at]));
            (four.iter().sum::<u32>() / 4) as u8
        };
        let pixels: Vec<u8> = (0..half * half).map(mean).collect();
        Frame::new(pixels, half, half, PixelFormat::Gray8)
    };
    let alone = |frame: &Frame| {
        let Rect { x, y, width, height } = gel_part;
        let row = |y: u32| &frame.data[(y * SIDE + x) as usize..][..width as usize];
        let pixels: Vec<u8> = (y..y + height).flat_map(row).copied().collect();
        Frame::new(pixels, width, height, PixelFormat::Gray8)
    };
    let marked = gel(1, 1.0, dots);
    let pressed = gel(1, 1.0, |x, y| dots(x, y) + disc(400, 500)(x, y));
    assert_eq!([halved(&marked), alone(&marked)].map(contact), [Some(false); 2]);
    assert_eq!([halved(&pressed), alone(&pressed)].map(contact), [Some(true); 2]);
}

/// Round the gel lies what is no gel, in the paper's whole frame.
#[test]
fn what_is_left_out_is_a_share_of_the_gel() {
    let picture = picture::read(file("samples/stud.png")).expect("a sample").into_rgb8();
    let mut whole = image::RgbImage::new(1920, 1200);
    image::imageops::replace(&mut whole, &picture, 460, 100);
    let savings = Savings { regions: true, ..Savings::NONE };
    let detector = GpuDetector::new(config(Device::Cpu, savings)).expect("a detector");
    let [alone, whole] = [picture, whole].map(|picture| {
        let (width, height) = picture.dimensions();
        let frame = Frame::new(picture.as_raw(), width, height, PixelFormat::Rgb8);
        detector.detect(&frame).expect("detections")
    });
    assert_eq!(whole.gel, Rect { x: 460, y: 100, width: 1000, height: 1000 });
    assert!(whole.regions.as_ref().is_some_and(|parts| !parts.is_empty()));
    assert_eq!(whole.left_out(&savings), alone.left_out(&savings));
}

#[test]
fn parts_and_the_best_proposals_find_the_snap_that_the_whole_finds() {
    let picture = picture::read(file("samples/stud.png")).expect("a sample").into_rgb8();
    let frame = Frame::new(picture.as_raw(), SIDE, SIDE, PixelFormat::Rgb8);
    let detect = |config: Config| {
        let detector = GpuDetector::new(config).expect("a detector");
        detector.detect(&frame).expect("detections")
    };
    let whole = detect(config(Device::Cpu, Savings::NONE));
    let [stud] = &whole.detections[..] else { panic!("one stud, not {:?}", whole.detections) };
    assert_eq!((whole.contact, &whole.regions), (None, &None));
    // The best 32 places, of many: all 32 on bare gel, fewer where they lie on one stud and overlap.
    let savings = Savings { proposals: true, most_proposals: 32, ..Savings::NONE };
    let bare = GpuDetector::new(config(Device::Cpu, savings)).expect("a detector");
    let bare = bare.detect(gel(1, 1.0, |_, _| 0.0)).expect("detections");
    assert_eq!((bare.proposals, bare.detections.len()), (32, 0));
    let best = detect(config(Device::Cpu, savings));
    assert!(whole.proposals > 32, "{} proposals", whole.proposals);
    assert!((1..=32).contains(&best.proposals), "{} proposals", best.proposals);
    assert_eq!(best.detections.len(), 1);
    let doubting = Savings { proposals: true, doubt: 1.0, ..Savings::NONE };
    let doubted = detect(config(Device::Cpu, doubting));
    assert_eq!((&doubted.detections, doubted.looked_again), (&whole.detections, true));
    // As if there had been a frame before: the other half's gel where the stud is.
    let mut bare = picture.clone();
    let [x1, y1, x2, y2] = stud.bbox;
    for y in y1 as u32 - 25..y2 as u32 + 25 {
        for x in x1 as u32 - 25..x2 as u32 + 25 {
            bare.put_pixel(x, y, *picture.get_pixel(SIDE - 1 - x, y));
        }
    }
    let reference = Frame::new(bare.into_raw(), SIDE, SIDE, PixelFormat::Rgb8);
    for device in [Device::Cpu, Device::Gpu(AdapterChoice::Auto)] {
        let parts = detect(Config {
            reference: Some(Arc::new(reference.clone())),
            ..config(device, Savings::ALL)
        });
        assert_eq!(parts.contact, Some(true));
        let [part] = parts.regions.as_deref().expect("parts") else {
            panic!("{:?}", parts.regions)
        };
        assert!(part.width < SIDE && part.height < SIDE, "{part:?}");
        let [x, y] = [(x1 + x2) / 2.0 - part.x as f32, (y1 + y2) / 2.0 - part.y as f32];
        assert!(x > 0.0 && y > 0.0 && x < part.width as f32 && y < part.height as f32);
        let [found] = &parts.detections[..] else { panic!("one stud: {:?}", parts.detections) };
        // The attention sees other surroundings; a tenth of the stud on each side is much.
        let iou = box_iou(found.bbox.map(f64::from), stud.bbox.map(f64::from));
        assert!(found.class == stud.class && iou > 0.8, "{found:?} is not {stud:?}");
    }
    // Where no score of a part is good enough all of the network looks at the whole, and its detections are
    // as ever.
    let doubting = Savings { doubt: 1.0, ..Savings::ALL };
    for device in [Device::Cpu, Device::Gpu(AdapterChoice::Auto)] {
        let whole = detect(config(device.clone(), Savings::NONE));
        let doubted = detect(Config {
            reference: Some(Arc::new(reference.clone())),
            ..config(device, doubting)
        });
        assert_eq!((doubted.contact, &doubted.regions), (Some(true), &None));
        assert_eq!((&doubted.detections, doubted.proposals), (&whole.detections, whole.proposals));
        assert_eq!((whole.looked_again, doubted.looked_again), (false, true));
        assert_eq!((doubted.without_deepest, doubted.left_out(&doubting)), (false, vec![]));
    }
    // A part in which something touches and no score is near enough is done with.
    let savings = Savings { doubt: 0.0, ..Savings::ALL };
    let detector = GpuDetector::new(config(Device::Cpu, savings)).expect("a detector");
    let touched = detector.detect(gel(1, 1.0, disc(500, 300))).expect("detections");
    assert_eq!((touched.contact, touched.detections.len()), (Some(true), 0));
    assert_eq!(touched.regions.map(|parts| parts.len()), Some(1));
}

/// Of the deepest scale nothing runs, and the snap is where it was.
#[test]
fn the_snap_is_found_without_the_deepest_scale() {
    let picture = picture::read(file("samples/stud.png")).expect("a sample");
    let detect = |device: &Device, savings| {
        let detector = GpuDetector::new(config(device.clone(), savings)).expect("a detector");
        detector.detect(&picture).expect("detections")
    };
    for device in [Device::Cpu, Device::Gpu(AdapterChoice::Auto)] {
        let whole = detect(&device, Savings::NONE);
        let scales = Savings { scales: true, ..Savings::NONE };
        let less = detect(&device, scales);
        let ran = |found: &Detections, stage: &str| found.stages.iter().any(|t| t.stage == stage);
        for stage in ["backbone.layer3", "backbone.layer4", "reweight"] {
            assert!(ran(&whole, stage), "{stage}");
            assert_eq!(ran(&less, stage), stage != "backbone.layer4", "{stage}");
        }
        assert_eq!((whole.without_deepest, less.without_deepest), (false, true));
        assert_eq!((whole.looked_again, less.looked_again), (false, false));
        assert_eq!(less.left_out(&scales), ["the deepest scale: no box was in doubt without it"]);
        let ([stud], [found]) = (&whole.detections[..], &less.detections[..]) else {
            panic!("one stud each: {:?}, {:?}", whole.detections, less.detections)
        };
        // Whatever is in doubt without it, all of the network decides.
        let doubting = Savings { doubt: 1.0, ..scales };
        let doubted = detect(&device, doubting);
        assert_eq!((doubted.without_deepest, doubted.left_out(&doubting)), (false, vec![]));
        assert_eq!(doubted.detections, whole.detections);
        // It moves, as its map is another; a tenth of the stud on each side is much.
        assert_ne!(found.bbox, stud.bbox);
        let iou = box_iou(found.bbox.map(f64::from), stud.bbox.map(f64::from));
        assert!(found.class == stud.class && iou > 0.8, "{found:?} is not {stud:?}");
    }
}

/// What runs together is windows of a size, of whichever pictures; what is left over runs alone.
#[test]
fn frames_given_together_find_what_each_finds_alone() {
    let sample = |name: &str| {
        let picture = picture::read(file(name)).expect("a sample").into_rgb8();
        Frame::new(picture.into_raw(), SIDE, SIDE, PixelFormat::Rgb8)
    };
    let [mixed, stud] = ["samples/mixed.png", "samples/stud.png"].map(sample);
    let short = Frame::new(vec![0; 7], SIDE, SIDE, PixelFormat::Rgb8);
    let oblong = Frame::new(vec![90; 300 * 200], 300, 200, PixelFormat::Gray8);
    let two = gel(3, 1.0, |x, y| disc(200, 200)(x, y) + disc(800, 800)(x, y));
    let bare = gel(1, 1.0, |_, _| 0.0);
    let frames = [mixed.clone(), bare, short, stud, two.clone(), oblong, mixed, two.clone(), two];
    let some = Savings { contact: true, proposals: true, ..Savings::NONE };
    for savings in [Savings::NONE, some, Savings::ALL] {
        let config =
            Config { input_size: Some(160), ..config(Device::Gpu(AdapterChoice::Auto), savings) };
        let detector =
            GpuDetector::new(Config { score: 0.01, batch: 2, ..config }).expect("a detector");
        let together: Vec<_> = detector.detect_many(frames.iter().cloned()).collect();
        assert_eq!(together.len(), frames.len());
        let mut found = 0;
        for (at, (together, frame)) in together.into_iter().zip(&frames).enumerate() {
            match (together, detector.detect(frame)) {
                (Ok(a), Ok(b)) => {
                    assert_eq!(a.detections, b.detections, "frame {at}");
                    let looked = |found: &Detections| {
                        let Detections { contact, without_deepest, looked_again, .. } = found;
                        (*contact, found.regions.clone(), *without_deepest, *looked_again)
                    };
                    assert_eq!(looked(&a), looked(&b), "frame {at}");
                    found += a.detections.len();
                }
                (Err(a), Err(b)) => assert_eq!((at, a.to_string()), (2, b.to_string())),
                (a, b) => panic!("frame {at}: {a:?} together, {b:?} alone"),
            }
        }
        assert!(found > 0, "nothing to compare");
    }
}

#[test]
fn impossible_scenes_are_refused() {
    for savings in [
        Savings { margin_mm: f32::NAN, ..Savings::ALL },
        Savings { most_of_input: 1.5, ..Savings::ALL },
        Savings { doubt: f32::INFINITY, ..Savings::ALL },
        Savings { most_proposals: 0, ..Savings::ALL },
    ] {
        let error = GpuDetector::new(config(Device::Cpu, savings)).expect_err("an error");
        let error = error.to_string();
        assert!(error.contains("a number from 0 to") || error.contains("1 to 100"), "{error}");
    }
}

#[test]
fn a_stream_keeps_what_did_not_change_and_no_longer_than_stated() {
    let savings = Savings { contact: true, ..Savings::NONE };
    for device in [Device::Gpu(AdapterChoice::Auto), Device::Cpu] {
        let config = Config { precision: Precision::F16, ..config(device, savings) };
        let detector = Arc::new(GpuDetector::new(config).expect("a detector"));
        let mut stream = CachingDetector::new(detector.clone());
        // Noise changes, and the light, a little.
        let still = |seed: u32| gel(seed, 1.0 - 0.002 * (seed % 5) as f32, disc(400, 400));
        let mut reused = Vec::new();
        for seed in 0..MOST_REUSED + 3 {
            let found = stream.detect(still(seed)).expect("detections");
            assert_eq!(found.contact, Some(true));
            assert_eq!(found.precision, detector.precision(), "as the frame that it equals");
            reused.push(found.reused);
        }
        let computed: Vec<usize> = (0..reused.len()).filter(|i| !reused[*i]).collect();
        assert_eq!(computed, [0, MOST_REUSED as usize + 1]);
        // A slide by a millimetre.
        assert!(!stream.detect(gel(90, 1.0, disc(425, 400))).expect("detections").reused);
        assert!(stream.detect(gel(91, 1.0, disc(425, 400))).expect("detections").reused);
        // And what is away.
        let away = stream.detect(gel(92, 1.0, |_, _| 0.0)).expect("detections");
        assert_eq!((away.reused, away.contact), (false, Some(false)));
    }
    // Without blocking, in a struct that holds both.
    struct Camera(CachingDetector);
    let detector = GpuDetector::new(config(Device::Cpu, savings)).expect("a detector");
    let mut camera = Camera(CachingDetector::new(Arc::new(detector)));
    for (seed, reused) in [(1, false), (2, true)] {
        let frame = gel(seed, 1.0, |_, _| 0.0);
        let found = pollster::block_on(camera.0.detect_async(&frame)).expect("detections");
        assert_eq!(found.reused, reused);
    }
}

/// Bare gel is alike all over but for its light, which a stream does not look at: that the view is another
/// decides.
#[test]
fn a_stream_looks_anew_at_another_view() {
    let savings = Savings { contact: true, ..Savings::NONE };
    let detector = Arc::new(GpuDetector::new(config(Device::Cpu, savings)).expect("a detector"));
    let bare = gel(1, 1.0, |_, _| 0.0);
    let square = |at: u32, side: u32| Rect { x: at, y: at, width: side, height: side };
    let part = |at, side| Gel::Part(square(at, side));
    let first = bare.clone().crop(square(200, 600)).gel(Gel::All).scale(Scale::stated(0.04));
    // The same part of another gel, at another scale with as many cells, and another part.
    let gel = first.clone().gel(part(100, 850));
    let scale = first.clone().scale(Scale::stated(0.0401));
    let crop = first.clone().crop(square(390, 600));
    for other in [gel, scale, crop] {
        let mut stream = CachingDetector::new(detector.clone());
        let mut reused = |frame| stream.detect(frame).expect("detections").reused;
        let seen = [&first, &first, &other, &other, &first].map(&mut reused);
        assert_eq!(seen, [false, true, false, true, false], "{other:?}");
    }
}

/// What two parts say is what each says of its disc alone.
#[test]
fn two_snaps_in_two_parts() {
    let savings = Savings { contact: true, regions: true, doubt: 0.0, ..Savings::NONE };
    let detector = GpuDetector::new(Config { score: 0.01, ..config(Device::Cpu, savings) })
        .expect("a detector");
    let (upper, lower) = (disc(200, 200), disc(800, 800));
    let frames =
        [gel(3, 1.0, &upper), gel(3, 1.0, &lower), gel(3, 1.0, |x, y| upper(x, y) + lower(x, y))];
    let [a, b, both] = frames.map(|frame| detector.detect(&frame).expect("detections"));
    let parts = |found: &Detections| found.regions.as_ref().map(Vec::len);
    assert_eq!([&a, &b, &both].map(parts), [Some(1), Some(1), Some(2)]);
    assert_eq!(
        both.regions,
        Some([a.regions.expect("a part"), b.regions.expect("a part")].concat())
    );
    assert_eq!(both.proposals, a.proposals + b.proposals);
}

/// Frames of sizes of their own come in their order, whatever is in flight.
#[test]
fn pictures_come_in_their_order() {
    let savings = Savings { contact: true, ..Savings::NONE };
    let config = Config { in_flight: 3, ..config(Device::Cpu, savings) };
    let detector = GpuDetector::new(config).expect("a detector");
    let sides: Vec<u32> = (0..7).map(|i| 300 + 10 * i).collect();
    let frame = |side: &u32| {
        Frame::new(vec![120; (side * side) as usize], *side, *side, PixelFormat::Gray8)
    };
    let found: Vec<u32> = detector
        .detect_many(sides.iter().map(frame).collect::<Vec<_>>())
        .map(|found| found.expect("detections").width)
        .collect();
    assert_eq!(found, sides);
}

/// A stud whose score is the asked-for one is in doubt, and after a second look still not above it.
#[test]
fn what_is_in_doubt_is_not_shown() {
    let picture = picture::read(file("samples/stud.png")).expect("a sample");
    let detect = |savings, score| {
        let config = Config { score, ..config(Device::Cpu, savings) };
        let detector = GpuDetector::new(config).expect("a detector");
        detector.detect(&picture).expect("detections")
    };
    let all = detect(Savings::NONE, 0.5).detections;
    let least = all.iter().map(|found| found.score).fold(1.0, f32::min);
    assert!(!all.is_empty());
    let doubting = Savings { proposals: true, doubt: 1.0, ..Savings::NONE };
    let found = detect(doubting, least);
    assert!(found.looked_again);
    assert!(found.detections.iter().all(|found| found.score > least), "{:?}", found.detections);
    assert_eq!(found.detections.len(), all.iter().filter(|found| found.score > least).count());
}

/// Share of the gel that the network looks at: 1 for all of it.
fn looked_at(found: &Detections) -> f64 {
    let area = |part: &Rect| f64::from(part.width) * f64::from(part.height);
    let parts = |parts: &Vec<Rect>| parts.iter().map(area).sum::<f64>() / area(&found.gel);
    found.regions.as_ref().map_or(1.0, parts)
}

/// Presses of a ball on a real GelSight, at the scale that their maker states: gel bulges and shades far from the
/// contact. The even ones set the limits of the contact map, the odd ones judge it here; the label's circle
/// lies in a part.
#[test]
fn real_presses_are_looked_at_where_the_ball_is() {
    let folder = file("tests/data/gelsight_ball_presses");
    let read = |name: &str| picture::read(folder.join(name)).expect("a picture");
    let background = Arc::new(Frame::from(&read("background.png")).into_owned());
    let table = std::fs::read_to_string(folder.join("presses.csv")).expect("a table");
    let numbers = |line: &str| line.split(',').filter_map(|cell| cell.parse().ok()).collect();
    let circles: Vec<Vec<f64>> = table.lines().skip(1).map(numbers).collect();
    assert_eq!(circles.len(), 48);
    for (reference, least) in [(None, 15), (Some(background), 20)] {
        let mine = Config {
            reference: reference.clone(),
            mm_per_pixel: Some(0.0295),
            ..config(Device::Cpu, Savings::default())
        };
        let detector = GpuDetector::new(mine).expect("a detector");
        let mut shares = Vec::new();
        for i in (1..48).step_by(2) {
            let found = detector.detect(&read(&format!("press_{i:02}.png"))).expect("detections");
            assert!(found.is_empty(), "press {i}: a ball is no snap");
            shares.push(looked_at(&found));
            let [.., x, y, radius] = circles[i][..] else { panic!("{:?}", circles[i]) };
            let holds = |part: &Rect| {
                let [left, top] = [part.x, part.y].map(f64::from);
                let [right, bottom] = [part.x + part.width, part.y + part.height].map(f64::from);
                // What the edge cuts need not be seen beyond it.
                left <= (x - radius).max(0.0)
                    && top <= (y - radius).max(0.0)
                    && right >= (x + radius).min(640.0)
                    && bottom >= (y + radius).min(480.0)
            };
            assert!(found.regions.is_none_or(|parts| parts.iter().any(holds)), "press {i}");
        }
        shares.sort_by(f64::total_cmp);
        let in_parts = shares.iter().filter(|share| **share < 1.0).count();
        let with = if reference.is_some() { "with" } else { "without" };
        assert!(in_parts >= least, "{with} a reference {in_parts} of 24: {shares:?}");
        assert!(shares[12] <= 0.55, "{with} a reference: {shares:?}");
    }
}
