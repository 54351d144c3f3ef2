//! The whole network, stage by stage: shaders against the f64 reference and against PyTorch.

mod support;

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use image::DynamicImage;
use smr_gpu::gpu::{Plan, PlanOptions};
use smr_gpu::model::{ModelConfig, Network, Thresholds, Variant, Weights};
use smr_gpu::tensor::{Tensor, Value};
use smr_gpu::{Config, Detections, Device, Error, GpuDetector};

/// The bound that each stage of the float network is held to, on the trained weights.
const RELATIVE_L2: f64 = 1e-5;
/// What a relative error of 1e-5 makes of a logit of 10, and so at most of a score.
const SCORE: f32 = 1e-4;
/// The same of a box's deltas, on 300 picture pixels, and of the box that they refer to.
const PIXELS: f32 = 0.02;
/// The same on untrained weights, whose stages amplify rounding more than trained ones do; a wrong
/// wire or shape is off by orders more.
const UNTRAINED: f64 = 1e-4;
/// What is pooled from an untrained map: it is noise, which changes by its own size from one cell
/// to the next, so that the bound above on a box of some 50 pixels, 6 cells, is 6e-4 here.
const UNTRAINED_POOLED: f64 = 6e-4;

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

/// ‖got − want‖ / ‖want‖ over the rows that a count on the device made valid.
fn relative_l2(got: &[f32], want: &[f32]) -> f64 {
    let mut difference = 0.0;
    let mut norm = 0.0;
    for (g, w) in got.iter().zip(want) {
        let (g, w) = (f64::from(*g), f64::from(*w));
        difference += (g - w).powi(2);
        norm += w * w;
    }
    if norm == 0.0 { difference.sqrt() } else { (difference / norm).sqrt() }
}

fn floats<'a>(stages: &'a [(String, Value)], name: &str) -> &'a [f32] {
    let found = stages.iter().find(|(n, _)| n == name);
    found.unwrap_or_else(|| panic!("no stage {name}")).1.f32().expect("floats").data()
}

/// Rows of a stage that are defined: what the RoI head makes of proposals that exist.
fn defined(name: &str, all: usize, proposals: usize, detections: usize) -> usize {
    match name {
        "proposals" | "proposal_scores" => all / 100 * proposals,
        n if n.starts_with("roi_head.") && !n.contains("nms") => all / 100 * proposals,
        n if n.starts_with("detections.") && n != "detections.count" => all / 100 * detections,
        _ => all,
    }
}

fn same_detections(a: &Detections, b: &Detections) {
    assert_eq!(a.detections.len(), b.detections.len());
    for (x, y) in a.detections.iter().zip(&b.detections) {
        assert_eq!(x.class, y.class);
        assert!((x.score - y.score).abs() <= SCORE, "{x:?} {y:?}");
        for (p, q) in x.bbox.iter().zip(y.bbox) {
            assert!((p - q).abs() <= PIXELS, "{x:?} {y:?}");
        }
    }
}

/// PyTorch's tensors, in float64 from the same weights: see weights/training/fixtures.py.
#[test]
fn stages_match_pytorch() {
    let bytes = std::fs::read(file("tests/fixtures/stages.safetensors")).expect("the fixture");
    let golden = safetensors::SafeTensors::deserialize(&bytes).expect("the fixture's tensors");
    let picture = image::open(file("tests/fixtures/stages.png")).expect("the fixture's picture");
    for device in [Device::default(), Device::Cpu] {
        let size = golden.tensor("pixels").expect("pixels").shape()[2];
        let detector = detector(device.clone(), |c| c.input_size = Some(size));
        let (found, stages) = detector.detect_with_stages(&picture).expect("a detection");
        let mut compared = 0;
        for (name, view) in golden.iter() {
            if view.dtype() != safetensors::Dtype::F32
                || name == "pixels"
                || name == "detections.boxes"
                || name == "detections.scores"
            {
                continue;
            }
            let want: Vec<f32> = bytemuck::pod_collect_to_vec(view.data());
            let got = floats(&stages, name);
            let error = relative_l2(&got[..want.len()], &want);
            println!("{device:?} {name}: {error:.2e}");
            assert!(error <= RELATIVE_L2, "{device:?} {name}: relative L2 error {error:.2e}");
            compared += 1;
        }
        assert!(compared >= 20, "only {compared} stages");
        let golden_floats = |name| -> Vec<f32> {
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
        }
    }
}

