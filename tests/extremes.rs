//! The whole network on extreme pictures and weights: finite, or an error that says where it was not.

#[path = "support/mod.rs"]
mod support;

#[path = "support/extremes.rs"]
mod extremes;

use std::path::Path;

use extremes::{Outcome, apart, changed, extremes, outcome, pixels};
use smr_gpu::{Config, Device, GpuDetector, Savings};

/// Where it shows first, of those that must not come to an end.
const LOST: &[(&str, &str)] = &[
    ("conv1 past every number", "backbone.conv1"),
    ("layer 3 past every number", "backbone.layer3"),
    ("the RoI head past every number", "roi_head.cls_score"),
];

#[test]
fn all_end_finite_or_say_where_they_did_not() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let weights = std::fs::read(root.join("weights/smrnet-s.safetensors")).expect("the weights");
    let usual = image::open(root.join("samples/mixed.png")).expect("a sample").to_rgb8();
    let mut wrong = Vec::new();
    let (mut found, mut refused) = (0, 0);
    for extreme in extremes().iter().filter(|extreme| !extreme.slow) {
        let name = extreme.name;
        let mut config = Config::from_bytes(name, changed(&weights, extreme.weights));
        config.input_size = Some(extreme.size.unwrap_or(96));
        // Nothing touches a black picture.
        config.savings = Savings::NONE;
        let on_gpu = GpuDetector::on_device(support::gpu().clone(), config.clone());
        let gpu = pollster::block_on(on_gpu).expect("a detector");
        let cpu = GpuDetector::new(Config { device: Device::Cpu, ..config }).expect("a detector");
        let (pixels, size) = pixels(extreme.picture, &usual);
        let of = |detector| outcome(detector, &pixels, size);
        let expected = LOST.iter().find(|(of, _)| *of == name).map(|(_, stage)| *stage);
        match (of(&gpu), of(&cpu)) {
            (Outcome::Finite(a), Outcome::Finite(b)) if expected.is_none() => {
                found += a.detections.len();
                // What `compare` allows: half of the last digit that `detect` prints.
                if !apart(&a, &b).is_some_and(|[corner, score]| corner <= 0.05 && score <= 0.0005) {
                    wrong.push(format!("{name}: {a:?} on the adapter, {b:?} on the CPU"));
                }
            }
            (Outcome::NotFinite(a), Outcome::NotFinite(b))
                if a == b && expected.is_none_or(|stage| a == stage) =>
            {
                refused += 1;
            }
            (gpu, cpu) => wrong.push(format!("{name}: {gpu:?} on the adapter, {cpu:?} on the CPU")),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(refused >= LOST.len());
    assert!(found > 0, "no extreme shows a snap");
}
