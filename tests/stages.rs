//! The whole network, stage by stage: shaders against the f64 reference and against PyTorch.

mod support;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use image::DynamicImage;
use smr_gpu::engine::cpu::CpuPlan;
use smr_gpu::engine::gpu::{AdapterChoice, Gpu, GpuOptions, ProgramOptions, Slot};
use smr_gpu::engine::lower::KernelChoice;
use smr_gpu::engine::ops::Crop;
use smr_gpu::engine::tensor::{Tensor, Value};
use smr_gpu::simulator::render::{Renderer, Request};
use smr_gpu::simulator::scene::{Mix, scene_seed};
use smr_gpu::smr::{ModelConfig, Network, Variant, Wanted, Weights};
use smr_gpu::verify;
use smr_gpu::verify::comparison::relative_l2;
use smr_gpu::{Config, Device, Error, Frame, GpuDetector, Precision, Savings, WeightSource};

/// The bound on each stage's relative L2 error on the pictures of these tests.
const STAGE_BOUND: f64 = 1e-5;
/// The same in f16, whose numbers are up to 4.9e-4 off: about ten layers that each add as much.
const HALF_STAGE_BOUND: f64 = 5e-3;
/// The same in bf16, and in products of 8 bits.
const BF16_STAGE_BOUND: f64 = 0.1;
const INT8_STAGE_BOUND: f64 = 0.3;
/// What a relative error of 1e-5 makes of a logit of 10, and so at most of a score.
const SCORE: f32 = 1e-4;
/// The same of a box's deltas, on 300 picture pixels, and of the box that they refer to.
const PIXELS: f32 = 0.02;
/// Half of the last digit of a yaw that `detect` prints.
const DEGREES: f32 = 0.05;
/// Corners of one detection on two devices, in picture pixels: they are chosen from the same candidates and
/// voted for by the same, so no more than rounding is between them, which comes to 1e-4. A vote that starts
/// from another candidate moves them by a tenth.
const SAME_CHOICE: f32 = 0.01;

fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn detector(device: Device, change: impl FnOnce(&mut Config)) -> GpuDetector {
    let mut config = Config::new(file("weights/smrnet.safetensors"));
    config.device = device;
    config.keep_stages = true;
    change(&mut config);
    GpuDetector::new(config).expect("a detector")
}

fn floats<'a>(stages: &'a [(String, Value)], name: &str) -> &'a [f32] {
    let found = stages.iter().find(|(n, _)| n == name);
    found.unwrap_or_else(|| panic!("no stage {name}")).1.f32().expect("floats").data()
}

#[test]
fn stages_match_pytorch() {
    match_pytorch("weights/smrnet.safetensors", "tests/fixtures/stages.safetensors");
}

#[test]
fn stages_of_the_small_network_match_pytorch() {
    match_pytorch("weights/smrnet-s.safetensors", "tests/fixtures/stages-s.safetensors");
}

