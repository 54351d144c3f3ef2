//! `smr-gpu devices`: the adapters, with the limits that matter here.

use serde::{Deserialize, Serialize};
use smr_gpu::engine::gpu::{AdapterReport, adapters};

use super::exit::{Exit, Failure};
use super::output::{json_line, line};
use super::probe;

/// Features that the program can use, or that later kernels may: wgpu's names and ours.
const FEATURES: [(&str, &str); 3] =
    [("TIMESTAMP_QUERY", "timestamps"), ("SHADER_F16", "f16"), ("SUBGROUP", "subgroups")];

/// List the adapters
///
/// The index is what --device takes; the first hardware adapter that lacks nothing is
/// `auto`, which without one is the CPU. Drivers are looked for in a process of its own, of which one
/// that crashes or hangs while it loads is the end.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Print one JSON object a line for each adapter.
    #[arg(long)]
    json: bool,
}

/// One adapter, as `--json` prints it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Record {
    index: usize,
    name: String,
    backend: String,
    driver: String,
    #[serde(rename = "type")]
    kind: String,
    limits: Limits,
    features: Vec<String>,
    lacks: Vec<String>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Limits {
    workgroup_memory_bytes: u32,
    workgroup_invocations: u32,
    storage_buffers_per_stage: u32,
    storage_binding_bytes: u64,
    workgroups_per_dimension: u32,
    subgroup_sizes: [u32; 2],
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let failed = |why| Failure::new(Exit::Device, why);
    let found = probe::adapters(probe::PATIENTLY).map_err(failed)?;
    if found.is_empty() {
        let message = "no GPU adapter was found; the package `mesa-vulkan-drivers` brings one";
        return Err(Failure::new(Exit::Device, message));
    }
    for record in found {
        if args.json {
            json_line(record)?;
        } else {
            print(record)?;
        }
    }
    if found.iter().all(|record| !record.lacks.is_empty()) {
        let message = "every adapter lacks something that the shaders need; the package \
                       `mesa-vulkan-drivers` brings one that lacks nothing";
        return Err(Failure::new(Exit::Device, message));
    }
    Ok(Exit::Done)
}

impl Record {
    /// All adapters, best first. Loads their drivers.
    pub fn all() -> Vec<Self> {
        let found = pollster::block_on(adapters());
        found.iter().enumerate().map(|(index, report)| record(index, report)).collect()
    }

    /// Whether it is hardware that gives what the kernels need.
    pub fn serves(&self) -> bool {
        // As wgpu calls software.
        self.kind != "Cpu" && self.lacks.is_empty()
    }
}

fn record(index: usize, report: &AdapterReport) -> Record {
    let (info, limits) = (&report.info, &report.limits);
    let has = |name: &str| report.features.iter_names().any(|(n, _)| n == name);
    Record {
        index,
        name: info.name.clone(),
        backend: info.backend.to_string(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        kind: format!("{:?}", info.device_type),
        limits: Limits {
            workgroup_memory_bytes: limits.max_compute_workgroup_storage_size,
            workgroup_invocations: limits.max_compute_invocations_per_workgroup,
            storage_buffers_per_stage: limits.max_storage_buffers_per_shader_stage,
            storage_binding_bytes: limits.max_storage_buffer_binding_size,
            workgroups_per_dimension: limits.max_compute_workgroups_per_dimension,
            subgroup_sizes: [info.subgroup_min_size, info.subgroup_max_size],
        },
        features: FEATURES.iter().filter(|(n, _)| has(n)).map(|(_, ours)| (*ours).into()).collect(),
        lacks: report.lacks.clone(),
    }
}

fn print(r: &Record) -> Result<(), Failure> {
    let Limits {
        workgroup_memory_bytes,
        workgroup_invocations,
        storage_buffers_per_stage,
        storage_binding_bytes,
        workgroups_per_dimension,
        subgroup_sizes: [least, most],
    } = r.limits;
    let mib = storage_binding_bytes >> 20;
    let none_if_empty = |list: String| if list.is_empty() { "nothing".into() } else { list };
    line(format!("{}  {}", r.index, r.name))?;
    line(format!("   {} ({}), driver {}", r.backend, r.kind, r.driver))?;
    line(format!(
        "   workgroups: {workgroup_memory_bytes} bytes of memory, {workgroup_invocations} \
         invocations, {workgroups_per_dimension} a dimension; subgroups of {least} to {most}"
    ))?;
    line(format!("   storage: {storage_buffers_per_stage} buffers a stage, {mib} MiB a binding"))?;
    line(format!("   offers: {}", none_if_empty(r.features.join(", "))))?;
    line(format!("   lacks:  {}", none_if_empty(r.lacks.join("; "))))
}
