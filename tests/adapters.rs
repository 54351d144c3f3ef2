//! What runs on adapters that are not here: which kernels each family takes by default, and the whole network
//! as they run it.
//!
//! An adapter's subgroups are taken for those of another where they are of a size that this one may have, too.
//! For all others they are made of workgroup memory: `Emulated`.

mod support;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use smr_gpu::engine::gpu::Gpu;
use smr_gpu::engine::kernels::{Caps, Kind};
use smr_gpu::engine::lower::{KernelChoice, works};
use smr_gpu::engine::shader::Replacement;
use smr_gpu::engine::tuned::{Place, Tuned};
use smr_gpu::smr::{Network, Wanted, Weights};
use smr_gpu::verify;
use smr_gpu::{Config, Device, Frame, GpuDetector, Precision};

const LARGE: &str = "weights/smrnet.safetensors";
const SMALL: &str = "weights/smrnet-s.safetensors";
/// What a score and a corner may be off: see tests/stages.rs.
const SCORE: f64 = 1e-4;
const PIXELS: f64 = 0.02;

fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// This adapter's capabilities but for its subgroups and its kind.
fn caps(sizes: [u32; 2], kind: Kind) -> Caps {
    Caps { kind, ..support::gpu().caps().clone() }.with_subgroups(sizes)
}

/// The kernels of an operation that run the large network by default.
fn kernels(network: &Network, op: &str, caps: &Caps) -> BTreeSet<&'static str> {
    let mut found = BTreeSet::new();
    let each = |work: &smr_gpu::engine::kernels::Work| {
        if work.op.name() == op {
            found.insert(KernelChoice::default().kernel(work)?.id());
        }
        Ok(())
    };
    works(&network.graph, (1, Precision::F32, caps), each).expect("kernels");
    found
}

/// By what wgpu 30 tells of them: see docs/internals/kernels.md.
#[test]
fn every_family_has_its_kernels() {
    let weights = Weights::open(&file(LARGE)).expect("the weights");
    let network = Network::new(weights, [320; 2], Wanted { score: 0.05, ..Wanted::ALL });
    let network = network.expect("a network");
    // Larger workgroups are fewer, so that sums are split wherever Winograd would pay.
    let small = ["conv2d/direct", "conv2d/split", "conv2d/winograd"].as_slice();
    let many = ["conv2d/direct", "conv2d/split"].as_slice();
    let few = ["conv2d/direct"].as_slice();
    let scalar = ["conv2d/scalar", "conv2d/scalar_split"].as_slice();
    use Kind::{Discrete, Integrated, Other, Software};
    for (family, sizes, kind, conv2d, linear) in [
        ("Apple", [4, 64], Integrated, many, "linear/gemm"),
        ("AMD RDNA", [32, 64], Discrete, scalar, "linear/planar"),
        ("AMD GCN", [64, 64], Discrete, scalar, "linear/planar"),
        ("Intel", [8, 32], Integrated, many, "linear/gemm"),
        ("Adreno", [64, 128], Integrated, many, "linear/gemm"),
        ("Mali", [16, 16], Integrated, small, "linear/gemm"),
        ("V3D", [16, 16], Integrated, small, "linear/gemm"),
        ("NVIDIA", [32, 32], Discrete, many, "linear/gemm"),
        ("lavapipe", [8, 8], Software, few, "linear/gemm"),
        ("SwiftShader", [4, 4], Software, few, "linear/gemm"),
        ("without subgroups", [0, 0], Other, scalar, "linear/planar"),
    ] {
        let caps = Caps { kind, ..Caps::default() }.with_subgroups(sizes);
        let found = kernels(&network, "conv2d", &caps);
        assert_eq!(found, conv2d.iter().copied().collect(), "{family}");
        assert_eq!(kernels(&network, "linear", &caps), BTreeSet::from([linear]), "{family}");
    }
}

