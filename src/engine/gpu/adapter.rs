//! Adapters: which there are, which one is asked for, and whether it gives what the kernels use.

use crate::engine::gpu::quirks::instance;
use crate::engine::kernels::{Caps, Kind, MAX_WORKGROUPS};
use crate::error::{Error, Result};

/// Which adapter to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The fastest kind: discrete, integrated, virtual, then software.
    #[default]
    Auto,
    /// The same without software adapters.
    Hardware,
    /// Position in the list that [`adapters`] returns.
    Index(usize),
    /// Part of the adapter's name, in any case ("rtx 4090").
    Name(String),
}

impl std::fmt::Display for AdapterChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Hardware => f.write_str("a hardware adapter"),
            Self::Index(i) => write!(f, "{i}"),
            Self::Name(n) => f.write_str(n),
        }
    }
}

impl AdapterChoice {
    /// The adapter that is meant.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if none matches, or if the choice is left to us and none gives the limits.
    pub(super) async fn find(&self) -> Result<wgpu::Adapter> {
        let found = list().await;
        let describe = |a: &wgpu::Adapter| match &lacks(&a.limits())[..] {
            [] => a.get_info().name,
            lacks => format!("{} (lacks {})", a.get_info().name, lacks.join("; ")),
        };
        let none = || Error::NoAdapter {
            wanted: self.to_string(),
            found: match found.is_empty() {
                true => "none was found".into(),
                false => {
                    let all = found.iter().map(describe).enumerate();
                    let all: Vec<_> = all.map(|(i, name)| format!("{i}: {name}")).collect();
                    format!("found {}", all.join(", "))
                }
            },
        };
        let chosen = match self {
            Self::Auto => found.iter().find(|a| lacks(&a.limits()).is_empty()),
            Self::Hardware => found.iter().find(|a| {
                let software = a.get_info().device_type == wgpu::DeviceType::Cpu;
                !software && lacks(&a.limits()).is_empty()
            }),
            Self::Index(i) => found.get(*i),
            Self::Name(part) => named(&found, part),
        };
        chosen.cloned().ok_or_else(none)
    }
}

/// What is known of an adapter without opening it.
#[derive(Clone, Debug)]
pub struct AdapterReport {
    /// Name, backend, driver, kind.
    pub info: wgpu::AdapterInfo,
    /// What it offers.
    pub limits: wgpu::Limits,
    /// What it offers beside the core of WebGPU.
    pub features: wgpu::Features,
    /// What it lacks of the limits the shaders need, as `limit: required N, actual M`.
    pub lacks: Vec<String>,
}

/// What the kernels use, and no more. Of the size of textures and buffers no more is asked than there is:
/// kernels look at what they get.
pub(super) fn required_limits(adapter: &wgpu::Limits) -> wgpu::Limits {
    let usual = wgpu::Limits::default();
    wgpu::Limits {
        max_texture_dimension_2d: usual
            .max_texture_dimension_2d
            .min(adapter.max_texture_dimension_2d),
        max_storage_buffers_per_shader_stage: STORAGE_BUFFERS,
        max_storage_textures_per_shader_stage: STORAGE_TEXTURES,
        max_uniform_buffers_per_shader_stage: 1,
        max_storage_buffer_binding_size: usual
            .max_storage_buffer_binding_size
            .min(adapter.max_storage_buffer_binding_size),
        max_buffer_size: usual.max_buffer_size.min(adapter.max_buffer_size),
        max_compute_workgroup_storage_size: WORKGROUP_BYTES,
        max_compute_invocations_per_workgroup: INVOCATIONS,
        max_compute_workgroup_size_x: INVOCATIONS,
        max_compute_workgroup_size_y: ROWS,
        max_compute_workgroup_size_z: 1,
        max_compute_workgroups_per_dimension: MAX_WORKGROUPS,
        ..least_limits()
    }
}

/// Storage buffers that an entry point binds at most.
const STORAGE_BUFFERS: u32 = 8;
/// Storage textures that an entry point binds at most.
const STORAGE_TEXTURES: u32 = 2;
/// Bytes of workgroup memory that an entry point uses at most.
const WORKGROUP_BYTES: u32 = 16 << 10;
/// Invocations of the largest workgroups, which lie in x.
const INVOCATIONS: u32 = 256;
/// Invocations of a workgroup in y.
const ROWS: u32 = 8;

/// The least limits that wgpu has a name for, of which nothing but textures of two dimensions is used.
fn least_limits() -> wgpu::Limits {
    wgpu::Limits {
        max_texture_dimension_1d: 0,
        max_texture_dimension_3d: 0,
        max_texture_array_layers: 1,
        max_bind_groups: 1,
        max_bindings_per_bind_group: 16,
        max_dynamic_uniform_buffers_per_pipeline_layout: 0,
        max_sampled_textures_per_shader_stage: 0,
        max_samplers_per_shader_stage: 0,
        max_vertex_buffers: 0,
        max_vertex_attributes: 0,
        max_vertex_buffer_array_stride: 0,
        max_inter_stage_shader_variables: 0,
        max_color_attachments: 0,
        max_color_attachment_bytes_per_sample: 0,
        ..wgpu::Limits::downlevel_webgl2_defaults()
    }
}

