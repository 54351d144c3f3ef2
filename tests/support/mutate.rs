//! Mechanical mutants of the shaders: one small fault each.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use smr_gpu::engine::kernels::{self, Caps};
use smr_gpu::engine::ops::{Entry, OPS};
use smr_gpu::engine::shader::{Replacement, Shader, Variant, reflect, reflect_replaced};

/// A shader file with one fault.
#[derive(Clone, Debug)]
pub struct Mutant {
    /// The file's name without its ending: `conv2d/planar`, `shared/reduce`.
    pub file: String,
    /// Where the fault is.
    pub line: usize,
    /// The line without the fault.
    pub before: String,
    /// The line with it; empty if it is removed.
    pub after: String,
    text: String,
}

impl Mutant {
    pub fn replacement(&self) -> Replacement {
        Replacement { file: self.file.clone(), text: self.text.clone() }
    }

    /// Whether naga takes it in every shader that has the file, with the same bindings and no larger
    /// workgroups: no program would be made of others.
    pub fn is_valid(&self) -> bool {
        let replacement = self.replacement();
        shaders(&self.file).iter().all(|(shader, variant)| {
            let own = reflect(shader, variant).expect("a shader").entries;
            let mutated = reflect_replaced(shader, variant, &replacement);
            let Ok(mutated) = mutated else { return false };
            own.iter().zip(&mutated.entries).all(|(a, b)| {
                a.bindings == b.bindings && b.workgroup_size.iter().product::<u32>() <= 256
            })
        })
    }
}

impl std::fmt::Display for Mutant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let after = if self.after.is_empty() { "removed" } else { &self.after };
        write!(f, "{}.wgsl:{}: `{}` → `{after}`", self.file, self.line, self.before)
    }
}

/// Every shader file with its text, in order.
pub fn sources() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("wgsl");
    let mut found = Vec::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("the shaders") {
            let path = entry.expect("a readable folder").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "wgsl") {
                let stem = path.with_extension("");
                let stem = stem.strip_prefix(&root).expect("a file below the root");
                let text = std::fs::read_to_string(&path).expect("a shader");
                found.push((stem.to_string_lossy().replace('\\', "/"), text));
            }
        }
    }
    found.sort();
    found
}

/// Whether a shader has `file`.
fn has(shader: &Shader, file: &str) -> bool {
    match file.strip_prefix("shared/") {
        Some(name) => shader.source.lines().any(|l| l == format!("// include: {name}")),
        None => shader.stem == file,
    }
}

/// The shaders that have `file`, as an adapter reads them.
fn shaders(file: &str) -> Vec<(&'static Shader, Variant)> {
    let all = kernels::shaders(&Caps::default().with_subgroups([8, 8]));
    all.into_iter().filter(|(shader, _)| has(shader, file)).collect()
}

/// The operations of which a kernel has `file`.
pub fn users(file: &str) -> Vec<&'static Entry> {
    let caps = Caps::default().with_subgroups([8, 8]);
    let has = |op: &&Entry| {
        let kernels = kernels::named(op.name).iter().flat_map(|k| k.shaders(&caps));
        kernels.into_iter().any(|(shader, _)| has(shader, file))
    };
    // What converts layouts belongs to all that need it; a convolution does.
    let found: Vec<_> = OPS.iter().copied().filter(has).collect();
    match found.is_empty() {
        true => OPS.iter().copied().filter(|op| op.name == "conv2d").collect(),
        false => found,
    }
}

/// What takes another's place. Operators have spaces around them, template brackets none.
const SWAPS: &[(&str, &str)] = &[
    (" + ", " - "),
    (" - ", " + "),
    (" * ", " / "),
    (" / ", " * "),
    (" % ", " / "),
    (" < ", " <= "),
    (" <= ", " < "),
    (" > ", " >= "),
    (" >= ", " > "),
    (" < ", " > "),
    (" > ", " < "),
    (" == ", " != "),
    (" != ", " == "),
    (" && ", " || "),
    (" || ", " && "),
    (" += ", " -= "),
    (" *= ", " /= "),
    (" /= ", " *= "),
    (" |= ", " &= "),
    (" << ", " >> "),
    (" >> ", " << "),
    (" & ", " | "),
    (" | ", " & "),
    ("min(", "max("),
    ("max(", "min("),
    (".x", ".y"),
    (".y", ".x"),
    (".z", ".w"),
    (".w", ".z"),
    ("width", "height"),
    ("height", "width"),
    (".low", ".high"),
    (".high", ".low"),
];