/// A file with a choice that names what there is not is passed over, which is said: also by what measures.
#[test]
fn a_choice_of_unknown_kernels_is_told_of() {
    let gpu = support::gpu();
    let folder = tempfile::tempdir().expect("a folder");
    let file_of_choice = folder.path().join(Place::of(gpu).file_name());
    for (key, kernel, told) in [
        ("conv2d stride=1", "conv2d/of-tomorrow", Some("unknown kernel `conv2d/of-tomorrow`")),
        ("conv2d stride=1", "linear/gemm", Some("unknown kernel `linear/gemm` for `conv2d")),
        ("conv2d stride=1", "conv2d/planar", None),
    ] {
        let by_shape = [(key.to_owned(), kernel.to_owned())].into();
        let kernels = KernelChoice { by_shape, ..KernelChoice::default() };
        let tuned = Tuned { place: Place::of(gpu), kernels };
        std::fs::write(&file_of_choice, tuned.to_json()).expect("written");
        let mut config = Config { input_size: Some(64), ..Config::new(file(SMALL)) };
        config.tuned_kernels = Some(folder.path().into());
        let on = GpuDetector::on_device(gpu.clone(), config.clone());
        let remarks = pollster::block_on(on).expect("a detector").remarks();
        let detector =
            GpuDetector::new(Config { device: Device::Reference, ..config }).expect("a detector");
        let mut measured = Vec::new();
        verify::laboratory::profile(&detector, gpu, 1, |remark| measured.push(remark))
            .expect("times");
        assert_eq!(remarks, measured);
        match told {
            Some(told) => assert!(remarks.len() == 1 && remarks[0].contains(told), "{remarks:?}"),
            None => assert!(remarks.is_empty(), "{remarks:?}"),
        }
    }
}

/// Boxes within their bounds, and every operation within its own.
#[track_caller]
fn holds(what: &str, gpu: Arc<Gpu>, weights: &str, forced: &[&str]) {
    let mut config = Config { keep_stages: true, ..Config::new(file(weights)) };
    config.kernels.forced = forced.iter().map(|id| (*id).to_owned()).collect();
    let detector = pollster::block_on(GpuDetector::on_device(gpu, config)).expect("a detector");
    let picture = image::open(file("samples/mixed.png")).expect("a sample");
    let comparison = verify::compare(&detector, &Frame::from(&picture)).expect("a comparison");
    println!("{what}: {:?}", comparison.shift);
    assert_eq!(comparison.failures().collect::<Vec<_>>(), [""; 0], "{what}");
    let (found, expected) = (&comparison.found.detections, &comparison.expected.detections);
    assert_eq!((found.len(), expected.len()), (3, 3), "{what}: the sample shows three snaps");
    let shift = comparison.shift;
    assert!(shift.score <= SCORE && shift.pixels <= PIXELS, "{what}: {shift:?}");
}

#[test]
fn the_network_runs_without_subgroups() {
    holds("forced", support::gpu().clone(), LARGE, &["conv2d/scalar", "linear/planar"]);
    // The same, since there are none.
    let gpu = support::gpu().with_caps(caps([0, 0], Kind::Other));
    holds("without subgroups", gpu, SMALL, &[]);
}

/// Classes of adapters that have subgroups of several sizes.
const VARYING: [[u32; 2]; 4] = [[4, 64], [8, 32], [32, 64], [64, 128]];

/// With the subgroups that this adapter has, where the class may have them.
#[test]
fn the_network_runs_as_on_adapters_of_several_sizes() {
    let gpu = support::gpu();
    let own = [gpu.caps().subgroup_min, gpu.caps().subgroup_max];
    for class in VARYING {
        if class[0] <= own[0] && own[1] <= class[1] {
            let what = format!("subgroups of {own:?} for {class:?}");
            holds(&what, gpu.with_caps(caps(class, Kind::Discrete)), LARGE, &[]);
        }
    }
}

