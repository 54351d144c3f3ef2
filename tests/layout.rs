//! The layout of the sources and the shaders' limits: an operation is one stem in five places.

#[path = "support/host_faults.rs"]
mod host_faults;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use smr_gpu::Precision;
use smr_gpu::kernels::{self, Caps};
use smr_gpu::ops::OPS;
use smr_gpu::shader::{BindingKind, reflect};

/// `wgpu::Limits::default()`: every WebGPU device has these.
const WORKGROUP_BYTES: u32 = 16_384;
const INVOCATIONS: u32 = 256;
const STORAGE_BUFFERS: u32 = 8;
const STORAGE_TEXTURES: u32 = 4;

/// Stems of what is in `folder` with this extension; without one, its folders.
fn stems(folder: &str, extension: &str) -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let entries = std::fs::read_dir(&folder).expect("a folder of sources");
    entries
        .map(|entry| entry.expect("a readable folder").path())
        .filter(|path| path.extension().unwrap_or_default() == extension)
        .map(|path| path.file_stem().expect("a file").to_string_lossy().into_owned())
        .collect()
}

#[test]
fn every_operation_has_its_four_files() {
    let ops: BTreeSet<String> = OPS.iter().map(|entry| entry.name.to_owned()).collect();
    assert_eq!(ops.len(), OPS.len(), "two operations share a name");
    for folder in ["src/cpu", "tests/ops"] {
        let mut found = stems(folder, "rs");
        found.remove("mod");
        assert_eq!(found, ops, "{folder}/*.rs (left) against OPS (right)");
    }
    // These folders also hold what the operations share. An operation with several kernels has a
    // folder of them.
    for folder in ["src/ops", "src/kernels"] {
        let mut sources = stems(folder, "rs");
        sources.extend(stems(folder, ""));
        let missing: Vec<_> = ops.difference(&sources).collect();
        assert!(missing.is_empty(), "not in {folder}: {missing:?}");
    }
    // A test file that no crate takes in would never run.
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ops.rs");
    let tests = std::fs::read_to_string(tests).expect("tests/ops.rs");
    for op in &ops {
        assert!(tests.contains(&format!("mod {op};")), "{op} is not in tests/ops.rs");
    }
}

/// The Rust files in and below a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder of sources");
    let paths = entries.map(|entry| entry.expect("a readable folder").path());
    let each = paths.map(|path| if path.is_dir() { sources(&path) } else { vec![path] });
    each.flatten().filter(|path| path.extension().is_some_and(|e| e == "rs")).collect()
}

/// The first parts of the paths from this crate's root that code names.
fn named(code: &str) -> BTreeSet<&str> {
    let word = |text| str::split(text, |c: char| !c.is_alphanumeric() && c != '_').next();
    let rests = ["crate::", "smr_gpu::"].into_iter().flat_map(|root| code.split(root).skip(1));
    let each = rests.flat_map(|rest| match rest.strip_prefix('{') {
        Some(list) => list.split('}').take(1).flat_map(|l| l.split(',')).map(str::trim).collect(),
        None => vec![rest],
    });
    each.filter_map(word).filter(|name| !name.is_empty()).collect()
}

