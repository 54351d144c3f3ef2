//! Faults planted in a run, each of which [`super::compare`] must find.

use std::path::Path;

use super::{Choices, How, Outcome, Values, compare};
use crate::engine::graph::TensorId;
use crate::engine::ops::Crop;
use crate::engine::tensor::{Tensor, Value};
use crate::smr::{Network, Wanted, Weights};

/// Side of the network's input, small for speed.
const SIZE: usize = 96;

fn bytes() -> Vec<u8> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/smrnet.safetensors");
    std::fs::read(file).expect("the weights")
}

fn network(bytes: &[u8], iou: f32) -> Network {
    let weights = Weights::from_bytes(Path::new("weights"), bytes).expect("weights");
    // Every box counts, so that each stage has something to lose.
    let wanted = Wanted { iou, ..Wanted::ALL };
    Network::new(weights, [SIZE; 2], wanted).expect("a network")
}

/// A run of the reference over a picture, as a device's.
struct Run {
    network: Network,
    pixels: Value,
    crop: Value,
    healthy: Values,
}

impl Run {
    fn new() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/mixed.png");
        let rgba = image::open(file).expect("the sample").to_rgba8();
        let crop = Crop::central(rgba.width() as usize, rgba.height() as usize, SIZE);
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(rgba.as_raw());
        let crop = crop.to_tensor(words.len()).expect("a crop").into();
        let pixels = Tensor::new([words.len()], words).expect("pixels").into();
        let mut run =
            Self { network: network(&bytes(), 0.5), pixels, crop, healthy: Values::new() };
        run.healthy = run.run(&run.network, |_, _| ());
        run
    }

    fn inputs(&self) -> [(TensorId, &Value); 2] {
        [(self.network.picture, &self.pixels), (self.network.crop, &self.crop)]
    }

    /// All tensors of a run of `network` in which `alter` changes what was computed.
    fn run(&self, network: &Network, mut alter: impl FnMut(&str, &mut Value)) -> Values {
        let graph = &network.graph;
        let named = |id: TensorId, value: &mut Value| alter(graph.name(id), value);
        graph.reference_with(&self.inputs(), &graph.computed(), named).expect("a run").0
    }

    fn compare(&self, device: &Values) -> Outcome {
        let scale = 1000.0 / SIZE as f64;
        compare(&self.network, &self.inputs(), [device, &self.healthy], scale, How::default())
            .expect("a comparison")
    }

    /// Plants a fault in each of `tensors`, and expects each found where it is and nowhere else: what
    /// follows has the device's own inputs.
    fn finds(&self, what: &str, tensors: &[&str], alter: impl Fn(&mut Value)) -> Outcome {
        let mut altered = 0;
        let device = self.run(&self.network, |name, value| {
            if tensors.contains(&name) {
                alter(value);
                altered += 1;
            }
        });
        assert_eq!(altered, tensors.len(), "{what}: one of {tensors:?} is no tensor's name");
        let outcome = self.compare(&device);
        assert_eq!(failing(&outcome), tensors, "{what}");
        outcome
    }
}

/// The names of the tensors that failed.
fn failing(outcome: &Outcome) -> Vec<String> {
    let tensors = outcome.stages.iter().flatten();
    tensors.filter(|t| t.failure.is_some()).map(|t| t.name.clone()).collect()
}

fn floats(value: &mut Value) -> &mut [f32] {
    match value {
        Value::F32(t) => t.data_mut(),
        Value::U32(_) => panic!("integers"),
    }
}

fn integers(value: &mut Value) -> &mut [u32] {
    match value {
        Value::U32(t) => t.data_mut(),
        Value::F32(_) => panic!("floats"),
    }
}

#[test]
fn a_healthy_run_has_no_failure() {
    let run = Run::new();
    let outcome = run.compare(&run.healthy);
    assert_eq!(failing(&outcome), [""; 0]);
    let tensors: Vec<_> = outcome.stages.iter().flatten().collect();
    assert!(tensors.len() >= 100, "only {}", tensors.len());
    assert!(tensors.iter().all(|t| t.share == 0.0 && t.drift.is_none_or(|d| d == 0.0)));
    for choice in [&outcome.proposals, &outcome.detections] {
        assert!(choice.found > 10 && choice.found == choice.expected, "{choice:?}");
        assert!(choice.excused.is_empty() && choice.failures.is_empty(), "{choice:?}");
    }
}

#[test]
fn an_output_scaled_by_a_hair_is_found() {
    let run = Run::new();
    let by =
        |factor: f32| move |value: &mut Value| floats(value).iter_mut().for_each(|x| *x *= factor);
    let tensors = [
        "input",
        "backbone.conv1",
        "backbone.layer1.1.conv2",
        "backbone.layer3.2.conv1",
        "backbone.layer4",
        "fusion.branch3.conv",
        "fusion.branch3",
        "fusion.fused",
        "rpn.cls",
        "rpn.bbox",
        "roi_head.pool",
        "roi_head.fc6",
        "roi_head.fc7",
        "roi_head.cls_score",
        "roi_head.bbox_pred",
        "roi_head.decode.margins",
    ];
    run.finds("scaled by 1.0001", &tensors, by(1.0001));
}

#[test]
fn exchanged_channels_are_found() {
    let tensors = ["backbone.conv1", "backbone.layer3.2.conv1", "fusion.fused", "rpn.cls"];
    Run::new().finds("two channels exchanged", &tensors, |value| {
        let area: usize = value.spec().shape.0[1..].iter().product();
        let (first, second) = floats(value).split_at_mut(area);
        first.swap_with_slice(&mut second[..area]);
    });
}

