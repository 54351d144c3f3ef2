//! Weight files: the paper's ablations load and run, and what is hostile is refused by name.

mod support;

use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};
use serde_json::{Value as Json, json};
use smr_gpu::Error;
use smr_gpu::engine::gpu::{ProgramOptions, Slot};
use smr_gpu::engine::tensor::{Tensor, Value};
use smr_gpu::smr::{MAX_FILE, ModelConfig, Network, Variant, Wanted, Weights};

const CLASSES: usize = 2;
const ANCHORS: usize = 6;
const REDUCTION: usize = 16;

fn config(variant: Variant) -> Json {
    json!({
        "format": 1,
        "input_size": 32,
        "mean": [0.5, 0.5, 0.5],
        "std": [0.2, 0.2, 0.2],
        "classes": ["A", "B"],
        "anchor_sizes": [16.0, 32.0],
        "anchor_ratios": [0.5, 1.0, 2.0],
        "mm_per_pixel": 0.04,
        "picture_size": 1000,
        "stride": if variant.msff { 8 } else { 16 },
        "reduction": REDUCTION,
        "variant": variant,
    })
}

/// A narrow network with pose, in format 2: that of `NETWORKS["small"]` in config.py of weights/training.
fn small() -> Json {
    json!({
        "format": 2,
        "pixels_per_mm": 0.8,
        "mean": [0.5, 0.5, 0.5],
        "std": [0.2, 0.2, 0.2],
        "classes": ["A", "B"],
        "directed": ["A"],
        "anchor_sizes": [16.0, 32.0],
        "anchor_ratios": [0.5, 1.0, 2.0],
        "stride": 8,
        "variant": FULL,
        "stem": 16,
        "channels": [32, 64, 128, 192],
        "blocks": [1, 2, 3, 2],
        "reduction": 8,
        "fused": 96,
        "reweight": 32,
        "head": 192,
        "pose": true,
        "temperature": 1.5,
    })
}

fn parsed(config: &Json) -> ModelConfig {
    ModelConfig::parse(&config.to_string()).expect("a configuration")
}

const FULL: Variant = Variant::SMR_NET;

type Shapes = Vec<(String, Vec<usize>)>;

