//! Every operation of the network has a case of its size there, which notices f16.

use std::collections::BTreeSet;
use std::path::Path;

use smr_gpu::Error;
use smr_gpu::engine::ops::{Expected, OPS, Op};
use smr_gpu::engine::shape::TensorSpec;
use smr_gpu::engine::tensor::{Tensor, Value};
use smr_gpu::smr::{MOST_WORK, ModelConfig, Network, Wanted, Weights};

/// An operation at a size. Its parameters count where they change what is summed.
fn size_of(op: &dyn Op, inputs: &[&TensorSpec]) -> String {
    let inputs: Vec<_> = inputs.iter().map(ToString::to_string).collect();
    let parameters = match op.name() {
        "conv2d" => format!("{op:?}"),
        // Pictures come in all sizes; what they become is the network's.
        "crop_resize" => {
            let settings = op.settings();
            return format!("crop_resize to {} × {}", settings[0].1, settings[1].1);
        }
        name => name.to_owned(),
    };
    format!("{parameters}: {}", inputs.join(", "))
}

/// The network at the paper's size, with the deepest scale or without.
fn network(deepest: bool) -> Network {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/smrnet.safetensors");
    let weights = Weights::open(&path).expect("the weights");
    let wanted = Wanted { score: 0.05, deepest, ..Wanted::ALL };
    Network::new(weights, [320; 2], wanted).expect("a network")
}

#[test]
fn every_operation_of_the_network_has_a_case_of_its_size() {
    let mut needed = BTreeSet::new();
    for deepest in [true, false] {
        let graph = network(deepest).graph;
        needed.extend(graph.operations().map(|(op, inputs)| size_of(op, &inputs)));
    }
    let mut there = BTreeSet::new();
    for case in OPS.iter().flat_map(|entry| (entry.cases)()).filter(|case| case.network) {
        let specs: Vec<_> = case.inputs.iter().map(Value::spec).collect();
        there.insert(size_of(case.op.as_ref(), &specs.iter().collect::<Vec<_>>()));
    }
    let missing: Vec<_> = needed.difference(&there).map(String::as_str).collect();
    assert!(missing.is_empty(), "no case for\n{}", missing.join("\n"));
}

/// Whether all is finite is told in a few words, not by reading back what was looked at.
#[test]
fn what_witnesses_say_is_short() {
    let network = network(true);
    let words = |id| network.graph.spec(id).shape.elements();
    let told: usize = network.witnesses.iter().map(|w| w.places.len()).sum();
    let seen: usize = network.witnesses.iter().map(|w| words(w.tensor)).sum();
    assert!(seen > 150_000 && told < 60, "{told} words about {seen}");
}

/// What is left of an input in half precision; `None` if it is no float.
fn in_half_precision(value: &Value) -> Option<Value> {
    let tensor = value.f32().ok()?;
    let half = |i: usize| half::f16::from_f32(tensor.data()[i]).to_f32();
    Some(Tensor::from_fn(tensor.shape().clone(), half).into())
}

/// The bounds are tight enough to notice that a kernel keeps one of its operands in f16, at every
/// size of the network.
#[test]
fn an_input_in_half_precision_fails_at_every_size_of_the_network() {
    let mut failures = Vec::new();
    let mut tried = 0;
    for case in OPS.iter().flat_map(|entry| (entry.cases)()).filter(|case| case.network) {
        // Non-maximum suppression gives choices, which a rounding may well leave as they are.
        if case.op.name() == "nms" {
            continue;
        }
        let expected = Expected::of(&case).expect("a reference");
        for (i, name) in case.op.inputs().into_iter().enumerate() {
            let Some(rounded) = in_half_precision(&case.inputs[i]) else { continue };
            let mut inputs = case.inputs.clone();
            inputs[i] = rounded;
            let outputs = case.op.reference(&inputs.iter().collect::<Vec<_>>()).expect("outputs");
            let report = expected.judge(&outputs, None);
            tried += 1;
            if report.failures.is_empty() {
                let share = report.max_share;
                failures.push(format!("{} / {} / {name}: {share:.2}", case.op.name(), case.name));
            }
        }
    }
    assert!(
        failures.is_empty(),
        "unnoticed, with the share of the bound:\n{}",
        failures.join("\n")
    );
    assert!(tried > 100, "only {tried}");
}

/// Layers within all ranges that would take a core half a minute.
#[test]
fn a_network_that_asks_for_too_much_work_is_refused() {
    let large = || ModelConfig::large();
    let network = |config: ModelConfig, size| {
        Network::new(Weights::random(config, 1), size, Wanted::ALL).map(|_| ())
    };
    network(large(), [320; 2]).expect("the large network");
    network(large(), [1440; 2]).expect("the large network on the largest input");
    let deep = ModelConfig { blocks: [64; 4], ..large() };
    let error = network(deep, [320; 2]).expect_err("an error");
    assert!(matches!(error, Error::Capacity { available: MOST_WORK, .. }), "{error}");
    let message = error.to_string();
    assert!(message.contains("multiplications of the weights at 320 × 320 pixels"), "{message}");
}
