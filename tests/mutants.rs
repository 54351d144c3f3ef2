//! What the operations' cases are for: faults in a shader that one of them must notice.

mod support;

#[path = "support/mutate.rs"]
mod mutate;

use smr_gpu::gpu::Replacement;
use smr_gpu::ops::{Expected, find};
use support::gpu;

/// A fault, and the case that notices it.
struct Fault {
    what: &'static str,
    file: &'static str,
    /// Each text that is replaced, from where the one before was.
    changes: &'static [(&'static str, &'static str)],
    op: &'static str,
    case: &'static str,
    /// Whether the outputs by hand show it, so that the same fault in the reference cannot hide it.
    by_hand: bool,
}

const FAULTS: &[Fault] = &[
    Fault {
        what: "the last row of a whole tile is not stored",
        file: "linear",
        changes: &[("if first + 7u < rows", "if first + 8u < rows")],
        op: "linear",
        case: "a whole tile",
        by_hand: false,
    },
    Fault {
        what: "the last row of a whole tile is not stored, where a count limits the rows",
        file: "linear",
        changes: &[("if first + 7u < rows", "if first + 8u < rows")],
        op: "linear",
        case: "two whole tiles, counted",
        by_hand: false,
    },
    Fault {
        what: "rows behind the count are written, with sums of what was there",
        file: "linear",
        changes: &[
            ("fn finish(", "fn finish("),
            ("if row >= min(count[0], params.rows)", "if row >= max(count[0], params.rows)"),
        ],
        op: "linear",
        case: "a row of feature maps",
        by_hand: false,
    },
    Fault {
        what: "boxes may grow by e⁴ instead of 62.5",
        file: "shared/boxes",
        changes: &[("4.135166556742356", "4.0")],
        op: "decode_proposals",
        case: "the clamp by hand",
        by_hand: true,
    },
    Fault {
        what: "boxes may grow by e⁴ instead of 62.5",
        file: "shared/boxes",
        changes: &[("4.135166556742356", "4.0")],
        op: "decode_detections",
        case: "the clamp by hand",
        by_hand: true,
    },
    Fault {
        what: "no sample exactly at the features' end",
        file: "roi_align",
        changes: &[("at <= f32(length)", "at < f32(length)")],
        op: "roi_align",
        case: "exactly at the edges by hand",
        by_hand: true,
    },
    Fault {
        what: "no sample exactly at −1",
        file: "roi_align",
        changes: &[("at >= -1.0", "at > -1.0")],
        op: "roi_align",
        case: "exactly at the edges by hand",
        by_hand: true,
    },
    Fault {
        what: "a mean summed by one invocation",
        file: "global_avg_pool",
        changes: &[(
            "for (var i = local; i < params.area; i += WORKGROUP)",
            "for (var i = 0u; i < select(0u, params.area, local == 0u); i++)",
        )],
        op: "global_avg_pool",
        case: "one third everywhere",
        by_hand: false,
    },
    Fault {
        what: "a mean summed by one invocation",
        file: "channel_pool",
        changes: &[(
            "for (var i = local; i < params.area; i += WORKGROUP)",
            "for (var i = 0u; i < select(0u, params.area, local == 0u); i++)",
        )],
        op: "channel_pool",
        case: "one third everywhere",
        by_hand: false,
    },
    Fault {
        what: "the kernel's height and width exchanged",
        file: "conv2d",
        changes: &[
            ("ky < params.kernel_height", "ky < params.kernel_width"),
            ("kx < params.kernel_width", "kx < params.kernel_height"),
        ],
        op: "conv2d",
        case: "1x3 by hand",
        by_hand: true,
    },
    Fault {
        what: "the maximum of the first 64 columns alone",
        file: "softmax",
        changes: &[("i = lane + WORKGROUP; i < columns;", "i = lane + WORKGROUP; i < 64u;")],
        op: "softmax",
        case: "the highest behind 64 columns by hand",
        by_hand: true,
    },
    Fault {
        what: "the index's last byte does not count",
        file: "top_k",
        changes: &[("digit < 7u", "digit < 6u")],
        op: "top_k",
        case: "ties to the last byte by hand",
        by_hand: true,
    },
    Fault {
        what: "a ReLU that makes a NaN zero",
        file: "shared/relu",
        changes: &[("select(x, vec4<f32>(0.0), x < vec4<f32>(0.0))", "max(x, vec4<f32>(0.0))")],
        op: "conv2d",
        case: "a NaN goes through the ReLU",
        by_hand: true,
    },
];

