//! What `tradeoff`, `tune` and `bench` measure, and that `detect` uses it.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

#[path = "support/program.rs"]
mod program;
use program::{Ran, folder};

/// Small, for speed.
const WEIGHTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet-s.safetensors");
const SAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/samples");

/// Runs a line of shell with `smr-gpu`, `WEIGHTS` and `SAMPLES` in their places. No default names weights, and
/// choices of kernels are kept in the folder.
fn run(folder: &Path, line: &str) -> Ran {
    let line = line.replace("smr-gpu", r#"exec "$0""#).replace("WEIGHTS", WEIGHTS);
    let mut shell = Command::new("sh");
    shell.args(["-c", &line.replace("SAMPLES", SAMPLES), env!("CARGO_BIN_EXE_smr-gpu")]);
    shell.env("SMR_GPU_WEIGHTS", "gone.safetensors").env("SMR_GPU_CACHE", folder.join("cache"));
    shell.current_dir(folder).stdin(Stdio::null()).output().expect("a shell").into()
}

fn json(file: &Path) -> Value {
    serde_json::from_slice(&fs::read(file).expect("a file")).expect("JSON")
}

#[test]
fn detect_runs_as_a_table_says() {
    let folder = folder();
    let run = |line: &str| run(folder.path(), line);
    let measure = "smr-gpu tradeoff --data SAMPLES --limit 1 --weights WEIGHTS --sizes 32";
    let ran = run(&format!("{measure} --device cpu --out out")).expect(0);
    assert!(ran.stdout.starts_with("1 picture; bold"), "{}", ran.stdout);
    let last = ran.stdout.lines().last().expect("a line");
    let asked = "Fastest with nineteen of twenty boxes within 0.1 mm of the base: ";
    assert!(last.starts_with(&format!("{asked}{WEIGHTS}")), "{last}");
    for extension in ["json", "csv", "md", "png", "svg"] {
        let file = folder.path().join("out/tradeoff").with_extension(extension);
        assert!(fs::metadata(&file).expect("a file").len() > 100, "{}", file.display());
    }
    let table = folder.path().join("out/tradeoff.json");
    let mut edited = json(&table);
    let rows = edited["rows"].as_array().expect("rows").clone();
    // Of one picture nothing is said of several at a time.
    let of = |row: &Value| {
        let setup = &row["setup"];
        (setup["size"].as_u64(), setup["leave_out"].as_array().map_or(0, Vec::len))
    };
    let setups: Vec<_> = rows.iter().map(of).collect();
    assert_eq!(setups[..5], [(None, 0), (Some(32), 0), (None, 2), (None, 3), (None, 4)]);
    let quality = rows[0]["quality"]["iou"].as_f64().expect("an overlap");
    assert!((0.8..1.0).contains(&quality), "{quality}");

    // The table says which weights, and what is left out.
    edited["rows"] = vec![rows[0].clone()].into();
    fs::write(&table, edited.to_string()).expect("written");
    let detect = "smr-gpu detect SAMPLES/faint_stud.png --json";
    let got = run(&format!("{detect} --tradeoff out/tradeoff.json")).expect(0).json();
    let want = run(&format!("{detect} --weights WEIGHTS --device cpu --exact")).expect(0).json();
    assert_eq!(got[0]["detections"], want[0]["detections"]);
    assert_eq!(got[0]["detections"].as_array().map(Vec::len), Some(1));
    let least = "--tradeoff out/tradeoff.json --min-iou";
    run(&format!("{detect} {least} 0.9999")).expect(2).tells("best of the table, got 0.9999\n");
    run(&format!("{detect} {least} 0.5")).expect(0);

    edited["rows"] = vec![rows[4].clone()].into();
    fs::write(&table, edited.to_string()).expect("written");
    let got = run(&format!("{detect} --tradeoff out/tradeoff.json --max-shift-mm 9")).expect(0);
    let all = "--leave-out contact,regions,proposals,scales";
    let want = run(&format!("{detect} --weights WEIGHTS --device cpu {all}")).expect(0);
    assert_eq!(got.json()[0]["left_out"], want.json()[0]["left_out"]);
    assert_eq!(got.json()[0]["detections"], want.json()[0]["detections"]);

    edited["rows"][0]["setup"]["size"] = 100.into();
    fs::write(&table, edited.to_string()).expect("written");
    let ran = run(&format!("{detect} --tradeoff out/tradeoff.json")).expect(2);
    ran.tells("size: expected a multiple of 32 from 32 to 1440, got 100");
    run(&format!("{detect} --tradeoff gone.json"))
        .expect(2)
        .tells("--tradeoff: gone.json: No such");
    let ran = run(&format!("{detect} --tradeoff out")).expect(2);
    ran.tells("--tradeoff: out: expected a file, got a folder");

    // What cannot be chosen by costs no measurement.
    fs::create_dir(folder.path().join("bare")).expect("created");
    let bare = r#"{ "categories": [{ "id": 1, "name": "A" }], "annotations": [],
        "images": [{ "id": 1, "file_name": "x.png", "width": 8, "height": 8 }] }"#;
    fs::write(folder.path().join("bare/annotations.json"), bare).expect("written");
    let ran = run("smr-gpu tradeoff --data bare --weights WEIGHTS --min-iou 0.5 --out none");
    ran.expect(1).tells("--min-iou: expected pictures with labelled snaps, got none");
}