/// PyTorch's tensors, in float64 from the same weights: see weights/training/fixtures.py.
fn match_pytorch(weights: &str, fixture: &str) {
    let bytes = std::fs::read(file(fixture)).expect("the fixture");
    let golden = safetensors::SafeTensors::deserialize(&bytes).expect("the fixture's tensors");
    let picture = image::open(file("tests/fixtures/stages.png")).expect("the fixture's picture");
    for device in [Device::Gpu(AdapterChoice::Auto), Device::Cpu, Device::Reference] {
        let size = golden.tensor("pixels").expect("pixels").shape()[2];
        let detector = detector(device.clone(), |c| {
            c.weights = WeightSource::File(file(weights));
            c.input_size = Some(size);
            // As the picture that it is a part of: the input is at the weights' own scale.
            c.mm_per_pixel = Some(0.04);
        });
        let (found, stages) =
            verify::stages(&detector, &Frame::from(&picture)).expect("a detection");
        let mut compared = 0;
        for (name, view) in golden.iter() {
            if view.dtype() != safetensors::Dtype::F32
                || name == "pixels"
                || name.starts_with("detections.")
            {
                continue;
            }
            let want: Vec<f32> = bytemuck::pod_collect_to_vec(view.data());
            let got = floats(&stages, name);
            // Of this one the fixture has the first proposals alone.
            let got = if name == "roi_head.pool" { &got[..want.len()] } else { got };
            let error = relative_l2(got, &want);
            println!("{device:?} {name}: {error:.2e}");
            assert!(error <= STAGE_BOUND, "{device:?} {name}: relative L2 error {error:.2e}");
            compared += 1;
        }
        assert!(compared >= 20, "only {compared} stages");
        let golden_floats = |name: &str| -> Vec<f32> {
            bytemuck::pod_collect_to_vec(golden.tensor(name).expect("a tensor").data())
        };
        let boxes = golden_floats("detections.boxes");
        let scores = golden_floats("detections.scores");
        let labels = golden.tensor("detections.labels").expect("labels");
        let labels: Vec<i32> = bytemuck::pod_collect_to_vec(labels.data());
        assert!(!labels.is_empty(), "the fixture shows a snap");
        assert_eq!(found.detections.len(), labels.len(), "{device:?}");
        let scale = picture.width().min(picture.height()) as f32 / size as f32;
        for (i, detection) in found.detections.iter().enumerate() {
            assert_eq!(detection.class, detector.model().classes[labels[i] as usize - 1]);
            assert!((detection.score - scores[i]).abs() <= SCORE, "{detection:?} {}", scores[i]);
            for (got, want) in detection.bbox.iter().zip(&boxes[4 * i..]) {
                assert!((got - want * scale).abs() <= PIXELS, "{detection:?} {want}");
            }
            // A deviation is the exponential of half a number of the size of a logit.
            let near = |got: Option<f32>, name: &str, at: usize, bound: f32| {
                let want = golden_floats(name)[at];
                let right = got.map_or(want.is_nan(), |got| (got - want).abs() <= bound);
                assert!(right, "{device:?} {name}: expected {want}, got {got:?}");
            };
            near(detection.yaw_deg, "detections.yaw", i, DEGREES);
            near(detection.yaw_std_deg, "detections.yaw_std", i, DEGREES);
            near(detection.whole, "detections.whole", i, SCORE);
            for axis in [0, 1] {
                let std = detection.center_std_mm.map(|std| std[axis]);
                near(std, "detections.centre_std", 2 * i + axis, SCORE);
            }
        }
    }
}

#[test]
fn gpu_matches_the_f64_network_on_a_sample() {
    let gpu = detector(Device::Gpu(AdapterChoice::Auto), |_| ());
    let comparison = verify::compare(&gpu, &Frame::from(&first_sample())).expect("a comparison");
    assert_eq!(comparison.failures().collect::<Vec<_>>(), [""; 0]);
    let tensors: Vec<_> = comparison.stages.iter().flat_map(|s| &s.tensors).collect();
    assert!(tensors.len() >= 100, "only {} tensors", tensors.len());
    for tensor in tensors {
        println!("{tensor:?}");
        assert!(tensor.share <= 1.0 && tensor.bias.is_none_or(|b| b <= 1.0), "{tensor:?}");
        assert!(tensor.drift.is_none_or(|d| d <= STAGE_BOUND), "{tensor:?}");
    }
    let (found, expected) = (&comparison.found, &comparison.expected);
    assert!(!expected.detections.is_empty(), "the sample shows a snap");
    assert_eq!(found.detections.len(), expected.detections.len());
    assert_eq!(found.proposals, expected.proposals);
    let shift = comparison.shift;
    assert!(shift.score <= SCORE.into() && shift.pixels <= PIXELS.into(), "{shift:?}");
}