/// Names and shapes in the state dict of weights/training (model.py), without `num_batches_tracked`:
/// `SmrNet` and its parts, read there and not in the Rust network.
fn state_dict(config: &ModelConfig) -> Shapes {
    let ModelConfig { variant, stem, channels: [c2, c3, c4, c5], fused, reweight, head, .. } =
        *config;
    let mut dict = Shapes::new();
    let mut add = |name: String, shape: &[usize]| dict.push((name, shape.to_vec()));
    let mut backbone = vec![
        ("backbone.conv1".to_owned(), vec![stem, 3, 7, 7]),
        ("backbone.bn1".to_owned(), vec![stem]),
    ];
    // (stage, blocks, channels in, channels out); without MSFF-Net nothing reads conv5_x.
    let [b2, b3, b4, b5] = config.blocks;
    let stages = [(1, b2, stem, c2), (2, b3, c2, c3), (3, b4, c3, c4), (4, b5, c4, c5)];
    let stages = &stages[..if variant.msff { 4 } else { 3 }];
    for (stage, blocks, inputs, outputs) in stages {
        for block in 0..*blocks {
            let of = |part: &str| format!("backbone.layer{stage}.{block}.{part}");
            let first = if block == 0 { *inputs } else { *outputs };
            backbone.push((of("conv1"), vec![*outputs, first, 3, 3]));
            backbone.push((of("bn1"), vec![*outputs]));
            backbone.push((of("conv2"), vec![*outputs, *outputs, 3, 3]));
            backbone.push((of("bn2"), vec![*outputs]));
            if block == 0 && inputs != outputs {
                backbone.push((of("downsample.0"), vec![*outputs, *inputs, 1, 1]));
                backbone.push((of("downsample.1"), vec![*outputs]));
            }
        }
    }
    let mut attention = Vec::new();
    if variant.safe {
        let channels = [stem, c2, c3, c4, c5];
        let channels = &channels[..if variant.msff { 5 } else { 4 }];
        for (i, channels) in (1..).zip(channels) {
            attention.push((format!("backbone.cbam{i}"), *channels));
        }
    }
    let mut biased = Vec::new();
    if variant.msff {
        for (i, channels) in [(1, c3), (2, c4), (3, c5)] {
            let of = |part: &str| format!("fusion.branch{i}.{part}");
            backbone.push((of("conv"), vec![fused, channels, 3, 3]));
            backbone.push((of("bn"), vec![fused]));
            attention.push((of("cbam"), fused));
        }
        if variant.rw {
            for i in 1..=3 {
                biased.push((format!("reweight.reduce{i}"), vec![reweight, fused, 1, 1]));
            }
            biased.push(("reweight.fc1".into(), vec![reweight, 3 * reweight]));
            biased.push(("reweight.fc2".into(), vec![3, reweight]));
        } else {
            biased.push(("fusion.reduce".into(), vec![fused, 3 * fused, 1, 1]));
        }
    }
    for (name, channels) in attention {
        let hidden = channels / config.reduction;
        biased.push((format!("{name}.channel.fc1"), vec![hidden, channels]));
        biased.push((format!("{name}.channel.fc2"), vec![channels, hidden]));
        backbone.push((format!("{name}.spatial.conv"), vec![1, 2, 7, 7]));
        backbone.push((format!("{name}.spatial.bn"), vec![1]));
    }
    let width = if variant.msff { fused } else { c4 };
    if variant.rpn_conv {
        biased.push(("rpn.conv".into(), vec![width, width, 3, 3]));
    }
    biased.push(("rpn.cls".into(), vec![ANCHORS, width, 1, 1]));
    biased.push(("rpn.bbox".into(), vec![4 * ANCHORS, width, 1, 1]));
    biased.push(("roi_head.fc6".into(), vec![head, width * 7 * 7]));
    biased.push(("roi_head.fc7".into(), vec![head, head]));
    biased.push(("roi_head.cls_score".into(), vec![CLASSES + 1, head]));
    biased.push(("roi_head.bbox_pred".into(), vec![4 * (CLASSES + 1), head]));
    if config.pose {
        biased.push(("roi_head.pose".into(), vec![6, head]));
    }
    for (name, shape) in &backbone {
        add(format!("{name}.weight"), shape);
        if shape.len() == 1 {
            for part in ["bias", "running_mean", "running_var"] {
                add(format!("{name}.{part}"), shape);
            }
        }
    }
    for (name, shape) in &biased {
        add(format!("{name}.weight"), shape);
        add(format!("{name}.bias"), &shape[..1]);
    }
    dict
}

