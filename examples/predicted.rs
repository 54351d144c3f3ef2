//! Predicts from the kernels' sizes alone how the network would run on GPUs that nobody here has: the
//! tables of docs/kernels.md.
//!
//! ```sh
//! cargo run --release --example predicted -- weights/smrnet.safetensors
//! ```
//!
//! A command takes as long as its multiply-adds at the GPU's rate or its bytes at that of its memory,
//! whichever is longer; where it has fewer invocations than the GPU needs to hide its latencies, so
//! much longer. That leaves out caches, launches, registers that spill, and all that a driver does.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;

use smr_gpu::Precision;
use smr_gpu::kernels::Caps;
use smr_gpu::lower::Choice;
use smr_gpu::model::{Network, Wanted, Weights};
use smr_gpu::profile::{Cost, costs};

/// A class of GPUs.
struct Class {
    name: &'static str,
    /// Invocations of a subgroup, if they are always as many.
    subgroup: Option<u32>,
    /// 10⁹ multiply-adds in f32 a second: twice the data sheet's "FLOPS" are counted by vendors.
    gmac: f64,
    /// 10⁹ bytes a second.
    gbytes: f64,
    /// Invocations that keep it busy: lanes times the four that hide a multiply-add's latency.
    busy: f64,
}

/// From the vendors' data sheets: cores × clock, memory clock × width.
const CLASSES: [Class; 5] = [
    // 16 subgroups of 8 QPUs' 4 lanes; LPDDR4X shared with the CPU.
    Class { name: "Raspberry Pi 5", subgroup: Some(16), gmac: 31.0, gbytes: 17.0, busy: 512.0 },
    // 1024 cores at 625 MHz; LPDDR5.
    Class { name: "Jetson Orin Nano", subgroup: Some(32), gmac: 640.0, gbytes: 68.0, busy: 4096.0 },
    // 96 units of 8 lanes at 1.35 GHz; subgroups of 8, 16 or 32.
    Class { name: "Intel Iris Xe", subgroup: None, gmac: 1037.0, gbytes: 68.0, busy: 3072.0 },
    // 8 cores of 128 lanes at 1.28 GHz.
    Class { name: "Apple M1", subgroup: Some(32), gmac: 1310.0, gbytes: 68.0, busy: 4096.0 },
    // 3072 cores at 2.46 GHz.
    Class {
        name: "NVIDIA RTX 4060",
        subgroup: Some(32),
        gmac: 7560.0,
        gbytes: 272.0,
        busy: 12288.0,
    },
];

/// Sums over a kernel's commands.
#[derive(Default)]
struct Total {
    commands: usize,
    multiply_adds: f64,
    bytes: f64,
    least_workgroups: Option<u64>,
    seconds: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args_os().nth(1).map(PathBuf::from).ok_or("expected a weight file")?;
    let wanted = Wanted { score: 0.05, ..Wanted::ALL };
    let weights = Weights::open(&file)?;
    let size = weights.config().paper_size();
    let network = Network::new(weights, [size; 2], wanted)?;
    println!("{} at {size} × {size}, predicted\n", file.display());
    for class in &CLASSES {
        let caps = Caps { subgroup: class.subgroup, ..Caps::default() };
        let costs = costs(&network.graph, &caps, &Choice::default(), Precision::F32)?;
        let mut totals: BTreeMap<&str, Total> = BTreeMap::new();
        for cost in &costs {
            let total = totals.entry(&cost.kernel).or_default();
            total.commands += 1;
            total.multiply_adds += cost.multiply_adds as f64;
            total.bytes += cost.bytes as f64;
            total.seconds += seconds(class, cost);
            if cost.workgroups > 0 {
                let least = total.least_workgroups.unwrap_or(u64::MAX);
                total.least_workgroups = Some(least.min(cost.workgroups));
            }
        }
        print(class, totals);
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

fn print(class: &Class, totals: BTreeMap<&str, Total>) {
    let Class { name, gmac, gbytes, .. } = class;
    println!("### {name}: {gmac} GMAC/s, {gbytes} GB/s\n");
    println!(
        "| kernel | commands | GMAC | MB | MAC a byte | fewest workgroups | ms | of its roof |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let all: f64 = totals.values().map(|t| t.seconds).sum();
    let mut rows: Vec<_> = totals.into_iter().collect();
    rows.sort_by(|a, b| b.1.seconds.total_cmp(&a.1.seconds));
    let (shown, others): (Vec<_>, Vec<_>) = rows.iter().partition(|(_, t)| t.seconds > 0.02 * all);
    for (kernel, t) in shown {
        // The roof over this intensity: of multiply-adds or of memory, whichever is lower.
        let roof = (t.multiply_adds / (gmac * 1e9)).max(t.bytes / (gbytes * 1e9));
        println!(
            "| {kernel} | {} | {:.2} | {:.1} | {:.1} | {} | {:.2} | {:.0} % |",
            t.commands,
            t.multiply_adds / 1e9,
            t.bytes / 1e6,
            t.multiply_adds / t.bytes,
            t.least_workgroups.map_or("by count".into(), |n| n.to_string()),
            t.seconds * 1e3,
            100.0 * roof / t.seconds.max(1e-12),
        );
    }
    let (commands, seconds): (Vec<_>, Vec<_>) =
        others.iter().map(|(_, t)| (t.commands, t.seconds)).unzip();
    println!(
        "| {} others | {} | | | | | {:.2} | |",
        others.len(),
        commands.iter().sum::<usize>(),
        seconds.iter().sum::<f64>() * 1e3
    );
    println!("| **all** | | | | | | **{:.1}** | |\n", all * 1e3);
}