/// Kernels by operation and shapes.
fn choice(file: &Path) -> BTreeMap<String, Value> {
    let choice = json(file)["choice"]["by_shape"].as_object().expect("a map").clone();
    choice.into_iter().collect()
}

#[test]
fn a_choice_of_kernels_is_kept_beside_others() {
    let folder = folder();
    let run = |line: &str| run(folder.path(), line);
    let tune = "smr-gpu tune --seconds 1 --weights WEIGHTS";
    let printed = run(&format!("{tune} --size 32 --out t.json")).expect(0).stdout.lines().count();
    let file = folder.path().join("t.json");
    let first = choice(&file);
    assert_eq!(printed, first.len());
    assert!(first.len() > 5 && first.keys().all(|key| !key.ends_with(" f16")), "{first:?}");
    // It is kept before it is told.
    run(&format!("{tune} --size 64 --precision f16 --out t.json >&-")).expect(6);
    let both = choice(&file);
    assert!(first.iter().all(|(key, kernel)| both.get(key) == Some(kernel)), "{both:?}");
    assert!(both.keys().filter(|key| key.ends_with(" f16")).count() > 5, "{both:?}");
    // What was measured elsewhere is no neighbour.
    let mut elsewhere = json(&file);
    elsewhere["place"]["adapter"] = "another".into();
    fs::write(&file, elsewhere.to_string()).expect("written");
    run(&format!("{tune} --size 32 --out t.json")).expect(0);
    assert!(choice(&file).keys().eq(first.keys()));

    run(&format!("{tune} --timeout 0 --out t.json")).expect(5).tells("did not finish");

    // By default it is used from then on.
    let detect = "smr-gpu detect SAMPLES/stud.png --weights WEIGHTS --size 32 --device gpu --json";
    let kernels = || run(detect).expect(0).json()[0]["kernels"].clone();
    let before = kernels();
    run(&format!("{tune} --size 32")).expect(0).tells("cache/");
    assert_ne!(kernels(), before);
}

#[test]
fn every_stage_is_timed() {
    let folder = folder();
    let bench = "smr-gpu bench --runs 1 --size 32 --weights WEIGHTS";
    let stages = run(folder.path(), &format!("{bench} --json")).expect(0).json();
    let ms: f64 = stages.iter().filter_map(|stage| stage["ms"].as_f64()).sum();
    assert!(stages.len() > 5 && ms > 0.0, "{stages:?}");
    let ran = run(folder.path(), &format!("{bench} --timeout 0"));
    ran.expect(5).tells("did not finish");
}