/// All mutants of a file, in the order of its lines; many do not compile.
pub fn mutants(file: &str, text: &str) -> Vec<Mutant> {
    let mut found = Vec::new();
    let mut declaration = false;
    for (number, line) in text.lines().enumerate() {
        let code = line.split("//").next().unwrap_or("").trim_end();
        let trimmed = code.trim_start();
        declaration |= trimmed.starts_with("struct ");
        let skip = declaration
            || trimmed.is_empty()
            || trimmed.starts_with(['@', '}'])
            || trimmed.starts_with("fn ")
            || trimmed.starts_with("var<workgroup>");
        declaration &= trimmed != "}";
        if skip {
            continue;
        }
        for after in faults(code) {
            let changed = |(i, l): (usize, &str)| match i == number {
                true => after.clone() + "\n",
                false => l.to_owned() + "\n",
            };
            found.push(Mutant {
                file: file.into(),
                line: number + 1,
                before: trimmed.into(),
                after: after.trim().into(),
                text: text.lines().enumerate().map(changed).collect(),
            });
        }
    }
    found
}

/// A line of code with each fault that it may have.
fn faults(code: &str) -> Vec<String> {
    let with = |at: usize, length: usize, new: &str| -> String {
        [&code[..at], new, &code[at + length..]].concat()
    };
    let mut found = Vec::new();
    for (from, to) in SWAPS {
        for (at, _) in code.match_indices(from) {
            found.push(with(at, from.len(), to));
        }
    }
    for (at, number) in numbers(code) {
        found.extend(neighbours(number).into_iter().map(|new| with(at, number.len(), &new)));
    }
    let trimmed = code.trim_start();
    if let Some(condition) = trimmed.strip_prefix("if ").and_then(|c| c.strip_suffix(" {")) {
        let at = code.len() - trimmed.len();
        found.push(with(at, trimmed.len(), &format!("if !({condition}) {{")));
    }
    let kept = ["let ", "var ", "const ", "return ", "for "];
    let whole = trimmed.matches('(').count() == trimmed.matches(')').count();
    if trimmed.ends_with(';') && whole && !kept.iter().any(|k| trimmed.starts_with(k)) {
        found.push(String::new());
    }
    found
}

/// The numbers of a line, not those in names and types.
fn numbers(code: &str) -> Vec<(usize, &str)> {
    let bytes = code.as_bytes();
    let part = |b: u8| b.is_ascii_alphanumeric() || b == b'_' || b == b'.';
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let end = (at..bytes.len()).find(|i| !part(bytes[*i])).unwrap_or(bytes.len());
        if end > at && bytes[at].is_ascii_digit() {
            found.push((at, &code[at..end]));
        }
        at = end.max(at + 1);
    }
    found
}

/// One more and one less.
fn neighbours(number: &str) -> Vec<String> {
    if let Some(digits) = number.strip_suffix('u') {
        let (digits, hex) = match digits.strip_prefix("0x") {
            Some(digits) => (digits, true),
            None => (digits, false),
        };
        let Ok(n) = u32::from_str_radix(digits, if hex { 16 } else { 10 }) else { return vec![] };
        let near = [n.checked_add(1), n.checked_sub(1)];
        return near.into_iter().flatten().map(|n| format!("{n}u")).collect();
    }
    match number.parse::<f64>() {
        Ok(x) if number.contains('.') => vec![format!("{:?}", x + 1.0), format!("{:?}", x - 1.0)],
        _ => vec![],
    }
}

/// The same `count` valid mutants of a file for the same seed, in the order of its lines.
pub fn chosen(file: &str, text: &str, seed: u64, count: usize) -> Vec<Mutant> {
    let mut all = mutants(file, text);
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let mut chosen: Vec<Mutant> = Vec::new();
    while chosen.len() < count && !all.is_empty() {
        let mutant = all.swap_remove(rng.random_range(0..all.len()));
        let twin = chosen.iter().any(|c| c.line == mutant.line && c.after == mutant.after);
        if !twin && mutant.is_valid() {
            chosen.push(mutant);
        }
    }
    chosen.sort_by_key(|m| m.line);
    chosen
}