/// What a module uses stands above it in the crate's table of modules, or in the same row; a device's crate is
/// named where devices are.
#[test]
fn imports_run_one_way() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let read = |path: &Path| std::fs::read_to_string(path).expect("a source");
    let table = read(&folder.join("lib.rs"));
    let rows = table.lines().filter_map(|line| line.strip_prefix("//! | [`"));
    let rows = rows.filter_map(|row| row.split(" | ").next());
    let modules = rows.enumerate().flat_map(|(at, row)| row.split(", ").map(move |m| (m, at)));
    let mut places: BTreeMap<&str, usize> =
        modules.map(|(name, at)| (name.trim_matches(&['[', '`', ']'][..]), at)).collect();
    assert!(places["error"] < places["cpu"] && places["lower"] < places["gpu"], "{places:?}");
    // What is too small for a row, and what stands below all: the program, and names at the root.
    let root = usize::MAX;
    places.extend(["cores", "lock", "milliseconds", "pixel_format", "rect"].map(|name| (name, 0)));
    places.extend([("Error", 0), ("Result", 0), ("cli", root), ("main", root), ("lib", root)]);
    let place = |name: &str| places.get(name).copied();
    let mut failures = Vec::new();
    for path in sources(&folder) {
        let own = path.strip_prefix(&folder).expect("a path below").with_extension("");
        let module = own.iter().next().expect("a module").to_string_lossy();
        let Some(at) = place(&module) else {
            failures.push(format!("{module} has no row in lib.rs"));
            continue;
        };
        let text = read(&path);
        // Tests may use what they like.
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
        let code = lines.collect::<Vec<_>>().join("\n");
        let above = |name: &&str| place(name).unwrap_or(root) > at;
        let wrong = named(&code).into_iter().filter(above);
        failures.extend(wrong.map(|name| format!("{}: uses {name}", own.display())));
        if code.contains("wgpu") && module != "gpu" {
            failures.push(format!("{}: names wgpu", own.display()));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// A kernel is called as its operation, and its shaders lie where one looks for them.
#[test]
fn kernels_and_shaders_are_called_as_their_operation() {
    for entry in OPS {
        assert!(!kernels::named(entry.name).is_empty(), "{} has no kernel", entry.name);
        for kernel in kernels::named(entry.name) {
            let (op, own) = kernel.id().split_once('/').expect("an operation and a name");
            assert_eq!(op, entry.name);
            for (shader, _) in kernel.shaders(&Caps::default()) {
                let stem = shader.stem;
                let fits = stem == op
                    || stem.starts_with(&format!("{op}/"))
                    || OPS.iter().any(|e| e.name == stem);
                assert!(fits, "{}: {stem}.wgsl is not of {op}, kernel {own}", kernel.id());
            }
        }
    }
}

#[test]
fn shaders_validate_and_keep_to_the_default_limits() {
    let mut failures = Vec::new();
    let all = Caps::SUBGROUPS
        .into_iter()
        .flat_map(|sizes| kernels::shaders(&Caps::default().with_subgroups(sizes)));
    for (shader, variant) in all {
        let name = format!("{} {variant}", shader.stem);
        // This also compares naga's offsets of `Params` with Rust's.
        let reflection = match reflect(shader, &variant) {
            Ok(reflection) => reflection,
            Err(e) => {
                failures.push(e.to_string());
                continue;
            }
        };
        if reflection.params.is_none() && shader.params.size > 0 {
            failures.push(format!("{name}: Rust has Params, the shader has none"));
        }
        if reflection.entries.is_empty() {
            failures.push(format!("{name}: no entry point"));
        }
        for entry in &reflection.entries {
            let invocations: u32 = entry.workgroup_size.iter().product();
            let count = |kinds: &[BindingKind]| {
                entry.bindings.iter().filter(|(_, _, kind)| kinds.contains(kind)).count() as u32
            };
            let storage = count(&[BindingKind::Read, BindingKind::ReadWrite]);
            let measured = [
                ("bytes of workgroup memory", entry.workgroup_bytes, WORKGROUP_BYTES),
                ("invocations", invocations, INVOCATIONS),
                ("storage buffers", storage, STORAGE_BUFFERS),
                (
                    "storage textures",
                    count(&[
                        BindingKind::Texture(Precision::F32),
                        BindingKind::Texture(Precision::F16),
                    ]),
                    STORAGE_TEXTURES,
                ),
            ];
            for (what, got, limit) in measured {
                if got > limit {
                    failures
                        .push(format!("{}::{}: {got} {what}, at most {limit}", name, entry.name));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// The faults that `examples/host_faults.rs` plants are in the sources as they stand, their tests are there,
/// and the table for people has them all.
#[test]
fn faults_of_the_host_can_be_planted() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |file: &str| std::fs::read_to_string(root.join(file));
    let table = read("docs/mutants.md").expect("docs/mutants.md");
    let (_, table) = table.split_once("## Planted faults in host code").expect("a section of them");
    let (table, _) = table.split_once("\n## ").unwrap_or((table, ""));
    let rows: Vec<&str> = table.lines().filter(|line| line.starts_with("| ")).skip(1).collect();
    let wanted: Vec<String> = host_faults::FAULTS.iter().map(|fault| fault.row()).collect();
    assert_eq!(rows, wanted, "docs/mutants.md (left) against tests/support/host_faults.rs");
    assert!(wanted.len() >= 60, "{} faults", wanted.len());
    for fault in host_faults::FAULTS {
        let source = read(&fault.path()).unwrap_or_else(|e| panic!("{}: {e}", fault.path()));
        assert_eq!(source.matches(fault.from).count(), 1, "{}: {}", fault.path(), fault.from);
        let files = fault.test_files();
        let tests: String = files.iter().filter_map(|file| read(file).ok()).collect();
        let (_, name) = fault.place();
        let name = name.rsplit("::").next().expect("a name");
        assert!(tests.contains(&format!("fn {name}()")), "no {name} in {files:?}");
    }
}