/// What kernels may count on.
pub(super) fn caps(
    info: &wgpu::AdapterInfo,
    features: wgpu::Features,
    limits: &wgpu::Limits,
) -> Caps {
    let has_subgroups = features.contains(wgpu::Features::SUBGROUP);
    let size = |size| if has_subgroups { size } else { 0 };
    Caps {
        subgroup_min: size(info.subgroup_min_size),
        subgroup_max: size(info.subgroup_max_size),
        kind: match info.device_type {
            wgpu::DeviceType::DiscreteGpu => Kind::Discrete,
            wgpu::DeviceType::IntegratedGpu => Kind::Integrated,
            wgpu::DeviceType::Cpu => Kind::Software,
            wgpu::DeviceType::VirtualGpu | wgpu::DeviceType::Other => Kind::Other,
        },
        // `quirks::uneven` may add one.
        texture_side: limits.max_texture_dimension_2d.saturating_sub(1),
        buffer_bytes: limits.max_storage_buffer_binding_size,
    }
}

/// Features that kernels use where an adapter has them.
pub(super) fn wanted_features() -> wgpu::Features {
    wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::SUBGROUP
}

fn rank(info: &wgpu::AdapterInfo) -> u8 {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Cpu => 3,
        wgpu::DeviceType::Other => 4,
    }
}

async fn list() -> Vec<wgpu::Adapter> {
    #[cfg(not(target_family = "wasm"))]
    let mut found = instance().enumerate_adapters(wgpu::Backends::PRIMARY).await;
    // A browser gives one, the fastest where that is asked for.
    #[cfg(target_family = "wasm")]
    let mut found: Vec<_> = {
        let power_preference = wgpu::PowerPreference::HighPerformance;
        let fastest = wgpu::RequestAdapterOptions { power_preference, ..Default::default() };
        instance().request_adapter(&fastest).await.into_iter().collect()
    };
    found.sort_by_key(|a| rank(&a.get_info()));
    found
}

/// The first adapter whose name has this part; a blank is a part of none.
fn named<'a>(found: &'a [wgpu::Adapter], part: &str) -> Option<&'a wgpu::Adapter> {
    let part = part.trim().to_lowercase();
    if part.is_empty() {
        return None;
    }
    found.iter().find(|a| a.get_info().name.to_lowercase().contains(&part))
}

pub(super) fn lacks(limits: &wgpu::Limits) -> Vec<String> {
    let mut lacks = Vec::new();
    required_limits(limits).check_limits_with_fail_fn(limits, false, |name, required, actual| {
        lacks.push(format!("{name}: required {required}, actual {actual}"));
    });
    lacks
}

/// All adapters, best first; a position in this list is an [`AdapterChoice::Index`].
pub async fn adapters() -> Vec<AdapterReport> {
    list()
        .await
        .iter()
        .map(|a| AdapterReport {
            info: a.get_info(),
            limits: a.limits(),
            features: a.features(),
            lacks: lacks(&a.limits()),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::kernels;
    use crate::engine::shader::{self, BindingKind};

    #[test]
    fn what_is_asked_is_enough_for_every_shader() {
        let mut most = [0; 7];
        for (shader, variant) in Caps::SUBGROUPS
            .into_iter()
            .flat_map(|sizes| kernels::shaders(&Caps::default().with_subgroups(sizes)))
        {
            let reflection = shader::reflect(shader, &variant).expect("a shader");
            for entry in reflection.entries {
                let count = |is: fn(&BindingKind) -> bool| {
                    entry.bindings.iter().filter(|b| is(&b.2)).count() as u32
                };
                let [x, y, z] = entry.workgroup_size;
                let used = [
                    count(|kind| matches!(kind, BindingKind::Read | BindingKind::ReadWrite)),
                    count(|kind| matches!(kind, BindingKind::Texture(_))),
                    entry.workgroup_bytes,
                    x * y * z,
                    y,
                    z,
                    count(|kind| *kind == BindingKind::Uniform),
                ];
                most.iter_mut().zip(used).for_each(|(most, used)| *most = used.max(*most));
            }
        }
        let asked = [STORAGE_BUFFERS, STORAGE_TEXTURES, WORKGROUP_BYTES, INVOCATIONS, ROWS, 1, 1];
        let enough = most.iter().zip(asked).all(|(used, asked)| *used <= asked);
        assert!(enough, "used {most:?}, asked {asked:?}");
    }

    /// A Raspberry Pi 4's, of what its Vulkan driver says: of textures, attachments and inputs it has
    /// less than WebGPU's defaults.
    #[test]
    fn an_adapter_with_small_textures_lacks_nothing() {
        let small = wgpu::Limits {
            max_texture_dimension_1d: 4096,
            max_texture_dimension_2d: 4096,
            max_texture_dimension_3d: 2048,
            max_color_attachments: 4,
            max_inter_stage_shader_variables: 15,
            max_storage_textures_per_shader_stage: 4,
            ..wgpu::Limits::default()
        };
        assert!(!wgpu::Limits::default().check_limits(&small));
        assert_eq!(lacks(&small), [""; 0]);
        assert_eq!(required_limits(&small).max_texture_dimension_2d, 4096);
        let one = wgpu::Limits { max_storage_textures_per_shader_stage: 0, ..small };
        let want =
            format!("max_storage_textures_per_shader_stage: required {STORAGE_TEXTURES}, actual 0");
        assert_eq!(lacks(&one), [want]);
    }
}