/// Every operation stays within its bound where maps and weights are stored in f16; what drifts, drifts
/// by digits of f16.
#[test]
fn f16_matches_the_f64_network_on_a_sample() {
    let gpu = detector(Device::Gpu(AdapterChoice::Auto), |c| c.precision = Precision::F16);
    let comparison = verify::compare(&gpu, &Frame::from(&first_sample())).expect("a comparison");
    assert_eq!(comparison.failures().collect::<Vec<_>>(), [""; 0]);
    assert_eq!(comparison.found.precision, Precision::F16);
    for stage in &comparison.stages {
        println!("{} {:?}", stage.stage, stage.drift());
        assert!(stage.share() <= 1.0 && stage.bias().is_none_or(|b| b <= 1.0), "{stage:?}");
        let drift = stage.drift().unwrap_or(0.0);
        assert!(drift <= HALF_STAGE_BOUND, "{}: {drift:e}", stage.stage);
        // In f32 it would be a hundredth of that.
        assert!(!stage.stage.starts_with("backbone") || drift > STAGE_BOUND, "{}", stage.stage);
    }
    let (found, expected) = (&comparison.found, &comparison.expected);
    assert!(!expected.detections.is_empty(), "the sample shows a snap");
    assert_eq!(found.detections.len(), expected.detections.len());
}

/// What cores multiply, they multiply right: each operation is within its bound on what it read, rounded as the
/// precision says.
#[test]
fn cores_match_the_f64_network_in_each_precision() {
    for (precision, most) in [
        (Precision::F32, STAGE_BOUND),
        (Precision::Bf16, BF16_STAGE_BOUND),
        (Precision::Int8, INT8_STAGE_BOUND),
    ] {
        let cores = detector(Device::Cpu, |c| c.precision = precision);
        let comparison =
            verify::compare(&cores, &Frame::from(&first_sample())).expect("a comparison");
        assert_eq!(comparison.failures().collect::<Vec<_>>(), [""; 0], "{precision}");
        // Where these cores do not multiply it, they compute as ever.
        assert!([precision, Precision::F32].contains(&comparison.found.precision));
        for stage in &comparison.stages {
            println!("{precision} {} {:?}", stage.stage, stage.drift());
            assert!(stage.share() <= 1.0 && stage.bias().is_none_or(|b| b <= 1.0), "{stage:?}");
            let drift = stage.drift().unwrap_or(0.0);
            assert!(drift <= most, "{precision}, {}: {drift:e}", stage.stage);
        }
        let (found, expected) = (&comparison.found, &comparison.expected);
        assert!(!expected.detections.is_empty(), "the sample shows a snap");
        assert_eq!(found.detections.len(), expected.detections.len(), "{precision}");
    }
}

/// Kernels that read planar maps make those before them store f32 in a program of f16: the maps of both lie
/// alike.
#[test]
fn f16_with_planar_kernels_among_others_matches_the_f64_network() {
    for id in ["conv2d/planar", "spatial_pool/planar"] {
        let gpu = detector(Device::Gpu(AdapterChoice::Auto), |config| {
            config.precision = Precision::F16;
            config.kernels = KernelChoice::force(id).expect("a kernel");
            // Rows of 48, 24, 12, 6 and 3 pixels.
            config.input_size = Some(96);
        });
        let comparison =
            verify::compare(&gpu, &Frame::from(&first_sample())).expect("a comparison");
        // What a map loses on its way from planar f32 to quads of f16 is in no operation's own bound; a pixel
        // taken for another is a hundred times as much.
        for stage in &comparison.stages {
            let drift = stage.drift().unwrap_or(0.0);
            assert!(drift <= HALF_STAGE_BOUND, "{id}, {}: {drift:e}", stage.stage);
        }
    }
}

