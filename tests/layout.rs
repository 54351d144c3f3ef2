//! The layout of the sources and the shaders' limits: an operation is one stem in five places.

#[path = "support/host_faults.rs"]
mod host_faults;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use smr_gpu::Precision;
use smr_gpu::engine::kernels::{self, Caps};
use smr_gpu::engine::ops::OPS;
use smr_gpu::engine::shader::{BindingKind, reflect};

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
fn every_operation_has_its_five_files() {
    let ops: BTreeSet<String> = OPS.iter().map(|entry| entry.name.to_owned()).collect();
    assert_eq!(ops.len(), OPS.len(), "two operations share a name");
    for folder in ["src/engine/reference", "tests/ops"] {
        let mut found = stems(folder, "rs");
        found.remove("mod");
        assert_eq!(found, ops, "{folder}/*.rs (left) against OPS (right)");
    }
    // These folders also hold what the operations share. An operation with several kernels has a
    // folder of them.
    for folder in ["src/engine/ops", "src/engine/kernels"] {
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

/// A module's path below the crate's root, from its file's.
fn module(file: &Path, src: &Path) -> Vec<String> {
    let below = file.strip_prefix(src).expect("a path below").with_extension("");
    let mut parts: Vec<String> =
        below.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    parts.pop_if(|last| last == "mod" || last == "lib" || last == "main");
    parts
}

/// What a module's code uses, as paths from the crate's root; `tests` may use what they like.
fn uses(code: &str, own: &[String]) -> BTreeSet<Vec<String>> {
    let code = code.split("#[cfg(test)]\n").next().unwrap_or_default();
    // What documentation alone links to.
    let parts = code.split("#[cfg(doc)]\nuse ").enumerate();
    let code =
        parts.map(|(at, part)| if at == 0 { part } else { part.split_once(';').expect("a use").1 });
    let code = code.collect::<String>();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let code = lines.collect::<Vec<_>>().join("\n");
    let parent = own.split_last().map_or(&[][..], |(_, parent)| parent);
    let mut found = BTreeSet::new();
    let roots = [("crate::", &[][..]), ("smr_gpu::", &[]), ("super::", parent)];
    for (root, base) in roots {
        for rest in code.split(root).skip(1) {
            collect(rest, base.to_vec(), &mut found);
        }
    }
    found
}

/// The paths that begin with `base` and go on as `text` begins, those in braces each for itself. Returns what
/// follows them.
fn collect<'a>(text: &'a str, base: Vec<String>, into: &mut BTreeSet<Vec<String>>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = collect(rest, base.clone(), into).trim_start();
            match rest.strip_prefix(',') {
                Some(more) => rest = more,
                None => return rest.strip_prefix('}').unwrap_or(rest),
            }
        }
    }
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    let (word, rest) = text.split_at(end);
    let path: Vec<String> = match word {
        "" => return rest,
        "self" => base,
        word => [base, vec![word.to_owned()]].concat(),
    };
    match rest.strip_prefix("::") {
        Some(more) => collect(more, path, into),
        None => {
            into.insert(path);
            rest
        }
    }
}

/// The modules of the table of files or modules in a module's docs, each with its row.
fn table(code: &str) -> BTreeMap<String, usize> {
    let start = ["//! | module |", "//! | file |"].into_iter().filter_map(|head| code.find(head));
    let code = start.min().map_or("", |at| &code[at..]);
    let rows = code.lines().take_while(|line| line.starts_with("//! |"));
    let rows = rows.filter_map(|line| line.strip_prefix("//! | "));
    let rows = rows.filter(|row| row.starts_with(['[', '`']));
    let cells = rows.filter_map(|row| row.split(" | ").next());
    let names = cells.enumerate().flat_map(|(at, row)| row.split(", ").map(move |m| (m, at)));
    let bare = |name: &str| name.trim_matches(&['[', '`', ']'][..]).replace("mod@", "");
    names.map(|(name, at)| (bare(name), at)).collect()
}

/// What a module uses of its folder stands above it in the folder's table, or in the same row; so from the
/// crate's root down to each file. A device's crate is named where devices are.
#[test]
fn imports_run_one_way() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let files = sources(&src);
    let texts: BTreeMap<Vec<String>, String> = files
        .iter()
        .filter(|file| !file.ends_with("main.rs"))
        .map(|file| (module(file, &src), std::fs::read_to_string(file).expect("a source")))
        .collect();
    let tables: BTreeMap<&[String], BTreeMap<String, usize>> =
        texts.iter().map(|(path, text)| (&path[..], table(text))).collect();
    let exported: BTreeMap<&[String], BTreeMap<String, String>> = texts
        .iter()
        .map(|(path, text)| {
            let lines = text.split("pub use ").skip(1).chain(text.split("pub(crate) use ").skip(1));
            let lines = lines.chain(text.split("pub(super) use ").skip(1));
            let mut names = BTreeSet::new();
            for line in lines {
                collect(line, Vec::new(), &mut names);
            }
            let pair = |path: Vec<String>| Some((path.last()?.clone(), path.first()?.clone()));
            (&path[..], names.into_iter().filter_map(pair).collect())
        })
        .collect();
    let mut failures = Vec::new();
    for (own, text) in &texts {
        for used in uses(text, own) {
            for depth in 0..own.len() {
                let folder = &own[..depth];
                let (rows, names) = (&tables[folder], &exported[folder]);
                if rows.is_empty() {
                    break;
                }
                let Some(name) = used.get(depth) else { break };
                let name = names.get(name).filter(|_| !rows.contains_key(name)).unwrap_or(name);
                let Some(at) = rows.get(&own[depth]) else {
                    failures.push(format!("{} has no row in its folder's table", own.join("/")));
                    break;
                };
                // What has no row is the folder's own.
                if rows.get(name).is_some_and(|row| row > at) {
                    failures.push(format!("{}: uses {}", own.join("/"), used.join("::")));
                }
                if *name != own[depth] {
                    break;
                }
            }
        }
        let mut code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        let is_gpu = own.starts_with(&["engine".into(), "gpu".into()]);
        if !is_gpu && code.any(|line| line.contains("wgpu")) {
            failures.push(format!("{}: names wgpu", own.join("/")));
        }
    }
    failures.dedup();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    // The table of the crate is the architecture: about ten rooms.
    let rooms = &tables[&[][..]];
    assert!(rooms["error"] < rooms["engine"] && rooms["engine"] < rooms["cli"], "{rooms:?}");
    assert!(rooms.len() <= 12, "{} rooms", rooms.len());
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
        // This also compares where naga has the fields of `Params` with where Rust has them.
        let reflection = match reflect(shader, &variant) {
            Ok(reflection) => reflection,
            Err(e) => {
                failures.push(e.to_string());
                continue;
            }
        };
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

/// The faults that `tools/host_faults.rs` plants are in the sources as they stand, their tests are there,
/// and the table for people has them all.
#[test]
fn faults_of_the_host_can_be_planted() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |file: &str| std::fs::read_to_string(root.join(file));
    let table = read("docs/internals/mutants.md").expect("docs/internals/mutants.md");
    let (_, table) = table.split_once("## Planted faults in host code").expect("a section of them");
    let (table, _) = table.split_once("\n## ").unwrap_or((table, ""));
    let rows: Vec<&str> = table.lines().filter(|line| line.starts_with("| ")).skip(1).collect();
    let wanted: Vec<String> = host_faults::FAULTS.iter().map(|fault| fault.row()).collect();
    assert_eq!(
        rows, wanted,
        "docs/internals/mutants.md (left) against tests/support/host_faults.rs"
    );
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