/// The rows of a candidates' tensor in the given order.
fn by_anchor(tensor: &Tensor, rows: &[usize]) -> Vec<f32> {
    let width: usize = tensor.dims()[1..].iter().product();
    rows.iter().flat_map(|r| &tensor.data()[r * width..(r + 1) * width]).copied().collect()
}

#[test]
fn gpu_matches_the_f64_network_on_a_sample() {
    let picture = first_sample();
    let gpu = detector(Device::default(), |_| ());
    let cpu = detector(Device::Cpu, |_| ());
    let (found, got) = gpu.detect_with_stages(&picture).expect("a detection");
    let (expected, want) = cpu.detect_with_stages(&picture).expect("a detection");
    assert!(!expected.detections.is_empty(), "the sample shows a snap");
    assert_eq!(found.proposals, expected.proposals);
    let want: HashMap<_, _> = want.into_iter().collect();
    // Among a thousand candidates some logits tie to within rounding, and their order may fall
    // either way: candidates are compared anchor by anchor. Their sorted logits are a stage too.
    let anchors = |value: &Value| value.u32().expect("indices").data().to_vec();
    let gpu_all = got.iter().find(|(n, _)| n == "rpn.top_k.indices").map(|(_, v)| anchors(v));
    let gpu_all = gpu_all.expect("the candidates");
    let cpu_all = anchors(&want["rpn.top_k.indices"]);
    let shared: BTreeSet<u32> = gpu_all.iter().filter(|a| cpu_all.contains(a)).copied().collect();
    assert!(shared.len() + 2 >= cpu_all.len(), "more than a tie at the cut differs");
    let rows = |all: &[u32]| -> Vec<usize> {
        shared.iter().filter_map(|a| all.iter().position(|b| b == a)).collect()
    };
    let (gpu_anchors, cpu_anchors) = (rows(&gpu_all), rows(&cpu_all));
    for (name, got) in &got {
        let want = &want[name];
        if let (Value::F32(got), Value::F32(want)) = (got, want) {
            let n = defined(
                name,
                got.data().len(),
                expected.proposals as usize,
                expected.detections.len(),
            );
            let error = match name.starts_with("rpn.decode.") {
                true => relative_l2(&by_anchor(got, &gpu_anchors), &by_anchor(want, &cpu_anchors)),
                false => relative_l2(&got.data()[..n], &want.data()[..n]),
            };
            println!("{name}: {error:.2e}");
            assert!(error <= RELATIVE_L2, "{name}: relative L2 error {error:.2e}");
        }
    }
    same_detections(&found, &expected);
}