/// The large network with a temperature of 0.1, at which scores of all that is sure come to 1.
fn surer_weights() -> WeightSource {
    let path = file("weights/smrnet.safetensors");
    let mut bytes = std::fs::read(&path).expect("weights");
    let key = br#"\"temperature\": "#;
    let at = bytes.windows(key.len()).position(|w| w == key).expect("a temperature") + key.len();
    let digits = bytes[at..].iter().position(|b| *b == b',').expect("an end");
    bytes[at..at + digits].fill(b'0');
    bytes[at..at + 3].copy_from_slice(b"0.1");
    WeightSource::Bytes(path, bytes.into())
}

/// Of one snap several candidates have scores that are equal in f32, and not to f64: the best of them is kept on
/// every device, whatever its index.
#[test]
fn where_scores_are_equal_in_f32_their_logits_decide() {
    let picture = image::open(file("samples/stud.png")).expect("a sample");
    let weights = surer_weights();
    let mut corners: Option<[f32; 4]> = None;
    for device in [Device::Reference, Device::Cpu, Device::Gpu(AdapterChoice::Auto)] {
        let detector = detector(device.clone(), |c| {
            c.savings = Savings::NONE;
            c.weights = weights.clone();
        });
        let (found, stages) =
            verify::stages(&detector, &Frame::from(&picture)).expect("a detection");
        let temperature = f64::from(detector.model().temperature);
        let (logits, rest) = floats(&stages, "roi_head.cls_score").as_chunks::<3>();
        assert!(rest.is_empty(), "a background and two classes");
        // What all other classes are to each, smallest where it is surest: a share is 1 in 1 and that.
        let others = |row: &[f32; 3], class: usize| -> f64 {
            let to = |x: f32| (f64::from(x) - f64::from(row[class])) / temperature;
            (0..3).filter(|c| *c != class).map(|c| to(row[c]).exp()).sum()
        };
        let odds: Vec<f64> =
            logits.iter().flat_map(|row| [1, 2].map(|class| others(row, class))).collect();
        let best = (0..odds.len()).min_by(|a, b| odds[*a].total_cmp(&odds[*b])).expect("a region");
        let score = |i: usize| (1.0 / (1.0 + odds[i])) as f32;
        let first = (0..odds.len()).find(|i| score(*i) == score(best));
        assert!(first < Some(best), "{device:?}: the picture shows no such snap any more");
        let kept = stages.iter().find(|(name, _)| name == "roi_head.nms.keep").expect("a choice");
        assert_eq!(kept.1.u32().expect("indices").data()[0] as usize, best, "{device:?}");
        let bbox = found.detections[0].bbox;
        let other = *corners.get_or_insert(bbox);
        let apart = bbox.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart <= SAME_CHOICE, "{device:?}: {bbox:?}, the reference {other:?}");
    }
}

/// A picture without a snap on which proposals overlap by 0.7 to within rounding, so that one is on
/// one side alone and every later row moves.
#[test]
fn a_choice_by_rounding_is_no_failure() {
    let scene = scene_seed(2004, 5);
    let rendered = Renderer::new().render(scene, &Request::plain(Mix::None)).expect("a picture");
    let picture = DynamicImage::from(rendered.picture);
    let comparison = verify::compare(
        &detector(Device::Gpu(AdapterChoice::Auto), |_| ()),
        &Frame::from(&picture),
    )
    .expect("a comparison");
    println!("{:?}", comparison.excused().collect::<Vec<_>>());
    assert_eq!(comparison.failures().collect::<Vec<_>>(), [""; 0]);
}

