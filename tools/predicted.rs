//! What the kernels' sizes alone allow on GPUs: the least that the network could take there, of which
//! docs/internals/kernels.md has the table.
//!
//! ```sh
//! cargo run --release --example predicted -- weights/smrnet.safetensors
//! ```
//!
//! A command takes as long as its multiply-adds at the GPU's rate or its bytes at that of its memory,
//! whichever is longer; where it has fewer invocations than the GPU needs to hide its latencies, so
//! much longer. To that comes a time for each command, its launch and barrier, which is the one GPU's that has
//! run the network. That leaves out caches, registers that spill, and all else that a driver does.

use std::error::Error;
use std::path::PathBuf;

use smr_gpu::Precision;
use smr_gpu::engine::kernels::{Caps, Kind};
use smr_gpu::engine::lower::KernelChoice;
use smr_gpu::smr::{Network, Wanted, Weights};
use smr_gpu::verify::profile::{Cost, costs};

/// A class of GPUs.
struct Class {
    name: &'static str,
    /// Least and largest subgroups, as wgpu tells them.
    subgroups: [u32; 2],
    kind: Kind,
    /// 10⁹ multiply-adds in f32 a second: twice the data sheet's "FLOPS" are counted by vendors.
    gmac: f64,
    /// 10⁹ bytes a second.
    gbytes: f64,
    /// Invocations that keep it busy: lanes times the four that hide a multiply-add's latency.
    busy: f64,
}

/// From the vendors' data sheets: cores × clock, memory clock × width. The last is the only one that has run
/// the network, and shows what is left out.
const CLASSES: [Class; 5] = [
    // 16 subgroups of 8 QPUs' 4 lanes; LPDDR4X shared with the CPU.
    Class {
        name: "Raspberry Pi 5",
        subgroups: [16, 16],
        kind: Kind::Integrated,
        gmac: 31.0,
        gbytes: 17.0,
        busy: 512.0,
    },
    // 1024 cores at 625 MHz; LPDDR5.
    Class {
        name: "Jetson Orin Nano",
        subgroups: [32, 32],
        kind: Kind::Integrated,
        gmac: 640.0,
        gbytes: 68.0,
        busy: 4096.0,
    },
    // 96 units of 8 lanes at 1.35 GHz.
    Class {
        name: "Intel Iris Xe",
        subgroups: [8, 32],
        kind: Kind::Integrated,
        gmac: 1037.0,
        gbytes: 68.0,
        busy: 3072.0,
    },
    // 8 cores of 128 lanes at 1.28 GHz.
    Class {
        name: "Apple M1",
        subgroups: [4, 64],
        kind: Kind::Integrated,
        gmac: 1310.0,
        gbytes: 68.0,
        busy: 4096.0,
    },
    // 16896 cores at 1.98 GHz; HBM3e.
    Class {
        name: "NVIDIA H200",
        subgroups: [32, 32],
        kind: Kind::Discrete,
        gmac: 33454.0,
        gbytes: 4800.0,
        busy: 67584.0,
    },
];

/// Seconds of a command beyond what its size takes: an H200 took 4.7 ms for the large network's 217 commands of then,
/// of which sizes allow 1.9.
const COMMAND: f64 = 13e-6;

/// Shaders that the table has a column for; what is left is in the last.
const COLUMNS: [(&str, &[&str]); 2] = [
    ("convolutions", &["conv2d/direct", "conv2d/winograd_input", "conv2d/winograd_output"]),
    ("layers", &["linear/gemm", "linear/planar"]),
];

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args_os().nth(1).map(PathBuf::from).ok_or("expected a weight file")?;
    let wanted = Wanted { score: 0.05, ..Wanted::ALL };
    let weights = Weights::open(&file)?;
    let size = weights.config().paper_size();
    let network = Network::new(weights, [size; 2], wanted)?;
    println!("{} at {size} × {size}, at least, in ms\n", file.display());
    let columns = COLUMNS.map(|(name, _)| name).join(" | ");
    println!("| | GMAC/s | GB/s | MB of convolutions | {columns} | others | commands | all |");
    println!("|---|--:|--:|--:|{}--:|--:|--:|", "--:|".repeat(COLUMNS.len()));
    for class in &CLASSES {
        let caps = Caps { kind: class.kind, ..Caps::default() }.with_subgroups(class.subgroups);
        let costs = costs(&network.graph, &caps, &KernelChoice::default(), Precision::F32)?;
        let mut columns = [0.0; COLUMNS.len() + 1];
        for cost in &costs {
            let of = |(_, shaders): &(_, &[&str])| shaders.contains(&cost.kernel.as_str());
            columns[COLUMNS.iter().position(of).unwrap_or(COLUMNS.len())] += seconds(class, cost);
        }
        let convolves = |cost: &&Cost| cost.kernel.starts_with("conv2d/");
        let bytes: u64 = costs.iter().filter(convolves).map(|cost| cost.bytes).sum();
        let mb = bytes / 1_000_000;
        let ms = columns.map(|seconds| format!("{:.2}", seconds * 1e3)).join(" | ");
        let commands = costs.len();
        let all = (columns.iter().sum::<f64>() + commands as f64 * COMMAND) * 1e3;
        let Class { name, gmac, gbytes, .. } = class;
        println!("| {name} | {gmac} | {gbytes} | {mb} | {ms} | {commands} | {all:.1} |");
    }
    Ok(())
}

fn seconds(class: &Class, cost: &Cost) -> f64 {
    let sums = cost.multiply_adds as f64 / (class.gmac * 1e9);
    let bytes = cost.bytes as f64 / (class.gbytes * 1e9);
    let invocations = (cost.workgroups * cost.invocations) as f64;
    let idle = if invocations > 0.0 { (class.busy / invocations).max(1.0) } else { 1.0 };
    (sums * idle).max(bytes)
}