/// The cases of the operations that adapters with many cores compute in other variants, but those of the network's sizes,
/// which it runs itself. What lies in textures on this adapter, if it is software, lies in buffers there.
#[test]
fn cases_are_within_their_bounds_with_many_cores() {
    let gpu = support::gpu();
    let own = [gpu.caps().subgroup_min, gpu.caps().subgroup_max];
    let gpu = gpu.with_caps(caps(own, Kind::Discrete));
    for name in ["apply_gates", "channel_pool", "conv2d", "global_avg_pool", "linear", "roi_align"]
    {
        support::check_cases(&gpu, name, |case| !case.network);
    }
}

/// Subgroups of `size` invocations in workgroup memory: what a lane broadcasts it leaves there. Which lane an
/// invocation has follows from its place in no obvious way, since WGSL does not say that it does.
fn emulated(gpu: &Gpu, size: u32) -> Arc<Gpu> {
    let text = |stem: &str| {
        let file = file("wgsl").join(stem).with_extension("wgsl");
        std::fs::read_to_string(file).expect("a shader")
    };
    let replaced = |stem: &str, changes: &[(&str, &str)]| {
        let mut text = text(stem);
        for (from, to) in changes {
            assert!(text.contains(from), "{stem} has no `{from}`");
            text = text.replace(from, to);
        }
        Replacement { file: stem.into(), text }
    };
    let mut products = replaced("shared/products", &[("subgroupBroadcast(", "broadcast(")]);
    // As many lanes as some shader broadcasts from.
    products.text.push_str(&format!(
        "
#if SUBGROUPS
#if FOUR_LANES
const HELD: u32 = 4u;
#else
#if EIGHT_LANES
const HELD: u32 = 8u;
#else
const HELD: u32 = 16u;
#endif
#endif
var<workgroup> held: array<vec4<f32>, WORKGROUP * SLICES / {size}u * HELD>;
var<private> own_place: u32;
fn lane_of(local: u32) -> u32 {{
    own_place = (local * 5u + 3u) % (WORKGROUP * SLICES);
    return own_place % {size}u;
}}
fn broadcast(w: vec4<f32>, lane: u32) -> vec4<f32> {{
    let first = own_place / {size}u * HELD;
    workgroupBarrier();
    if own_place % {size}u < HELD {{
        held[first + own_place % {size}u] = w;
    }}
    workgroupBarrier();
    return held[first + lane];
}}
#endif
"
    ));
    let builtin = ("    @builtin(subgroup_invocation_id) lane: u32,\n", "\n");
    let first = "#if SPLIT\n    let place = ";
    let taken = format!("#if SUBGROUPS\n    let lane = lane_of(local);\n#endif\n{first}");
    let direct = replaced("conv2d/direct", &[builtin, (first, &taken)]);
    let taken = format!("    let lane = lane_of(local);\n{first}");
    let gemm = replaced("linear/gemm", &[builtin, (first, &taken)]);
    let counted = "    let lanes = subgroupAdd(1u);
    let begin = subgroupBroadcast(atomicAdd(&next_place, select(0u, lanes, lane == 0u)), 0u);
    return Place(begin / WORKGROUP, begin % WORKGROUP + lane);";
    let known = "    return Place(own_place / WORKGROUP, own_place % WORKGROUP);";
    let mut slices = replaced("shared/slices", &[(counted, known)]);
    let (before, rest) = slices.text.split_once("    if local == 0u {").expect("a counter");
    let (_, behind) = rest.split_once("workgroupBarrier();\n").expect("a barrier before its use");
    slices.text = format!("{before}{behind}");
    let gpu = gpu.with_replacement(products).with_replacement(direct);
    gpu.with_replacement(gemm).with_replacement(slices)
}

/// The whole network on subgroups that this adapter does not have, of sizes between and of the largest.
#[test]
fn the_network_runs_as_on_adapters_of_sizes_that_are_not_here() {
    for (class, size) in [([4, 64], 32), ([8, 32], 16), ([32, 64], 64), ([64, 128], 128)] {
        let gpu = emulated(support::gpu(), size).with_caps(caps(class, Kind::Discrete));
        holds(&format!("{size} of {class:?}"), gpu, SMALL, &[]);
    }
}