/// Shared buffers against one for each tensor: every output, to the bit.
#[test]
fn buffer_reuse_changes_no_bit() {
    let weights = Weights::open(&file("weights/smrnet.safetensors")).expect("the weights");
    let wanted = Wanted { score: 0.05, ..Wanted::ALL };
    let rgba = first_sample().to_rgba8();
    let (width, height) = (rgba.width() as usize, rgba.height() as usize);
    let network = Network::new(weights, [320; 2], wanted).expect("a network");
    let words: Vec<u32> = bytemuck::pod_collect_to_vec(rgba.as_raw());
    let picture = Value::from(Tensor::new([width * height], words).expect("a word a pixel"));
    let crop = Crop::central(width, height, 320).to_tensor(width * height).expect("a crop").into();
    let run = |reuse| {
        let options = ProgramOptions { reuse, ..ProgramOptions::default() };
        let slot = Slot::of(support::gpu(), &network.graph, &[], options);
        let mut slot = pollster::block_on(slot).expect("a slot");
        let inputs = [(network.picture, &picture), (network.crop, &crop)];
        let mut values = slot.run(&inputs).expect("a run").first();
        network.graph.truncate(&inputs, &mut values);
        values
    };
    let (shared, apart) = (run(true), run(false));
    assert!(shared.len() >= 9, "only {} outputs", shared.len());
    for (id, value) in &shared {
        assert!(value.bytes() == apart[id].bytes(), "{} differs", network.graph.name(*id));
    }
}

#[test]
fn a_second_picture_leaves_no_trace_of_the_first() {
    let picture = first_sample();
    let detector = detector(Device::Gpu(AdapterChoice::Auto), |c| c.keep_stages = false);
    let first = detector.detect(&picture).expect("a detection").detections;
    // Larger than the sensor's picture, so that the buffers must grow.
    let large = DynamicImage::new_luma8(1500, 1100);
    detector.detect(&large).expect("a detection");
    assert_eq!(detector.detect(&picture).expect("a detection").detections, first);
}

fn first_sample() -> DynamicImage {
    let mut samples: Vec<_> = std::fs::read_dir(file("samples"))
        .expect("samples")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|e| e == "png"))
        .collect();
    samples.sort();
    image::open(&samples[0]).expect("a sample")
}

fn small_config(variant: Variant) -> ModelConfig {
    ModelConfig {
        anchor_sizes: vec![16.0, 32.0],
        anchor_ratios: vec![0.5, 1.0, 2.0],
        stride: if variant.msff { 8 } else { 16 },
        // Faster R-CNN's head is torchvision's.
        head: if variant == Variant::FASTER_RCNN { 1024 } else { 512 },
        variant,
        ..ModelConfig::large()
    }
}

/// Bounds checks change no bit of a whole detection, either.
#[test]
fn bounds_checks_change_no_bit() {
    let full = Variant::SMR_NET;
    let weights = Weights::random(small_config(full), 7);
    let wanted = Wanted::ALL;
    let network = Network::new(weights, [64; 2], wanted).expect("a network");
    let pixel = |i| (i as u32).wrapping_mul(2_654_435_761);
    let picture = Value::from(Tensor::from_fn([80 * 70], pixel));
    let crop = Tensor::new([11], vec![80, 70, 5, 0, 70, 70, 64, 64, 0, 0, 2])
        .expect("eleven words")
        .into();
    let inputs = [(network.picture, &picture), (network.crop, &crop)];
    let keep = network.graph.computed();
    let run = |bounds_checks| {
        let options = GpuOptions { bounds_checks, ..GpuOptions::default() };
        let gpu = pollster::block_on(Gpu::open(options)).expect("an adapter");
        let slot = Slot::of(&gpu, &network.graph, &keep, ProgramOptions::default());
        let mut slot = pollster::block_on(slot).expect("a slot");
        let mut values = slot.run(&inputs).expect("a run").first();
        network.graph.truncate(&inputs, &mut values);
        values
    };
    let (with, without) = (run(true), run(false));
    assert!(without.len() >= 100, "only {} tensors", without.len());
    for (id, value) in &without {
        assert!(value.bytes() == with[id].bytes(), "{} differs", network.graph.name(*id));
    }
}

