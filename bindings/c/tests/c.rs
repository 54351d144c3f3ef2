//! Programs in C against the library, under AddressSanitizer and UndefinedBehaviorSanitizer. Needs a C compiler,
//! `cc` or what CC says, and the library that `cargo build` makes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use smr_gpu_rust::image::DynamicImage;
use smr_gpu_rust::{Config, Device, Frame, GpuDetector, picture};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Folder of the library that this test was built beside.
fn library() -> PathBuf {
    let test = std::env::current_exe().expect("a path");
    // target/PROFILE/deps/test
    test.ancestors().nth(2).expect("a profile's folder").to_owned()
}

/// Compiles a program, with warnings as errors.
fn compile(source: &Path, program: &Path) {
    let cc = std::env::var_os("CC").unwrap_or_else(|| "cc".into());
    let ran = Command::new(cc)
        .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-g"])
        .args(["-fsanitize=address,undefined", "-fno-sanitize-recover=all"])
        .arg(format!("-I{ROOT}/include"))
        .arg(source)
        .arg(format!("-L{}", library().display()))
        .args(["-lsmr_gpu", "-lpthread", "-o"])
        .arg(program)
        .output()
        .expect("a C compiler");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
}

fn run(program: &Path, args: &[&str]) -> Output {
    Command::new(program)
        .args(args)
        .env("LD_LIBRARY_PATH", library())
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A sample as a PPM.
fn sample(folder: &Path) -> (PathBuf, DynamicImage) {
    let sample = picture::read(&Path::new(ROOT).join("../../samples/mixed.png")).expect("a sample");
    let rgb = sample.to_rgb8();
    let ppm = folder.join("mixed.ppm");
    let head = format!("P6\n{} {}\n255\n", rgb.width(), rgb.height());
    fs::write(&ppm, [head.as_bytes(), rgb.as_raw()].concat()).expect("writes");
    (ppm, sample)
}

#[test]
fn the_example_finds_what_the_library_finds() {
    let folder = tempfile::tempdir().expect("a folder");
    let (ppm, picture) = sample(folder.path());
    let program = folder.path().join("detect");
    compile(&Path::new(ROOT).join("examples/detect.c"), &program);
    let ran = run(&program, &[&ppm.display().to_string(), "0.04", "cpu"]);
    assert!(ran.status.success(), "{}", text(&ran.stderr));

    let weights = Path::new(ROOT).join("../../weights/smrnet-s.safetensors");
    let config = Config { device: Device::Cpu, mm_per_pixel: Some(0.04), ..Config::new(weights) };
    let found = GpuDetector::new(config).expect("a detector").detect(Frame::from(&picture));
    let found = found.expect("detections");
    assert_eq!(found.len(), 3);
    let lines: Vec<String> = found
        .iter()
        .map(|d| {
            let ([a, b, c, e], [x, y]) = (d.bbox, d.center_mm);
            let yaw = d.yaw_deg.map_or(String::new(), |yaw| format!("  {yaw:.1} deg"));
            format!("{} {:.4}  {a:.2} {b:.2} {c:.2} {e:.2} px  {x:.3} {y:.3} mm{yaw}\n", d.class, d.score)
        })
        .collect();
    assert_eq!(text(&ran.stdout), lines.concat());
}

#[test]
fn what_cannot_be_is_said_and_nothing_ends_the_program() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("errors");
    compile(&Path::new(ROOT).join("tests/errors.c"), &program);
    let ran = run(&program, &[]);
    assert!(ran.status.success(), "{}{}", text(&ran.stdout), text(&ran.stderr));
    let said = text(&ran.stdout);
    let expected = [
        "1 options: expected a pointer, got null",
        "1 detector: expected a pointer, got null",
        "1 options.abi: expected 1, got 9",
        "2 weights: expected `nowhere`",
        "1 detect: parameter `score`: expected a number from 0 to 1, got 2",
        "2 sensor `nowhere.json`",
        "1 detector: expected a pointer, got null",
        "1 frame: expected a pointer, got null",
        "1 frame.data: expected a pointer, got null",
        "1 frame.format: expected 0 to 11, got 99",
        "4 frame: parameter `data`",
        "4 frame: parameter `stride`: expected at least 1200 bytes, got 3",
        "4 picture: expected at least 1 × 1 pixel, got 0 × 400",
    ];
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.len(), expected.len(), "{said}");
    for (line, expected) in lines.iter().zip(expected) {
        assert!(line.starts_with(expected), "expected {expected:?}, got {line:?}");
    }
}
