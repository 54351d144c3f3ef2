//! The adapters, with the limits that matter here, as data.

use serde::{Deserialize, Serialize};
use smr_gpu::engine::gpu::{AdapterReport, adapters};

/// Features that the program can use, or that later kernels may: wgpu's names and ours.
const FEATURES: [(&str, &str); 3] =
    [("TIMESTAMP_QUERY", "timestamps"), ("SHADER_F16", "f16"), ("SUBGROUP", "subgroups")];

/// One adapter, as `--json` prints it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Record {
    pub index: usize,
    pub name: String,
    pub backend: String,
    pub driver: String,
    #[serde(rename = "type")]
    pub kind: String,
    pub limits: Limits,
    pub features: Vec<String>,
    pub lacks: Vec<String>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Limits {
    pub workgroup_memory_bytes: u32,
    pub workgroup_invocations: u32,
    pub storage_buffers_per_stage: u32,
    pub storage_binding_bytes: u64,
    pub workgroups_per_dimension: u32,
    pub subgroup_sizes: [u32; 2],
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