/// Each of the paper's ablations, Faster R-CNN, and the network without its deepest scale run the same on the
/// device, in the reference and in PyTorch (float64, see weights/training/variants.py). The weights
/// are untrained, so their scores nearly tie and choices among them may fall either way: compared are
/// the maps, and what becomes of the best proposal.
#[test]
fn every_variant_matches_its_reference_and_pytorch() {
    let bytes = std::fs::read(file("tests/fixtures/variants.safetensors")).expect("the fixture");
    let golden = safetensors::SafeTensors::deserialize(&bytes).expect("the fixture's tensors");
    let full = Variant::SMR_NET;
    let all = Wanted::ALL;
    let variants = [
        ("full", full, all),
        ("no-safe", Variant { safe: false, ..full }, all),
        ("no-msff", Variant { msff: false, ..full }, all),
        ("no-rw", Variant { rw: false, ..full }, all),
        ("faster-rcnn", Variant::FASTER_RCNN, all),
        // Not the paper's: what is left out where the deepest scale hardly weighs.
        ("no-deepest", full, Wanted { deepest: false, ..all }),
    ];
    for (label, variant, wanted) in variants {
        let weights = Weights::random(small_config(variant), 7);
        let network = Network::new(weights, [64; 2], wanted).expect("a network");
        let graph = &network.graph;
        let pixel = |i| (i as u32).wrapping_mul(2_654_435_761);
        let picture = Value::from(Tensor::from_fn([80 * 70], pixel));
        let crop = Tensor::new([11], vec![80, 70, 5, 0, 70, 70, 64, 64, 0, 0, 2])
            .expect("eleven words")
            .into();
        let inputs = [(network.picture, &picture), (network.crop, &crop)];
        let keep = graph.computed();
        let names: BTreeSet<_> = keep.iter().map(|id| graph.name(*id)).collect();
        assert_eq!(names.len(), keep.len(), "{label}: two tensors share a name in a dump");
        let (want, _) = graph.reference(&inputs, &keep).expect("the reference");
        // Guarded: what a shader reads or writes outside its tensors fails here.
        let options = ProgramOptions { guard: true, ..ProgramOptions::default() };
        let slot = Slot::of(support::gpu(), graph, &keep, options);
        let mut slot = pollster::block_on(slot).expect("a slot");
        let got = slot.run(&inputs).expect("a run").first();
        let plan = CpuPlan::new(graph, &keep, None, Precision::F32).expect("a plan");
        let (host, _) = plan.run(graph, &inputs).expect("a run");
        for (name, rows) in [
            ("rpn.cls", None),
            ("rpn.bbox", None),
            ("proposals", Some(1)),
            ("roi_head.pool", Some(1)),
            ("roi_head.cls_score", Some(1)),
            ("roi_head.bbox_pred", Some(1)),
        ] {
            let found = keep.iter().find(|id| graph.name(**id) == name);
            let id = found.unwrap_or_else(|| panic!("{variant:?} has no {name}"));
            let [gpu, cpu, host] = [&got, &want, &host].map(|v| v[id].f32().expect("floats"));
            let row: usize = gpu.dims()[1..].iter().product();
            let n = rows.map_or(gpu.data().len(), |r: usize| r * row);
            let view = golden.tensor(&format!("{label}/{name}")).expect("a golden tensor");
            let pytorch: Vec<f32> = bytemuck::pod_collect_to_vec(view.data());
            assert_eq!(pytorch.len(), n, "{label} {name}");
            let pairs = [
                ("GPU and reference", gpu.data(), cpu.data()),
                ("GPU and PyTorch", gpu.data(), &pytorch),
                ("reference and PyTorch", cpu.data(), &pytorch),
                ("CPU and PyTorch", host.data(), &pytorch),
            ];
            for (pair, a, b) in pairs {
                let error = relative_l2(&a[..n], &b[..n]);
                println!("{label} {name}: {pair}: {error:.2e}");
                assert!(error <= STAGE_BOUND, "{label} {name}: {pair} differ by {error:.2e}");
            }
        }
        assert!(got[&network.count].u32().expect("a count").data()[0] > 0, "{variant:?}");
    }
}

