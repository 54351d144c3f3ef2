//! Shaders compiled to pipelines, each once a device.

#[cfg(not(target_family = "wasm"))]
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use crate::engine::gpu::device::Device;
use crate::engine::gpu::faults::{Call, Fault};
use crate::engine::gpu::memory::texture_format;
use crate::engine::gpu::quirks;
use crate::engine::kernels::{Command, Dispatch, Recording};
use crate::engine::lock::lock;
use crate::engine::precision::Precision;
use crate::engine::shader::{self, BindingKind, EntryReflection, Variant};
use crate::error::{Error, Result};

/// What a binding of a shader that runs no workgroups holds: as much as its types have at least.
const WARM_BYTES: u64 = 16 << 10;

/// Shader, how it is read, and entry point.
type PipelineKey = (&'static str, Variant, &'static str);

/// What compiles a dispatch's pipeline.
fn key(dispatch: &Dispatch) -> PipelineKey {
    (dispatch.shader.stem, dispatch.variant.clone(), dispatch.entry)
}

/// A shader entry point, compiled, with its bindings by name.
#[derive(Debug)]
pub(super) struct Pipeline {
    pub label: String,
    pub pipeline: wgpu::ComputePipeline,
    pub layout: wgpu::BindGroupLayout,
    pub bindings: Vec<(String, u32, BindingKind)>,
    /// Whether it reads how many workgroups there are.
    pub reads_grid: bool,
}

#[derive(Debug)]
struct Module {
    module: wgpu::ShaderModule,
    entries: Vec<EntryReflection>,
}

/// A module, once somebody has made it; whoever else wants it waits, for this one alone.
type Making = Arc<Mutex<Option<Arc<Module>>>>;

/// A device's shaders and pipelines so far.
#[derive(Debug)]
pub(super) struct Pipelines {
    /// Other texts for shader files.
    pub replacements: Vec<shader::Replacement>,
    modules: Mutex<HashMap<(&'static str, Variant), Making>>,
    compiled: Mutex<HashMap<PipelineKey, Arc<Pipeline>>>,
}

impl Pipelines {
    pub fn new(replacements: Vec<shader::Replacement>) -> Self {
        Self { replacements, modules: Mutex::default(), compiled: Mutex::default() }
    }

    fn module(
        &self,
        device: &Device,
        shader: &'static shader::Shader,
        variant: &Variant,
    ) -> Result<Arc<Module>> {
        let key = (shader.stem, variant.clone());
        let making = lock(&self.modules).entry(key).or_default().clone();
        let mut made = lock(&making);
        if let Some(module) = &*made {
            return Ok(module.clone());
        }
        let variant = quirks::variant(&device.info, variant);
        let reflection = shader::reflect_with(shader, &variant, &self.replacements)?;
        // What is parsed is not parsed again; a browser takes text alone.
        #[cfg(not(target_family = "wasm"))]
        let source = wgpu::ShaderSource::Naga(Cow::Owned(reflection.module));
        #[cfg(target_family = "wasm")]
        let source = wgpu::ShaderSource::Wgsl(reflection.text.into());
        let desc = wgpu::ShaderModuleDescriptor { label: Some(shader.stem), source };
        let module = if device.options.bounds_checks {
            device.handle.create_shader_module(desc)
        } else {
            // SAFETY: the shaders are this crate's own; each index is below the sizes in its
            // `Params`, which `record` takes from the bound tensors, every loop is bounded by
            // those sizes, and the tests run each with sentinels behind every buffer.
            unsafe {
                device
                    .handle
                    .create_shader_module_trusted(desc, wgpu::ShaderRuntimeChecks::unchecked())
            }
        };
        let module = Arc::new(Module { module, entries: reflection.entries });
        *made = Some(module.clone());
        Ok(module)
    }

