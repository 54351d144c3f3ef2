//! Every shader in every variant translates to what the other backends take: Metal's language,
//! Direct3D's at shader model 6, and SPIR-V. They are translated here, not run.

#[path = "support/shaders.rs"]
mod shaders;

use naga::ShaderStage;
use naga::back::{hlsl, msl, spv};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use smr_gpu::engine::shader::reflect;

/// A shader as naga takes it, with nothing beyond what WebGPU has in its core, and subgroups.
fn parse(text: &str) -> Result<(naga::Module, ModuleInfo), String> {
    // `unpack2x16float` is in WebGPU's core.
    let mut capabilities = Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    if shaders::uses_subgroups(text) {
        capabilities |= Capabilities::SUBGROUP;
    }
    let module = naga::front::wgsl::parse_str(text).map_err(|e| e.emit_to_string(text))?;
    let info = Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .map_err(|e| e.emit_to_string(text))?;
    Ok((module, info))
}

/// Metal 2.4, of macOS 12 and iOS 15; subgroups came with 2.1.
fn to_msl(module: &naga::Module, info: &ModuleInfo) -> Result<(), String> {
    let options = msl::Options { lang_version: (2, 4), ..msl::Options::default() };
    let pipeline = msl::PipelineOptions::default();
    let (text, names) =
        msl::write_string(module, info, &options, &pipeline).map_err(|e| e.to_string())?;
    for name in names.entry_point_names {
        let name = name.map_err(|e| e.to_string())?;
        if !text.contains(&format!("kernel void {name}(")) {
            return Err(format!("no kernel `{name}`"));
        }
    }
    Ok(())
}

fn to_hlsl(module: &naga::Module, info: &ModuleInfo) -> Result<(), String> {
    let shader_model = hlsl::ShaderModel::V6_0;
    let options = hlsl::Options { shader_model, ..hlsl::Options::default() };
    let pipeline = hlsl::PipelineOptions::default();
    let mut text = String::new();
    let names = hlsl::Writer::new(&mut text, &options, &pipeline)
        .write(module, info, None)
        .map_err(|e| e.to_string())?;
    for (name, entry) in names.entry_point_names.into_iter().zip(&module.entry_points) {
        let name = name.map_err(|e| e.to_string())?;
        let [x, y, z] = entry.workgroup_size;
        let head = format!("[numthreads({x}, {y}, {z})]\nvoid {name}(");
        if !text.contains(&head) {
            return Err(format!("no `{head}`"));
        }
    }
    Ok(())
}

/// SPIR-V 1.3, of Vulkan 1.1, an entry point at a time, and no capability that an adapter may lack.
fn to_spirv(module: &naga::Module, info: &ModuleInfo) -> Result<(), String> {
    use spv::Capability::*;
    let capabilities = [Shader, ImageQuery, GroupNonUniform, GroupNonUniformBallot]
        .into_iter()
        .chain([GroupNonUniformArithmetic, GroupNonUniformShuffle, GroupNonUniformVote]);
    let options = spv::Options {
        lang_version: (1, 3),
        capabilities: Some(capabilities.collect()),
        ..spv::Options::default()
    };
    for entry in &module.entry_points {
        let entry_point = entry.name.clone();
        let shader_stage = ShaderStage::Compute;
        let pipeline = spv::PipelineOptions { shader_stage, entry_point };
        let words = spv::write_vec(module, info, &options, Some(&pipeline))
            .map_err(|e| format!("{}: {e}", entry.name))?;
        // Magic number and version; `OpExecutionMode … LocalSize x y z`.
        let [x, y, z] = entry.workgroup_size;
        let has_size = words.windows(5).any(|w| w[0] == 6 << 16 | 16 && w[2..] == [17, x, y]);
        if words[..2] != [0x0723_0203, 0x0001_0300] || !has_size {
            return Err(format!("{}: no module with workgroups of {x} × {y} × {z}", entry.name));
        }
    }
    Ok(())
}

#[test]
fn every_shader_translates_to_every_backend() {
    let mut failures = Vec::new();
    let all = shaders::all();
    assert!(all.len() > 20, "only {} shaders", all.len());
    for (shader, variant) in all {
        let name = format!("{} {variant}", shader.stem);
        let text = match reflect(shader, &variant) {
            Ok(reflection) => reflection.text,
            Err(e) => {
                failures.push(format!("{name}: {e}"));
                continue;
            }
        };
        let (module, info) = match parse(&text) {
            Ok(parsed) => parsed,
            Err(e) => {
                failures.push(format!("{name}: {e}"));
                continue;
            }
        };
        let backends = [
            ("Metal", to_msl(&module, &info)),
            ("HLSL", to_hlsl(&module, &info)),
            ("SPIR-V", to_spirv(&module, &info)),
        ];
        for (backend, result) in backends {
            failures.extend(result.err().map(|e| format!("{name}: {backend}: {e}")));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// What the test above must notice: shaders that need more than every adapter has.
#[test]
fn what_few_adapters_have_is_refused() {
    let parsed = |text: &str| parse(text).map(drop);
    let double = "@group(0) @binding(0) var<storage, read_write> x: array<f64>;
        @compute @workgroup_size(1) fn main() { x[0] = 1.0lf; }";
    assert!(parsed(double).is_err());
    let wide = "@group(0) @binding(0) var<storage, read_write> x: array<u64>;
        @compute @workgroup_size(1) fn main() { x[0] = 1lu; }";
    assert!(parsed(wide).is_err());
    let subgroups = "@group(0) @binding(0) var<storage, read_write> x: array<u32>;
        @compute @workgroup_size(8) fn main(@builtin(subgroup_invocation_id) i: u32) {
            x[i] = subgroupBroadcast(i, 0u);
        }";
    let (module, info) = parse(subgroups).expect("WGSL");
    for result in [to_msl(&module, &info), to_hlsl(&module, &info), to_spirv(&module, &info)] {
        assert_eq!(result, Ok(()));
    }
}