/// The weights with every value of an f32 tensor replaced.
fn with_value(tensor: &str, value: f32) -> Vec<u8> {
    let mut bytes = std::fs::read(file("weights/smrnet.safetensors")).expect("the weights");
    let (header, metadata) = safetensors::SafeTensors::read_metadata(&bytes).expect("a header");
    let info = metadata.info(tensor).expect("the tensor");
    assert_eq!(info.dtype, safetensors::Dtype::F32);
    let start = 8 + header;
    let range = start + info.data_offsets.0..start + info.data_offsets.1;
    for old in bytes[range].chunks_exact_mut(4) {
        old.copy_from_slice(&value.to_le_bytes());
    }
    bytes
}

/// A weight that makes the network overflow is reported, not drawn as a box or passed over, in the
/// backbone and in the RoI head, by the first stage or head that shows it.
#[test]
fn overflow_is_reported() {
    // The first is just small enough to be folded into its convolution.
    let faults = [
        ("backbone.bn1.weight", 1e37f32, "backbone.conv1"),
        ("roi_head.fc6.bias", 3e38, "roi_head.cls_score"),
    ];
    for (tensor, large, witness) in faults {
        let broken = with_value(tensor, large);
        for device in [Device::Gpu(AdapterChoice::Auto), Device::Cpu] {
            let mut config = Config { device, ..Config::new("unused") };
            config.weights = smr_gpu::WeightSource::Bytes("broken".into(), broken.clone().into());
            config.input_size = Some(64);
            let detector = GpuDetector::new(config).expect("a detector");
            match detector.detect(&first_sample()) {
                Err(Error::NotFinite { stage, count }) => {
                    assert!(stage == witness && count > 0, "{tensor}: {count} in {stage}");
                }
                other => panic!("{tensor}: {other:?}"),
            }
        }
    }
}

/// What passes 65504 is looked at again in f32, and comes out as if it had been at once; what passes f32
/// too is reported.
#[test]
fn what_overflows_f16_is_repeated_in_f32() {
    let look = |bytes: &[u8], precision| {
        let config = Config::from_bytes("scaled", bytes.to_vec());
        let config =
            Config { device: Device::Gpu(AdapterChoice::Auto), input_size: Some(64), ..config };
        let detector = GpuDetector::new(Config { score: 0.0, precision, ..config });
        detector.expect("a detector").detect(&first_sample())
    };
    let large = with_value("backbone.bn1.weight", 1e6);
    let half = look(&large, Precision::F16).expect("detections");
    let single = look(&large, Precision::F32).expect("detections");
    assert_eq!((half.precision, single.precision), (Precision::F32, Precision::F32));
    assert_eq!(half.proposals, single.proposals);
    assert_eq!(half.detections, single.detections);
    let own = std::fs::read(file("weights/smrnet.safetensors")).expect("the weights");
    assert_eq!(look(&own, Precision::F16).expect("detections").precision, Precision::F16);
    let larger = with_value("backbone.bn1.weight", 1e37);
    let error = look(&larger, Precision::F16).expect_err("an overflow");
    assert!(matches!(error, Error::NotFinite { .. }), "{error}");
}

/// Where the device overflows and the reference, whose sums are in f64, does not, the comparison says so.
#[test]
fn an_overflow_that_f64_hides_is_told() {
    let config = Config::from_bytes("scaled", with_value("backbone.bn1.weight", 1e37));
    let config = Config {
        device: Device::Gpu(AdapterChoice::Auto),
        input_size: Some(64),
        keep_stages: true,
        ..config
    };
    let gpu = GpuDetector::new(config).expect("a detector");
    let error = verify::compare(&gpu, &Frame::from(&first_sample())).expect_err("an overflow");
    let Error::Overflow { stage, precision, .. } = &error else { panic!("{error}") };
    assert_eq!((stage.as_str(), precision.as_str()), ("backbone.conv1", "f32"));
}