/// A tensor's bytes: matrices and kernels in f16 with variance 2 / fan-in, vectors in f32.
fn stored(name: &str, shape: &[usize], state: &mut u64) -> (Dtype, Vec<u8>) {
    let mut unit = || {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (*state >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    let elements = shape.iter().product();
    if shape.len() > 1 {
        let fan_in: usize = shape[1..].iter().product();
        let spread = (6.0 / fan_in as f32).sqrt();
        let values = (0..elements).map(|_| half::f16::from_f32(spread * unit()));
        (Dtype::F16, values.flat_map(half::f16::to_le_bytes).collect())
    } else {
        let middle = match name {
            _ if name.ends_with("running_var") => 1.0,
            // As a training starts: blocks near the identity, gates open.
            _ if name.ends_with("bn2.weight") => 0.3,
            _ if name.ends_with("weight") || name.ends_with("fc2.bias") => 1.0,
            _ if name.ends_with("spatial.bn.bias") => 2.0,
            _ => 0.0,
        };
        let values = (0..elements).map(|_| middle + 0.1 * unit());
        (Dtype::F32, values.flat_map(f32::to_le_bytes).collect())
    }
}

type Stored = (String, Vec<usize>, Dtype, Vec<u8>);

fn tensors(config: &Json) -> Vec<Stored> {
    let mut state = 7;
    let dict = state_dict(&parsed(config)).into_iter();
    dict.map(|(name, shape)| {
        let (dtype, bytes) = stored(&name, &shape, &mut state);
        (name, shape, dtype, bytes)
    })
    .collect()
}

fn file(config: &Json, tensors: &[Stored]) -> Vec<u8> {
    let views = tensors.iter().map(|(name, shape, dtype, bytes)| {
        (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("a tensor"))
    });
    let metadata = [("config".to_owned(), config.to_string())].into();
    safetensors::serialize(views, Some(metadata)).expect("a file")
}

fn network(bytes: &[u8]) -> smr_gpu::Result<Network> {
    Network::new(Weights::from_bytes(Path::new("w"), bytes)?, [32; 2], Wanted::ALL)
}

/// Each combination of the paper's modules loads from a file with exactly the tensors that PyTorch
/// gives it, and does the same on the device and in the reference.
#[test]
fn a_file_of_every_variant_loads_and_runs() {
    let mut dicts = Vec::new();
    for bits in 0..10 {
        // Last the network that is narrow all over, and Faster R-CNN.
        let config = match bits {
            8 => small(),
            9 => config(Variant::FASTER_RCNN),
            _ => {
                let [safe, msff, rw] = [1, 2, 4].map(|bit| bits & bit == 0);
                config(Variant { safe, msff, rw, ..Variant::SMR_NET })
            }
        };
        let ModelConfig { variant, pose, .. } = parsed(&config);
        let tensors = tensors(&config);
        dicts.push((tensors.len(), digest(state_dict(&parsed(&config)))));
        let network =
            network(&file(&config, &tensors)).unwrap_or_else(|e| panic!("{variant:?}: {e}"));
        let graph = &network.graph;
        let picture = Tensor::from_fn([40 * 40], |i| (i as u32).wrapping_mul(2_654_435_761));
        let picture = Value::from(picture);
        let crop = Tensor::new([11], vec![40, 40, 0, 0, 40, 40, 32, 32, 0, 0, 2])
            .expect("eleven words")
            .into();
        let inputs = [(network.picture, &picture), (network.crop, &crop)];
        let keep = graph.computed();
        // Nothing is computed that the variant does not use.
        let has = |part: &str| keep.iter().any(|id| graph.name(*id).contains(part));
        assert_eq!(has("backbone.layer4"), variant.msff, "{variant:?}");
        assert_eq!(has("backbone.cbam5"), variant.msff && variant.safe, "{variant:?}");
        assert_eq!(has("backbone.cbam1"), variant.safe, "{variant:?}");
        assert_eq!(has("fusion.branch1"), variant.msff, "{variant:?}");
        assert_eq!(has("reweight"), variant.msff && variant.rw, "{variant:?}");
        assert_eq!(has("rpn.conv"), variant.rpn_conv, "{variant:?}");

        let (want, _) = graph.reference(&inputs, &keep).expect("the reference");
        let slot = Slot::of(support::gpu(), graph, &keep, ProgramOptions::default());
        let mut slot = pollster::block_on(slot).expect("a slot");
        let got = slot.run(&inputs).expect("a run").first();
        let mut maps = 0;
        for id in &keep {
            if !["rpn.cls", "rpn.bbox", "roi_head.pose"].contains(&graph.name(*id)) {
                continue;
            }
            maps += 1;
            let [gpu, cpu] = [&got, &want].map(|v| v[id].f32().expect("floats").data());
            let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
            let pairs = gpu.iter().zip(cpu);
            let off = size(&mut pairs.map(|(a, b)| f64::from(*a) - f64::from(*b)));
            let all = size(&mut cpu.iter().map(|b| f64::from(*b)));
            // Rounding costs some 1e-6; a layer too many or too few, everything.
            assert!(all > 0.0 && (off / all).sqrt() < 1e-4, "{variant:?}: {off} of {all}");
        }
        assert_eq!(maps, 2 + usize::from(pose), "{variant:?}");
    }
    assert_eq!(dicts, STATE_DICTS);
}

/// FNV-1a of the names and shapes, one a line, sorted: `backbone.bn1.bias [64]`.
fn digest(mut dict: Shapes) -> u64 {
    dict.sort();
    let text: String =
        dict.into_iter().map(|(name, shape)| format!("{name} {shape:?}\n")).collect();
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The number of tensors and their digest in PyTorch: `SmrNet(Config(…)).state_dict()` by variant.
const STATE_DICTS: [(usize, u64); 10] = [
    (289, 0x6a65_dd0e_b04d_3935),
    (244, 0x155a_fb7d_cea4_a142),
    (193, 0x45a8_5818_f5c0_7eca),
    (157, 0x8c79_44a6_df47_2587),
    (281, 0xbd82_6ba1_65bf_fe5b),
    (236, 0xd444_a0da_2dc0_fa56),
    (193, 0x45a8_5818_f5c0_7eca),
    (157, 0x8c79_44a6_df47_2587),
    (216, 0x608e_4fe0_f892_dab3),
    (159, 0x1fa9_cbea_00e9_5549),
];

#[test]
fn every_value_of_the_configuration_has_a_range() {
    let with = |key: &str, value: &str| {
        let text = config(FULL).to_string();
        let mut whole: serde_json::Map<String, Json> = serde_json::from_str(&text).expect("JSON");
        whole.insert(key.into(), Json::String("@".into()));
        // By text: no JSON value holds every number.
        Json::Object(whole).to_string().replace("\"@\"", value)
    };
    let name = format!("[\"{}\"]", "x".repeat(65));
    let sizes = format!("[{}]", vec!["16"; 33].join(","));
    let many = format!("[{}]", vec!["16"; 10_000].join(","));
    let cases: &[(&str, &[&str])] = &[
        ("format", &["0", "3", "-1", "1e300", "null"]),
        ("input_size", &["0", "31", "33", "1472", "4294967296", "18446744073709551616"]),
        ("mean", &["[0.5,0.5,-0.1]", "[0.5,1e39,0]", "[0.5,0.5]", "[0.5,1.5,0.5]", "[NaN,0,0]"]),
        ("std", &["[0,1,1]", "[-0.2,1,1]", "[1e-40,1,1]", "[1e39,1,1]", "[1,1,1e38]", "[]"]),
        ("classes", &["[]", r#"[""]"#, r#"[" \t"]"#, r#"["A","a"]"#, &name, r#"["A",1]"#]),
        ("classes", &[r#"["1","2","3","4","5","6","7","8","9","10","11"]"#]),
        ("anchor_sizes", &["[]", "[0]", "[-1]", "[1e-40]", "[1e39]", "[1e38]", &sizes, &many]),
        ("anchor_ratios", &["[]", "[0]", "[-1]", "[1e-30]", "[1e39]", "[1e38]", &sizes, &many]),
        // Rounded to whole pixels nothing is left of it.
        ("anchor_sizes", &["[1]"]),
        ("mm_per_pixel", &["0", "-0.04", "1e38", "1e39", "1e-40", "1e-5", "11", "null"]),
        // 32 pixels for 0.1 mm.
        ("mm_per_pixel", &["0.0001"]),
        ("picture_size", &["0", "-1", "65536", "4294967296", "1.5"]),
        ("stride", &["0", "16", "-8"]),
        ("reduction", &["0", "65", "18446744073709551615", "-16"]),
        ("variant", &["{}", "null", r#"{"safe":true,"msff":false,"rw":true}"#]),
    ];
    let whole = config(FULL).to_string();
    ModelConfig::parse(&whole).expect("a configuration");
    for (key, values) in cases {
        for value in *values {
            let message = ModelConfig::parse(&with(key, value));
            let message = message.expect_err(&format!("{key}={value} is accepted"));
            let named = match (*key, message.contains("EOF") || message.contains("line ")) {
                // serde's message has the place, not always the name.
                (_, true) => "config: ",
                // Without MSFF-Net the stride is 16.
                ("variant", _) => "stride",
                (key, _) => key,
            };
            assert!(message.contains(named), "{key}={value}: {message}");
            assert!(message.len() < 500, "{key}={value}: a message of {}", message.len());
        }
    }
    let edges = [
        ("input_size", "1440"),
        ("mean", "[0,0,1]"),
        ("std", "[0.001,0.00392156862745098,1000]"),
        ("anchor_sizes", "[2,2048]"),
        ("anchor_ratios", "[0.01,100]"),
        ("mm_per_pixel", "10"),
        ("picture_size", "65535"),
        ("reduction", "64"),
    ];
    for (key, value) in edges {
        ModelConfig::parse(&with(key, value)).unwrap_or_else(|e| panic!("{key}={value}: {e}"));
    }
    // Also where no file brings it.
    let mut config = ModelConfig::parse(&whole).expect("a configuration");
    config.reduction = 0;
    let error = Network::new(Weights::random(config, 1), [32; 2], Wanted::ALL);
    let error = error.expect_err("a range");
    assert!(error.to_string().contains("reduction: expected 1 to 64, got 0"), "{error}");
}

/// All numbers are in their ranges, and together they ask for gigabytes: 4096 maps of 720 × 720 after the
/// first convolution.
#[test]
fn a_network_that_no_device_need_hold_is_refused_before_it_runs() {
    let mut config = parsed(&config(FULL));
    let at = |config: &ModelConfig| {
        Network::new(Weights::random(config.clone(), 1), [1440; 2], Wanted::ALL)
    };
    // The paper's network at the largest input: 64 such maps are 126.6 MiB.
    at(&config).expect("a network");
    config.stem = 4096;
    match at(&config) {
        Err(Error::Capacity { needed, available, what }) => {
            assert_eq!((needed, available), (4096 * 720 * 720 * 4, 128 << 20));
            assert!(what.contains("backbone.conv1"), "{what}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_value_of_format_2_has_a_range() {
    let with = |key: &str, value: &str| {
        let mut whole = small();
        whole[key] = Json::String("@".into());
        whole.to_string().replace("\"@\"", value)
    };
    let cases: &[(&str, &[&str], &[&str])] = &[
        ("pixels_per_mm", &["0.001", "144"], &["0", "-8", "145", "1e5", "null"]),
        ("directed", &["[]", r#"["B","A"]"#], &[r#"["C"]"#, r#"["a"]"#]),
        ("stem", &["8", "4096"], &["0", "4097"]),
        ("channels", &["[8,9,4096,10]"], &["[0,64,128,192]", "[32,64,128,4097]"]),
        ("blocks", &["[1,1,64,1]"], &["[1,2,0,2]", "[1,2,3,65]"]),
        ("reduction", &["1", "16"], &["0", "17"]),
        ("fused", &["8", "4096"], &["0", "4097"]),
        ("reweight", &["1", "4096"], &["0", "4097"]),
        ("head", &["1", "4096"], &["0", "4097"]),
        ("temperature", &["0.01", "100"], &["0", "-1", "0.009", "101"]),
        ("stride", &["8"], &["16"]),
    ];
    for (key, good, bad) in cases {
        for value in *good {
            ModelConfig::parse(&with(key, value)).unwrap_or_else(|e| panic!("{key}={value}: {e}"));
        }
        for value in *bad {
            let message = ModelConfig::parse(&with(key, value));
            let message = message.expect_err(&format!("{key}={value} is accepted"));
            assert!(message.contains(key) || message.contains("line "), "{key}={value}: {message}");
        }
    }
    // None of it may be missing, nor may a list be shorter.
    for key in small().as_object().expect("an object").keys() {
        let mut whole = small();
        whole.as_object_mut().expect("an object").remove(key);
        let message = ModelConfig::parse(&whole.to_string()).expect_err("a missing key");
        assert!(message.contains(key.as_str()), "{key}: {message}");
    }
    assert!(ModelConfig::parse(&with("channels", "[1,2,3]")).is_err());
    // What is written is read.
    let config = parsed(&small());
    assert_eq!(parsed(&serde_json::to_value(&config).expect("JSON")), config);
}

fn refusal(bytes: &[u8]) -> String {
    // Not `expect_err`, which would print the network's numbers.
    network(bytes).map_or_else(|e| e.to_string(), |_| "accepted".into())
}

#[test]
fn hostile_files_are_refused_by_name() {
    // The header's length says more than any file has, or more than a header may.
    for length in [u64::MAX, 1 << 40, (1 << 20) + 1] {
        let mut bytes = length.to_le_bytes().to_vec();
        bytes.resize(2 << 20, b' ');
        let message = refusal(&bytes);
        assert!(message.contains("expected a header of at most 1048576 bytes"), "{message}");
    }
    for bytes in [&[][..], &[0; 7], &[0; 8], &[1; 8]] {
        assert!(refusal(bytes).contains("not a whole safetensors file"));
    }
    let many: Vec<Stored> =
        (0..4097).map(|i| (i.to_string(), vec![0], Dtype::F32, vec![])).collect();
    let message = refusal(&file(&config(FULL), &many));
    assert!(message.contains("expected at most 4096 tensors, got 4097"), "{message}");
    let all = tensors(&config(FULL));
    let with = |name: &str, value: f32| {
        let mut all = all.clone();
        // A variance of 0 is told from a division by it by its epsilon, and makes a scale of 316.
        for (name, value) in [("backbone.bn1.running_var", 0.0), (name, value)] {
            let found = all.iter_mut().find(|(n, ..)| n == name).expect("the tensor");
            for element in found.3.chunks_exact_mut(4) {
                element.copy_from_slice(&f32::to_le_bytes(value));
            }
        }
        file(&config(FULL), &all)
    };
    // (vector, value, what must be in the message)
    let cases: [(&str, f32, &[&str]); 5] = [
        ("backbone.bn1.weight", 3e38, &["`backbone.conv1.weight` with `backbone.bn1`", "folded"]),
        ("backbone.bn1.running_mean", -3e38, &["`backbone.conv1.bias` with", "folded"]),
        ("backbone.bn1.running_var", -1e-40, &["`backbone.bn1.running_var`", "at least 0"]),
        ("backbone.bn1.bias", f32::INFINITY, &["`backbone.bn1.bias`", "finite", "inf at 0"]),
        ("rpn.cls.bias", f32::NAN, &["`rpn.cls.bias`", "finite", "NaN at 0"]),
    ];
    for (name, value, phrases) in cases {
        let message = refusal(&with(name, value));
        assert!(phrases.iter().all(|p| message.contains(p)), "{name}={value}: {message}");
    }
    for variance in [0.0, 1e-45, 3e38] {
        assert_eq!(refusal(&with("backbone.bn1.running_var", variance)), "accepted");
    }
}

/// Tensors are read when they are wanted: what was written over a file meanwhile is not mixed with what was
/// looked at.
#[test]
fn a_file_that_is_written_to_after_it_was_opened_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("w.safetensors");
    std::fs::write(&path, file(&config(FULL), &tensors(&config(FULL)))).expect("written");
    let weights = Weights::open(&path).expect("the weights");
    let network = || Network::new(weights.clone(), [32; 2], Wanted::ALL);
    network().expect("a network");
    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(1);
    let written = std::fs::File::options().write(true).open(&path).expect("the file");
    written.set_modified(later).expect("a time");
    let message = network().expect_err("a change").to_string();
    assert!(message.contains("w.safetensors: expected the file as it was opened"), "{message}");
}

#[cfg(unix)]
#[test]
fn only_regular_files_of_a_bearable_length_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("w.safetensors");
    // A hole: its length is looked at, not its bytes.
    let long = std::fs::File::create(&path).expect("created");
    long.set_len(MAX_FILE + 1).expect("a long file");
    let open = |path: &Path| Weights::open(path).expect_err("an error").to_string();
    let message = open(&path);
    assert!(message.contains("expected at most 268435456 bytes, got 268435457"), "{message}");
    assert!(message.contains("w.safetensors"), "{message}");
    let message = open(folder.path());
    assert!(message.contains("expected a file, got a folder"), "{message}");
    let message = open(Path::new("/dev/zero"));
    assert!(message.contains("expected a file, got a device"), "{message}");
}