#[test]
fn buffer_reuse_changes_no_bit() {
    let picture = first_sample();
    let run = |reuse| {
        let detector = detector(Device::default(), |c| {
            c.keep_stages = false;
            c.reuse_buffers = reuse;
        });
        detector.detect(&picture).expect("a detection").detections
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_second_picture_leaves_no_trace_of_the_first() {
    let picture = first_sample();
    let detector = detector(Device::default(), |c| c.keep_stages = false);
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
        format: 1,
        input_size: 64,
        mean: [0.5; 3],
        std: [0.2; 3],
        classes: vec!["A".into(), "B".into()],
        anchor_sizes: vec![16.0, 32.0],
        anchor_ratios: vec![0.5, 1.0, 2.0],
        mm_per_pixel: 0.04,
        picture_size: 1000,
        stride: if variant.msff { 8 } else { 16 },
        reduction: 16,
        variant,
    }
}

/// Each of the paper's ablations runs the same on the device as in the reference. The weights are
/// untrained, so their scores nearly tie and choices among them may fall either way: compared are
/// the maps, and what becomes of the best proposal.
#[test]
fn every_variant_matches_its_reference() {
    let full = Variant { safe: true, msff: true, rw: true };
    let variants = [
        full,
        Variant { safe: false, ..full },
        Variant { msff: false, ..full },
        Variant { rw: false, ..full },
    ];
    for variant in variants {
        let weights = Weights::random(small_config(variant), 7);
        let thresholds =
            Thresholds { score: 0.0, iou: 0.5, max_detections: 100, class_mask: u32::MAX };
        let network = Network::new(weights, 80 * 70, thresholds).expect("a network");
        let graph = &network.graph;
        let pixel = |i| (i as u32).wrapping_mul(2_654_435_761);
        let picture = Value::from(Tensor::from_fn([80 * 70], pixel));
        let crop = Tensor::new([5], vec![80, 70, 5, 0, 70]).expect("five values").into();
        let inputs = [(network.picture, &picture), (network.crop, &crop)];
        let keep = graph.computed();
        let (want, _) = graph.reference(&inputs, &keep).expect("the reference");
        let recording = graph.record(&keep).expect("a recording");
        // Guarded: what a shader reads or writes outside its tensors fails here.
        let options = PlanOptions { guard: true, ..PlanOptions::default() };
        let plan = Plan::new(support::gpu(), &recording, options);
        let got = pollster::block_on(plan).expect("a plan").run(&inputs).expect("a run").values;
        for (name, rows, bound) in [
            ("rpn.cls", None, UNTRAINED),
            ("rpn.bbox", None, UNTRAINED),
            ("proposals", Some(1), UNTRAINED),
            ("roi_head.pool", Some(1), UNTRAINED_POOLED),
            ("roi_head.cls_score", Some(1), UNTRAINED_POOLED),
            ("roi_head.bbox_pred", Some(1), UNTRAINED_POOLED),
        ] {
            let found = keep.iter().find(|id| graph.name(**id) == name);
            let id = found.unwrap_or_else(|| panic!("{variant:?} has no {name}"));
            let [got, want] = [&got, &want].map(|v| v[id].f32().expect("floats").clone());
            let row: usize = got.dims()[1..].iter().product();
            let n = rows.map_or(got.data().len(), |r: usize| r * row);
            let error = relative_l2(&got.data()[..n], &want.data()[..n]);
            assert!(error <= bound, "{variant:?} {name}: {error:.2e}");
        }
        assert!(got[&network.count].u32().expect("a count").data()[0] > 0, "{variant:?}");
    }
}

/// A weight that makes the network overflow is reported, not drawn as a box or passed over, in the
/// backbone and in the RoI head.
#[test]
fn overflow_is_reported() {
    let bytes = std::fs::read(file("weights/smrnet.safetensors")).expect("the weights");
    let (header, metadata) = safetensors::SafeTensors::read_metadata(&bytes).expect("a header");
    for tensor in ["backbone.bn1.weight", "roi_head.fc6.bias"] {
        let info = metadata.info(tensor).expect("the tensor").clone();
        assert_eq!(info.dtype, safetensors::Dtype::F32);
        let mut broken = bytes.clone();
        let start = 8 + header;
        let range = start + info.data_offsets.0..start + info.data_offsets.1;
        for value in broken[range].chunks_exact_mut(4) {
            value.copy_from_slice(&3e38f32.to_le_bytes());
        }
        let mut config = Config::new("unused");
        config.weights = smr_gpu::WeightSource::Bytes("broken".into(), broken.into());
        config.input_size = Some(64);
        let detector = GpuDetector::new(config).expect("a detector");
        let result = detector.detect(&first_sample());
        assert!(matches!(result, Err(Error::NotFinite { .. })), "{tensor}: {result:?}");
    }
}