impl Fault {
    fn replacement(&self) -> Replacement {
        let sources = mutate::sources();
        let (_, text) = sources.iter().find(|(file, _)| file == self.file).expect("a shader");
        let (mut text, mut at) = (text.clone(), 0);
        for (from, to) in self.changes {
            let found = text[at..].find(from);
            at += found.unwrap_or_else(|| panic!("{}: no `{from}`", self.file));
            text.replace_range(at..at + from.len(), to);
        }
        Replacement { file: self.file.into(), text }
    }
}

#[test]
fn each_fault_is_noticed_by_its_case() {
    let mut missed = Vec::new();
    for fault in FAULTS {
        let cases = (find(fault.op).expect("an operation").cases)();
        let case = cases.iter().find(|c| c.name == fault.case);
        let case = case.unwrap_or_else(|| panic!("{} has no case `{}`", fault.op, fault.case));
        let expected = Expected::of(case).expect("a reference");
        let report = expected.check(&gpu().with_replacement(fault.replacement()));
        let shows = |failure: &String| !fault.by_hand || failure.contains(": shader by hand: ");
        if !report.expect("a run").failures.iter().any(shows) {
            missed.push(format!("{}: {}", fault.file, fault.what));
        }
    }
    assert!(missed.is_empty(), "not noticed:\n{}", missed.join("\n"));
}

/// A mutant of each shader file; `cargo run --release --example mutants` runs more of them, and
/// docs/mutants.md lists what became of them.
#[test]
fn a_mutant_of_each_shader_is_noticed() {
    let mut missed = Vec::new();
    for (file, text) in mutate::sources() {
        let mutant = first_sure(&file, &text);
        let mutated = gpu().with_replacement(mutant.replacement());
        let mut noticed = false;
        for op in mutate::users(&file) {
            let mut cases = (op.cases)();
            cases.sort_by_key(|c| c.inputs.iter().map(|v| v.bytes().len()).sum::<usize>());
            let fails = |case| match Expected::of(case).expect("a reference").check(&mutated) {
                Ok(report) => !report.failures.is_empty(),
                Err(_) => true,
            };
            noticed = noticed || cases.iter().any(fails);
        }
        if !noticed {
            missed.push(mutant.to_string());
        }
    }
    assert!(missed.is_empty(), "not noticed:\n{}", missed.join("\n"));
}

/// Faults that change no output, and why.
const EQUIVALENT: &[(&str, &str, &str)] = &[
    (
        "max_pool2d",
        "return (bitcast<u32>(x) & 0x7fffffffu) > 2139095041u;",
        "one signalling NaN counts as a number, which no arithmetic makes",
    ),
    (
        "shared/reduce",
        "if local <= half {",
        "a word behind those that are summed changes; a race where lanes do not go in step",
    ),
    (
        "top_k",
        "return keys[a] > keys[b] || (keys[a] == keys[b] && positions[a] <= positions[b]);",
        "no two elements are equal but the padding",
    ),
];

/// One that surely ends: no fault in a loop's head or in what it counts.
fn first_sure(file: &str, text: &str) -> mutate::Mutant {
    let candidates = mutate::chosen(file, text, 1, 8);
    let ends = |m: &&mutate::Mutant| {
        let heads = ["for ", "const ", "workgroupBarrier"];
        !heads.iter().any(|head| m.before.starts_with(head))
    };
    let changes = |m: &&mutate::Mutant| {
        !EQUIVALENT.iter().any(|(file, after, _)| m.file == *file && m.after == *after)
    };
    let found = candidates.iter().filter(ends).find(changes);
    found.unwrap_or_else(|| panic!("{file} has no such mutant")).clone()
}
