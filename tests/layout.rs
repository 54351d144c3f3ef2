//! The layout of the sources and the shaders' limits: an operation is one stem in four places.

use std::collections::BTreeSet;
use std::path::Path;

use smr_gpu::gpu::reflect;
use smr_gpu::ops::OPS;

/// `wgpu::Limits::default()`: every WebGPU device has these.
const WORKGROUP_BYTES: u32 = 16_384;
const INVOCATIONS: u32 = 256;
const STORAGE_BUFFERS: u32 = 8;

/// Stems of the files in `folder` with this extension.
fn stems(folder: &str, extension: &str) -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let entries = std::fs::read_dir(&folder).expect("a folder of sources");
    entries
        .map(|entry| entry.expect("a readable folder").path())
        .filter(|path| path.extension().is_some_and(|e| e == extension))
        .map(|path| path.file_stem().expect("a file").to_string_lossy().into_owned())
        .collect()
}

#[test]
fn every_operation_has_its_four_files() {
    let ops: BTreeSet<String> = OPS.iter().map(|entry| entry.name.to_owned()).collect();
    assert_eq!(ops.len(), OPS.len(), "two operations share a name");
    for (folder, extension) in [("wgsl", "wgsl"), ("src/cpu", "rs"), ("tests/ops", "rs")] {
        let mut found = stems(folder, extension);
        found.remove("mod");
        assert_eq!(found, ops, "{folder}/*.{extension} (left) against OPS (right)");
    }
    // This folder also holds what the operations share.
    let sources = stems("src/ops", "rs");
    let missing: Vec<_> = ops.difference(&sources).collect();
    assert!(missing.is_empty(), "not in src/ops: {missing:?}");
    // A test file that no crate takes in would never run.
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ops.rs");
    let tests = std::fs::read_to_string(tests).expect("tests/ops.rs");
    for op in &ops {
        assert!(tests.contains(&format!("mod {op};")), "{op} is not in tests/ops.rs");
    }
    for entry in OPS {
        assert_eq!(entry.shader.stem, entry.name);
    }
}

#[test]
fn shaders_validate_and_keep_to_the_default_limits() {
    let mut failures = Vec::new();
    for op in OPS {
        // This also compares naga's offsets of `Params` with Rust's.
        let reflection = match reflect(op.shader) {
            Ok(reflection) => reflection,
            Err(e) => {
                failures.push(e.to_string());
                continue;
            }
        };
        if reflection.params.is_none() && op.shader.params.size > 0 {
            failures.push(format!("{}: Rust has Params, the shader has none", op.name));
        }
        if reflection.entries.is_empty() {
            failures.push(format!("{}: no entry point", op.name));
        }
        for entry in &reflection.entries {
            let invocations: u32 = entry.workgroup_size.iter().product();
            let storage = entry.bindings.iter().filter(|(name, _, _)| name != "params").count();
            let measured = [
                ("bytes of workgroup memory", entry.workgroup_bytes, WORKGROUP_BYTES),
                ("invocations", invocations, INVOCATIONS),
                ("storage buffers", storage as u32, STORAGE_BUFFERS),
            ];
            for (what, got, limit) in measured {
                if got > limit {
                    failures.push(format!(
                        "{}::{}: {got} {what}, at most {limit}",
                        op.name, entry.name
                    ));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