    /// Compiles what the dispatches of `recording` need and is not compiled yet, on all cores, while
    /// this thread does `meanwhile`.
    pub async fn compile<T>(
        &self,
        device: &Device,
        recording: &Recording,
        meanwhile: impl FnOnce() -> T,
    ) -> Result<T> {
        let mut wanted: HashMap<PipelineKey, &Dispatch> = HashMap::new();
        for command in recording.commands() {
            if let Command::Dispatch(dispatch) = command {
                wanted.entry(key(dispatch)).or_insert(dispatch);
            }
        }
        {
            let known = lock(&self.compiled);
            wanted.retain(|key, _| !known.contains_key(key));
        }
        // Several entries of a module next to each other wait for it together.
        let mut wanted: Vec<_> = wanted.into_iter().collect();
        wanted.sort_by(|a, b| (a.0.2, &a.0).cmp(&(b.0.2, &b.0)));
        let next = AtomicUsize::new(0);
        let compile = || async {
            while let Some((_, dispatch)) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
                let pipeline = self.pipeline(device, dispatch).await?;
                if quirks::compiles_late(&device.info) {
                    warm(device, &pipeline, &dispatch.params);
                }
            }
            Ok(())
        };
        let given = std::thread::scope(|scope| {
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            let threads = cores.min(wanted.len());
            let work = || pollster::block_on(compile());
            let spawn = |_| std::thread::Builder::new().spawn_scoped(scope, work).ok();
            let threads: Vec<_> = (0..threads).map_while(spawn).collect();
            let given = meanwhile();
            for thread in threads {
                match thread.join() {
                    Ok(compiled) => compiled?,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            Ok(given)
        })?;
        // What is left where no thread can be had, as in a browser.
        compile().await?;
        Ok(given)
    }

    /// The pipeline for a dispatch, which is compiled already.
    pub fn compiled(&self, dispatch: &Dispatch) -> Result<Arc<Pipeline>> {
        let missing = || Error::Shader {
            file: format!("{}.wgsl", dispatch.shader.stem),
            line: 0,
            message: format!("expected `{}` compiled, got nothing", dispatch.entry),
        };
        lock(&self.compiled).get(&key(dispatch)).cloned().ok_or_else(missing)
    }

    /// Compiles the pipeline for a dispatch.
    async fn pipeline(&self, device: &Device, dispatch: &Dispatch) -> Result<Arc<Pipeline>> {
        let shader = dispatch.shader;
        let label = format!("{}::{} {}", shader.stem, dispatch.entry, dispatch.variant);
        let label = label.trim_end();
        // What the driver objects to is told to the thread that asked, and kept for nobody.
        let build = || self.build(device, dispatch, label);
        let built = device.scoped(&format!("compiling {label}"), build).await;
        let pipeline = built.inspect_err(|_| {
            let key = (shader.stem, dispatch.variant.clone());
            lock(&self.modules).remove(&key);
        })?;
        let mut pipelines = lock(&self.compiled);
        Ok(pipelines.entry(key(dispatch)).or_insert(Arc::new(pipeline)).clone())
    }

    fn build(&self, device: &Device, dispatch: &Dispatch, label: &str) -> Result<Pipeline> {
        let shader = dispatch.shader;
        let module = self.module(device, shader, &dispatch.variant)?;
        let entry = module.entries.iter().find(|e| e.name == dispatch.entry);
        let entry = entry.ok_or_else(|| Error::Shader {
            file: format!("{}.wgsl", shader.stem),
            line: 0,
            message: format!("no entry point `{}`", dispatch.entry),
        })?;
        let buffer = |ty| wgpu::BindingType::Buffer {
            ty,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let layout_entries: Vec<_> = entry
            .bindings
            .iter()
            .map(|(_, binding, kind)| wgpu::BindGroupLayoutEntry {
                binding: *binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: match kind {
                    BindingKind::Uniform => buffer(wgpu::BufferBindingType::Uniform),
                    BindingKind::Read => {
                        buffer(wgpu::BufferBindingType::Storage { read_only: true })
                    }
                    BindingKind::ReadWrite => {
                        buffer(wgpu::BufferBindingType::Storage { read_only: false })
                    }
                    BindingKind::Texture(precision) => wgpu::BindingType::StorageTexture {
                        access: wgpu::StorageTextureAccess::ReadOnly,
                        format: texture_format(*precision),
                        view_dimension: wgpu::TextureViewDimension::D2,
                    },
                },
                count: None,
            })
            .collect();
        let layout = device.handle.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(label),
            entries: &layout_entries,
        });
        let pipeline_layout =
            device.handle.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(label),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
        let refused = device.fault(Call::Pipeline) == Some(Fault::Invalid);
        let pipeline = device.handle.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label),
            layout: Some(&pipeline_layout),
            module: &module.module,
            entry_point: Some(if refused { "none" } else { dispatch.entry }),
            compilation_options: wgpu::PipelineCompilationOptions {
                // Every shader writes its workgroup memory before it reads it.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            // Drivers that keep compiled shaders do so without one: docs/internals/rejected.md.
            cache: None,
        });
        let bindings = entry.bindings.clone();
        let reads_grid = entry.reads_grid;
        Ok(Pipeline { label: label.to_owned(), pipeline, layout, bindings, reads_grid })
    }
}

/// Runs no workgroups of a pipeline: lavapipe makes machine code at the first dispatch, one pipeline
/// after the other, and so it does while weights are read. What goes wrong is told by the first run.
fn warm(device: &Device, pipeline: &Pipeline, params: &[u8]) {
    let buffer = |usage| {
        device.handle.create_buffer(&wgpu::BufferDescriptor {
            label: Some("warm"),
            size: WARM_BYTES.max(params.len() as u64).next_multiple_of(4),
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    };
    device.unheard(|| {
        let views = [Precision::F32, Precision::F16].map(|precision| {
            let texture = device.create_texture(quirks::uneven(1), quirks::uneven(1), precision);
            texture.create_view(&Default::default())
        });
        let uniform = buffer(wgpu::BufferUsages::UNIFORM);
        let bindings = pipeline.bindings.iter();
        let buffers: Vec<_> = bindings.map(|_| buffer(wgpu::BufferUsages::STORAGE)).collect();
        let entry = |((_, binding, kind), buffer): (&(String, u32, BindingKind), _)| {
            let buffer: &wgpu::Buffer = buffer;
            wgpu::BindGroupEntry {
                binding: *binding,
                resource: match kind {
                    BindingKind::Texture(precision) => {
                        let view = &views[usize::from(precision.is_half())];
                        wgpu::BindingResource::TextureView(view)
                    }
                    BindingKind::Uniform => uniform.as_entire_binding(),
                    BindingKind::Read | BindingKind::ReadWrite => buffer.as_entire_binding(),
                },
            }
        };
        let entries: Vec<_> = pipeline.bindings.iter().zip(&buffers).map(entry).collect();
        let group = device.handle.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("warm"),
            layout: &pipeline.layout,
            entries: &entries,
        });
        let mut encoder = device.handle.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(0, 0, 0);
        drop(pass);
        // One at a time: weights are uploaded between them.
        {
            let _turn = device.turn();
            device.queue.write_buffer(&uniform, 0, params);
            device.queue.submit([encoder.finish()]);
        }
        device.wait();
    });
}