/// A wrong order of ties is one: the values tell nothing of it, the indices do.
#[test]
fn a_wrong_choice_is_found() {
    let run = Run::new();
    let tensors = ["rpn.top_k.indices", "rpn.nms.keep", "roi_head.nms.keep"];
    run.finds("two exchanged", &tensors, |value| integers(value).swap(3, 4));
    let one_less = |value: &mut Value| integers(value)[0] -= 1;
    let outcome = run.finds("the last proposal dropped", &["proposal_count"], one_less);
    assert_eq!(outcome.proposals.failures.len(), 1, "{:?}", outcome.proposals);
    let outcome = run.finds("the last detection dropped", &["detections.count"], one_less);
    assert_eq!(outcome.detections.failures.len(), 1, "{:?}", outcome.detections);
}

#[test]
fn one_wrong_element_is_found() {
    let tensors = ["rpn.decode.boxes", "proposals", "detections.boxes", "detections.scores"];
    Run::new().finds("one element off", &tensors, |value| floats(value)[5] += 0.001);
}

/// Of one detection the yaw is off. Its operation fails, whatever it shows; the drift tells only of a class
/// that has a direction, and of the shorter way round.
#[test]
fn the_drift_of_yaws_is_of_those_told_and_the_shorter_way_round() {
    let run = Run::new();
    let chosen =
        Choices::read(&run.network, &run.healthy).expect("what it chose").detections.chosen;
    let drift_of = |class: u32, off: f32| {
        let row = chosen.iter().position(|(_, c)| *c == class).expect("a detection of the class");
        let outcome =
            run.finds("a yaw off", &["detections.pose"], |pose| floats(pose)[5 * row] += off);
        let mut tensors = outcome.stages.iter().flatten();
        tensors.find(|t| t.name == "detections.pose").and_then(|t| t.drift).expect("a drift")
    };
    assert_eq!(run.network.config.directed, ["A"]);
    let degree = drift_of(1, 1.0);
    assert!(degree > 0.0);
    // Of an f32 near 360 the last digit is 3e-5.
    assert!((drift_of(1, 359.0) / degree - 1.0).abs() < 1e-4);
    assert_eq!(drift_of(2, 1.0), 0.0);
}

/// The largest weight of each layer is 1 % larger on the device. One that only meets units which are zero in
/// every region of this picture changes not a bit, and nothing can be found: of the RoI head's layers it is
/// the largest that meets others.
#[test]
fn a_changed_weight_is_found() {
    let run = Run::new();
    let graph = &run.network.graph;
    let rows = |name: &str| {
        let id = graph.computed().into_iter().find(|id| graph.name(*id) == name);
        run.healthy[&id.expect("a layer")].f32().expect("floats")
    };
    let [fc6, fc7] = ["roi_head.fc6", "roi_head.fc7"].map(rows);
    let units = fc7.dims()[1];
    assert_eq!(fc6.dims(), fc7.dims());
    let is_live =
        |layer: &Tensor, region: usize, unit: usize| layer.data()[region * units + unit] != 0.0;
    let layers = ["backbone.conv1", "rpn.cls", "roi_head.fc7", "roi_head.cls_score"];
    let mut changed = bytes();
    let (header, metadata) = safetensors::SafeTensors::read_metadata(&changed).expect("a header");
    for layer in layers {
        let info = metadata.info(&format!("{layer}.weight")).expect("the tensor");
        assert_eq!(info.dtype, safetensors::Dtype::F16);
        let range = 8 + header + info.data_offsets.0..8 + header + info.data_offsets.1;
        let weights: Vec<half::f16> = bytemuck::pod_collect_to_vec(&changed[range.clone()]);
        let size = |i: &usize| weights[*i].to_f32().abs();
        let counts = |i: &usize| {
            let (to, from) = (i / units, i % units);
            let mut regions = 0..fc7.dims()[0];
            match layer {
                "roi_head.fc7" => regions.any(|r| is_live(fc6, r, from) && is_live(fc7, r, to)),
                "roi_head.cls_score" => regions.any(|r| is_live(fc7, r, from)),
                _ => true,
            }
        };
        let largest = (0..weights.len()).filter(counts).max_by(|a, b| size(a).total_cmp(&size(b)));
        let largest = largest.expect("weights");
        let value = half::f16::from_f32(weights[largest].to_f32() * 1.01);
        assert_ne!(value, weights[largest]);
        changed[range][2 * largest..][..2].copy_from_slice(&value.to_le_bytes());
    }
    let device = run.run(&network(&changed, 0.5), |_, _| ());
    assert_eq!(failing(&run.compare(&device)), layers);
}

/// What a user sees is wrong too: boxes that another threshold let pass.
#[test]
fn another_threshold_is_found() {
    let run = Run::new();
    let device = run.run(&network(&bytes(), 0.7), |_, _| ());
    let outcome = run.compare(&device);
    assert_eq!(failing(&outcome), ["roi_head.nms.keep", "detections.count"]);
    assert!(!outcome.detections.failures.is_empty(), "{:?}", outcome.detections);
    assert_eq!(outcome.proposals.failures, [""; 0]);
}

/// Whatever a broken device returns for counts and indices is a failure and no panic.
#[test]
fn counts_and_indices_of_any_size_are_found() {
    let run = Run::new();
    let mut device = run.healthy.clone();
    let mut altered = Vec::new();
    for (id, value) in device.iter_mut().filter(|(_, value)| value.u32().is_ok()) {
        integers(value).fill(u32::MAX);
        altered.push(run.network.graph.name(*id).to_owned());
    }
    // A copy of the classes, and a right one.
    altered.retain(|name| name != "detections.labels");
    assert!(altered.len() >= 8, "{altered:?}");
    let failing = failing(&run.compare(&device));
    assert!(altered.iter().all(|name| failing.contains(name)), "{altered:?}, but {failing:?}");
}
