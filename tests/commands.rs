//! The commands that the documents show run as they stand, in the order of the book.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};

#[path = "support/page.rs"]
mod page;
#[path = "support/program.rs"]
mod program;
use page::Page;
use program::folder;

/// What stands behind `sh` where a block needs what a test has not, and what that is.
const ELSEWHERE: [(&str, &str); 4] = [
    ("cargo", "a build"),
    ("ffmpeg", "ffmpeg, for which tests/streams.rs has a stand-in"),
    ("python", "a Python with the training package"),
    ("hours", "what is measured for the tables of the results"),
];

/// Its blocks need the training package: weights/training/tests/test_guide.py runs them.
const TRAINING: &str = "docs/guide/your-own-snap.md";

/// Stands before the program: the same commands, of two pictures where they draw hundreds.
const SMALL: &str = r#"#!/usr/bin/env bash
set -euo pipefail
line=() last=
for word in "$@"; do
    [ "$last" = --count ] && word=2
    line+=("$word") last=$word
done
[ "$1" = tradeoff ] && line+=(--limit 1 --sizes 160 --device cpu)
exec "$SMR_GPU" "${line[@]}"
"#;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The files that the blocks name.
fn furnish(home: &Path) {
    for name in ["samples", "tests", "weights"] {
        symlink(root().join(name), home.join(name)).expect("linked");
    }
    for name in ["folder", "more", "bin", "out/parts"] {
        fs::create_dir_all(home.join(name)).expect("created");
    }
    let sample = |from: &str, to: &str| {
        let from = root().join("samples").join(from);
        fs::copy(from, home.join(to)).expect("copied");
    };
    // A frame that every sensor of the pages may have taken.
    let frame = image::open(root().join("samples/mixed.png")).expect("a picture");
    let frame = frame.resize_exact(320, 240, image::imageops::FilterType::Triangle);
    for name in ["picture.png", "untouched.png"] {
        frame.save(home.join(name)).expect("saved");
    }
    sample("stud.png", "folder/stud.png");
    sample("hooks.png", "folder/hooks.png");
    sample("faint_stud.png", "more/faint.jpg");
    for (from, to) in [("smrnet.safetensors", "smrnet"), ("smrnet-s.safetensors", "my")] {
        let to = home.join(to).with_extension("safetensors");
        symlink(root().join("weights").join(from), to).expect("linked");
    }
    let sensor = r#"{"name": "mine", "frame": [320, 240], "mm_per_pixel": 0.0634, "reference": "untouched.png"}"#;
    fs::write(home.join("my.json"), sensor).expect("written");
    // A wedge for each part, which no mirror and no turn repeats.
    for (name, [x, y, z]) in [("clip", [8, 5, 2]), ("pin", [4, 9, 3])] {
        let corners = [[0, 0, 0], [x, 0, 0], [0, y, 0], [0, 0, z]];
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let face = |face: [usize; 3]| {
            let vertex = |at: usize| {
                let [x, y, z]: [i32; 3] = corners[at];
                format!("vertex {x} {y} {z}\n")
            };
            let outline = face.map(vertex).concat();
            format!("facet normal 0 0 0\nouter loop\n{outline}endloop\nendfacet\n")
        };
        let solid = format!("solid part\n{}endsolid part\n", faces.map(face).concat());
        fs::write(home.join(format!("out/parts/{name}.stl")), solid).expect("written");
    }
    let program = home.join("bin/smr-gpu");
    fs::write(&program, SMALL).expect("written");
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("allowed");
}

#[test]
fn the_blocks_of_the_documents_run() {
    let home = folder();
    let home = home.path();
    furnish(home);
    let path = format!("{}:{}", home.join("bin").display(), std::env::var("PATH").expect("a path"));
    let summary = Page::open(&root().join("docs/SUMMARY.md"));
    let pages = ["README.md".to_owned()].into_iter();
    let pages = pages.chain(summary.links.iter().map(|link| format!("docs/{link}")));
    let pages = pages.filter(|page| page != TRAINING);
    let (mut ran, mut wrong) = (0, Vec::new());
    for page in pages {
        for (kind, block) in Page::open(&root().join(&page)).blocks {
            let mut words = kind.split_whitespace();
            if words.next() != Some("sh") {
                continue;
            }
            if let Some(reason) = words.next() {
                assert!(ELSEWHERE.iter().any(|(known, _)| *known == reason), "{page}: {reason}");
                continue;
            }
            let mut command = Command::new("bash");
            command.args(["-euo", "pipefail", "-c", &block]).current_dir(home);
            command
                .env_remove("SMR_GPU_WEIGHTS")
                .env("PATH", &path)
                .env("SMR_GPU", env!("CARGO_BIN_EXE_smr-gpu"));
            for (name, folder) in [("XDG_DATA_HOME", "data"), ("SMR_GPU_CACHE", "cache")] {
                command.env(name, home.join(folder));
            }
            let output = command.stdin(Stdio::null()).output().expect("bash");
            if !output.status.success() {
                let said = String::from_utf8_lossy(&output.stderr);
                wrong.push(format!("{page}: {}:\n{block}{said}", output.status));
            }
            ran += 1;
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(ran >= 15, "{ran} blocks");
}
