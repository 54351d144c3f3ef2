//! The program from outside: exit codes, what goes to stdout and stderr, bad input.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use image::{GrayAlphaImage, GrayImage, ImageBuffer, Luma};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde_json::Value;

#[path = "support/program.rs"]
mod program;
use program::{Ran, WEIGHTS, command, f32_bytes, folder, ramp, run, write_tensors};

const SMALL_WEIGHTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet-s.safetensors");
const PICTURES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/pictures");

/// Runs the program where the Vulkan loader finds no driver.
fn run_without_adapter(folder: &Path, arguments: &[&str]) -> Ran {
    let mut command = command(folder);
    for variable in ["VK_ICD_FILENAMES", "VK_DRIVER_FILES"] {
        command.env(variable, folder.join("no_icd.json"));
    }
    command.args(arguments).output().expect("the program runs").into()
}

/// What a package installs: every command that help lists has a page, and completions know a command's options.
#[test]
fn completions_and_man_pages_cover_the_commands() {
    let folder = folder();
    for shell in ["bash", "zsh", "fish", "powershell"] {
        let ran = run(folder.path(), &["shell", "--completions", shell]).expect(0);
        assert!(ran.stdout.contains("mm-per-pixel"), "{shell}");
    }
    run(folder.path(), &["shell", "--man", "man"]).expect(0);
    let pages = fs::read_dir(folder.path().join("man")).expect("a folder");
    let pages: BTreeSet<String> =
        pages.map(|page| page.expect("a page").file_name().display().to_string()).collect();
    let help = run(folder.path(), &["--help"]).expect(0).stdout;
    let listed = help.split_once("Commands:").and_then(|(_, rest)| rest.split_once("Options:"));
    let lines = listed.expect("commands").0.lines().filter(|line| line.starts_with("  "));
    let commands = lines.filter_map(|line| line.split_whitespace().next());
    let expected: BTreeSet<String> = commands
        .filter(|command| *command != "help")
        .map(|command| format!("smr-gpu-{command}.1"))
        .chain(["smr-gpu.1".to_owned(), "smr-gpu-weights-add.1".to_owned()])
        .collect();
    assert_eq!(pages, expected);
    run(folder.path(), &["shell"]).expect(2).tells("--completions");
}

#[test]
fn wrong_command_lines_are_usage_errors() {
    let folder = folder();
    let cases: &[(&[&str], &str)] = &[
        (&[], "Usage"),
        (&["frobnicate"], "frobnicate"),
        (&["detect"], "SOURCE"),
        (&["detect", "x.png", "--conf", "1.5"], "expected a number from 0 to 1"),
        (&["detect", "x.png", "--conf=-0.1"], "expected a number from 0 to 1"),
        (&["detect", "x.png", "--conf", "NaN"], "expected a number from 0 to 1"),
        (&["detect", "x.png", "--iou", "inf"], "expected a number from 0 to 1"),
        (&["detect", "x.png", "--iou", "half"], "expected a number from 0 to 1"),
        (&["detect", "x.png", "--timeout", "NaN"], "expected a number of seconds"),
        (&["detect", "x.png", "--timeout=-1"], "expected a number of seconds"),
        (
            &["detect", "x.png", "--timeout", "86401"],
            "expected a number of seconds from 0 to 86400",
        ),
        (
            &["detect", "x.png", "--timeout", "1e300"],
            "expected a number of seconds from 0 to 86400",
        ),
        (&["detect", "x.png", "--timeout", "inf"], "expected a number of seconds from 0 to 86400"),
        (&["detect", "x.png", "--size", "0"], "expected a multiple of 32 from 32 to 1440"),
        (&["detect", "x.png", "--size", "100"], "expected a multiple of 32 from 32 to 1440"),
        (&["detect", "x.png", "--size", "1472"], "expected a multiple of 32 from 32 to 1440"),
        (&["detect", "x.png", "--size", "99999999999999999999"], "expected a multiple of 32"),
        (&["detect", "x.png", "--device", ""], "an adapter's index or part of its name, got ``"),
        (&["compare", "x.png", "--device", ""], ">': expected `auto`"),
        (&["check", "--device", " \t"], "an adapter's index or part of its name"),
        (&["detect", "x.png", "--max-det", "0"], "1..=100"),
        (&["detect", "x.png", "--max-det", "101"], "1..=100"),
        (&["detect", "x.png", "--class", "C"], "smr-gpu: --class: expected A, B, got `C`"),
        (
            &["detect", "x.png", "--precision", "f64"],
            ": expected `f32`, `f16`, `bf16` or `int8`, got `f64`",
        ),
        (&["check", "conv2d", "--case", "nope"], "smr-gpu: --case: expected one of `"),
        (&["calibrate", "--presses", ".", "--radius", "nan"], "expected a number from 0.2 to 20"),
        (&["calibrate", "--presses", ".", "--radius", "0"], "expected a number from 0.2 to 20"),
        (&["calibrate", "--presses", ".", "--radius", "inf"], "expected a number from 0.2 to 20"),
        (&["calibrate", "--presses", ".", "--mm-per-pixel", "-1"], "a number from 0.0005 to 1"),
        (&["calibrate", "--presses", ".", "--mm-per-pixel", "NaN"], "a number from 0.0005 to 1"),
        (
            &["simulate", "--out", "o", "--count", "1", "--seed", "1", "--sensor", "plain"],
            "expected paper, gelsight-mini, digit, or a file that states a `frame` to draw",
        ),
        (
            &["simulate", "--out", "o", "--count", "1", "--seed", "1", "--sensor", "nobody"],
            "expected paper, gelsight-mini, digit or a file",
        ),
        (&["eval", "--data", ".", "./"], "--data: expected each folder once, got . and ./"),
        (&["detect", "-", "-"], "expected once"),
        (&["detect", "x.png", "y.png", "--dump-stages", "s"], "expected one picture, got 2"),
        (&["eval"], "--data"),
        (&["op", "conv2d", "in", "out", "--param", "stride"], "expected KEY=VALUE"),
        (&["op", "conv2d", "in", "out", "--param", "a=1", "--param", "a=2"], "each key once"),
        (&["op", "nope", "in", "out"], "got `nope`"),
        (&["check", "nope"], "got `nope`"),
        (&["eval", "--data", ".", "--limit", "0"], "--limit"),
        (&["eval", "--data", ".", "--limit", "4294967296"], "--limit"),
        (&["eval", "--data", ".", "--conf", "NaN"], "expected a number from 0 to 1"),
        (&["eval", "--data", ".", "--conf", "-1"], "expected a number from 0 to 1"),
        (&["compare", "x.png", "--conf", "-1"], "expected a number from 0 to 1"),
        (&["check", "--device", "reference"], "held to the reference"),
        (&["tune", "--seconds", "-1"], "invalid value '-1' for '--seconds"),
        // It would change nothing.
        (&["tune", "--iou", "0.4"], "unexpected argument '--iou'"),
        (&["bench", "--iou", "0.4"], "unexpected argument '--iou'"),
        (
            &["tradeoff", "--data", ".", "--out", "out", "--max-shift-mm", "-1"],
            "expected a number of millimetres",
        ),
    ];
    for (arguments, phrase) in cases {
        let ran = run(folder.path(), arguments).expect(2).tells(phrase);
        assert_eq!(ran.stdout, "", "{arguments:?}");
        // Nobody typed what the library calls an option.
        let is_op = arguments.first() == Some(&"op");
        assert!(is_op || !ran.stderr.contains("parameter `"), "{}", ran.stderr);
    }
    run(folder.path(), &["--help"]).expect(0);
}

#[test]
fn the_version_names_commit_and_features() {
    let folder = folder();
    let version = concat!("smr-gpu ", env!("CARGO_PKG_VERSION"));
    assert_eq!(run(folder.path(), &["-V"]).expect(0).stdout, format!("{version}\n"));
    let commit = option_env!("SMR_GPU_COMMIT").map(|commit| format!(" (commit {commit})"));
    let features = if cfg!(feature = "embedded-weights") { "embedded-weights" } else { "none" };
    assert_eq!(
        run(folder.path(), &["--version"]).expect(0).stdout,
        format!("{version}{}\nfeatures: {features}\n", commit.unwrap_or_default())
    );
}

/// A copy of the weights after `change`, which sees every tensor's bytes by name.
fn weights_with(
    file: &Path,
    change: impl FnOnce(&mut HashMap<String, (Dtype, Vec<usize>, Vec<u8>)>),
) {
    let bytes = fs::read(WEIGHTS).expect("the weights");
    let (_, header) = SafeTensors::read_metadata(&bytes).expect("a header");
    let parsed = SafeTensors::deserialize(&bytes).expect("tensors");
    let mut tensors = parsed
        .iter()
        .map(|(n, v)| (n.to_owned(), (v.dtype(), v.shape().to_vec(), v.data().to_vec())))
        .collect();
    change(&mut tensors);
    let views = tensors.iter().map(|(name, (dtype, shape, bytes))| {
        (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("a tensor"))
    });
    let bytes = safetensors::serialize(views, header.metadata().clone()).expect("a file");
    fs::write(file, bytes).expect("written");
}

#[test]
fn damaged_weights_are_named() {
    let folder = folder();
    ramp(64, 64).save(folder.path().join("x.png")).expect("saved");
    let file = folder.path().join("w.safetensors");
    let detect = |phrases: [&str; 2]| {
        let arguments = ["detect", "x.png", "--weights", "w.safetensors"];
        let mut ran = run(folder.path(), &arguments).expect(3).tells("w.safetensors");
        for phrase in phrases {
            ran = ran.tells(phrase);
        }
        assert_eq!(ran.stdout, "");
    };
    detect(["weights", "No such file"]);
    fs::write(&file, "not tensors at all").expect("written");
    detect(["weights", "not a whole safetensors file"]);
    let whole = fs::read(WEIGHTS).expect("the weights");
    fs::write(&file, &whole[..whole.len() / 2]).expect("written");
    detect(["weights", "not a whole safetensors file"]);
    write_tensors(&file, &[("x", Dtype::F32, vec![1], f32_bytes(&[1.0]))]);
    detect(["metadata", "config"]);

    let name = "roi_head.fc7.weight";
    weights_with(&file, |t| drop(t.remove(name)));
    detect([name, "got none"]);
    weights_with(&file, |t| {
        t.insert("spare".into(), (Dtype::F32, vec![1], f32_bytes(&[1.0])));
    });
    detect(["`spare`", "expected none"]);
    weights_with(&file, |t| {
        let shape = &mut t.get_mut(name).expect("the tensor").1;
        *shape = vec![shape.iter().product()];
    });
    detect([name, "expected [512, 512]"]);
    weights_with(&file, |t| {
        let (dtype, _, bytes) = t.get_mut(name).expect("the tensor");
        assert_eq!(*dtype, Dtype::F16);
        bytes[20..22].copy_from_slice(&0x7e00_u16.to_le_bytes());
    });
    detect([name, "expected finite values, got NaN at 10"]);

    // What is left out until a box is in doubt is looked at before the first picture all the same.
    let name = "backbone.layer4.0.conv1.weight";
    weights_with(&file, |t| drop(t.remove(name)));
    let arguments = ["detect", "x.png", "--weights", "w.safetensors", "--leave-out", "scales"];
    let ran = run(folder.path(), &arguments).expect(3).tells(name).tells("got none");
    assert_eq!(ran.stdout, "");
}

/// At 30 pixels a millimetre the longest input shows 48 mm.
#[test]
fn a_picture_that_shows_too_much_for_the_weights_ends_no_other() {
    let folder = folder();
    let bytes = fs::read(SMALL_WEIGHTS).expect("the weights");
    let (_, header) = SafeTensors::read_metadata(&bytes).expect("a header");
    let mut metadata = header.metadata().clone().expect("metadata");
    let mut config: Value = serde_json::from_str(&metadata["config"]).expect("JSON");
    let parsed = SafeTensors::deserialize(&bytes).expect("tensors");
    let mut write = |scale: f64| {
        config["pixels_per_mm"] = scale.into();
        metadata.insert("config".into(), config.to_string());
        let bytes = safetensors::serialize(parsed.iter(), Some(metadata.clone())).expect("a file");
        fs::write(folder.path().join("w.safetensors"), bytes).expect("written");
    };
    ramp(600, 400).save(folder.path().join("wide.png")).expect("saved");
    ramp(600, 600).save(folder.path().join("square.png")).expect("saved");
    let arguments =
        ["detect", "wide.png", "square.png", "--weights", "w.safetensors", "--device", "cpu"];
    write(30.0);
    let ran = run(folder.path(), &arguments).expect(1);
    assert!(ran.stdout.contains("square.png"), "{}", ran.stdout);
    ran.tells(
        "wide.png: picture: expected a field of at most 48.000 mm along its longer side, which is 1440 \
         pixels at the weights' 30 a millimetre, got 60.000 mm",
    );
    // No field would fit.
    write(1e5);
    let ran = run(folder.path(), &arguments).expect(3).tells("w.safetensors");
    ran.tells("pixels_per_mm: expected a number from 0.001 to 144, got 100000");
}

#[test]
fn missing_devices_are_named() {
    let folder = folder();
    ramp(8, 8).save(folder.path().join("x.png")).expect("saved");
    // An index past the end is told what there is.
    run(folder.path(), &["detect", "x.png", "--device", "99"]).expect(4).tells("`99`: found 0: ");
    run(folder.path(), &["check", "--device", "no such GPU"]).expect(4).tells("`no such GPU`");
    // A number is no part of a name.
    let there = run(folder.path(), &["devices", "--json"]).expect(0).json().len();
    for index in (there..there + 10).map(|index| index.to_string()) {
        let detect = ["detect", "x.png", "--weights", "small", "--device", &index];
        run(folder.path(), &detect).expect(4).tells(&format!("`{index}`: found 0: "));
    }
    let arguments = ["detect", "x.png", "--device", "0"];
    run_without_adapter(folder.path(), &arguments).expect(4).tells("none was found");
    run_without_adapter(folder.path(), &["check", "--device", "gpu"])
        .expect(4)
        .tells("none was found");
    let ran = run_without_adapter(folder.path(), &["devices"]).expect(4);
    assert_eq!(ran.tells("mesa-vulkan-drivers").stdout, "");
}

#[test]
fn a_device_that_takes_too_long_is_told_from_a_bad_picture() {
    let folder = folder();
    let pictures = ["one.png", "two.png"];
    for name in pictures {
        ramp(40, 30).save(folder.path().join(name)).expect("a picture");
    }
    let labels = serde_json::json!({
        "categories": [{"id": 1, "name": "A"}],
        "images": [{"id": 1, "file_name": "one.png"}, {"id": 2, "file_name": "two.png"}],
        "annotations": []
    });
    fs::write(folder.path().join("annotations.json"), labels.to_string()).expect("written");
    for command in [
        &["detect", "one.png", "two.png", "--exact", "--device", "gpu"][..],
        &["compare", "one.png", "two.png", "--device", "gpu"],
        &["eval", "--data", ".", "--exact", "--device", "gpu"],
    ] {
        let ran = run(folder.path(), &[command, &["--timeout", "0"]].concat()).expect(5);
        // Each for itself.
        for name in pictures {
            let line = ran.told().into_iter().find(|line| line.contains(name));
            let line = line.unwrap_or_else(|| panic!("{name} is not named: {:?}", ran.told()));
            assert!(line.contains("did not finish the network within 0 s"), "{line}");
        }
    }
}

#[test]
fn f16_is_what_a_gpu_stores() {
    let folder = folder();
    ramp(40, 40).save(folder.path().join("x.png")).expect("saved");
    let detect = |device, precision| {
        let args = ["detect", "x.png", "--json", "--device", device, "--precision", precision];
        run(folder.path(), &args)
    };
    assert_eq!(detect("gpu", "f16").expect(0).json()[0]["precision"], "f16");
    assert_eq!(detect("gpu", "f32").expect(0).json()[0]["precision"], "f32");
    let ran = detect("cpu", "f16").expect(0);
    assert_eq!(ran.json()[0]["precision"], "f32");
    ran.tells("f16 is for GPUs");
    // Cores that multiply it do; others say that they do not, and so does a GPU.
    for name in ["bf16", "int8"] {
        let precision = name.parse().expect("a precision");
        let ran = detect("cpu", name).expect(0);
        let multiplied = ran.json()[0]["precision"].clone();
        match smr_gpu::engine::cpu::multiplies(precision) {
            true => assert_eq!(multiplied, name),
            false => {
                assert_eq!(multiplied, "f32");
                ran.tells(&format!("{name} is for cores"));
            }
        }
        let ran = detect("gpu", name).expect(0);
        assert_eq!(ran.json()[0]["precision"], "f32");
        ran.tells(&format!("{name} is for cores"));
    }
    detect("gpu", "f8").expect(2).tells("expected `f32`, `f16`, `bf16` or `int8`");
}

/// Each kernel in each precision, and what overflows in f32 alone.
#[test]
fn kernels_are_checked_in_each_precision() {
    let folder = folder();
    let check = |operation, arguments: &[&str]| {
        let all = [&["check", operation, "--device", "gpu", "--json"], arguments].concat();
        run(folder.path(), &all)
    };
    let rows = check("weighted_sum", &[]).expect(0).json();
    let of = |kernel: &str| -> Vec<&str> {
        let rows = rows.iter().filter(|row| row["kernel"] == kernel);
        rows.map(|row| row["precision"].as_str().expect("a precision")).collect()
    };
    assert_eq!(of("weighted_sum/quads"), ["f32", "f16"]);
    assert_eq!(of("weighted_sum/planar"), ["f32"]);
    let half = check("weighted_sum", &["--precision", "f16"]).expect(0).json();
    assert_eq!((half.len(), &half[0]["precision"]), (1, &"f16".into()));
    check("softmax", &["--precision", "f16"]).expect(2).tells("got none");

    let case = "an overflow on the way, which f64 hides";
    let ran = check("linear", &["--precision", "f32", "--case", case]).expect(0);
    let rows = ran.json();
    assert!(rows.iter().all(|row| row["overflows"].as_array().is_some_and(|o| o.len() == 1)));
    ran.tells("6 of 6 overflow, which f64 hides");
}

#[test]
fn without_an_adapter_the_cpu_detects() {
    let folder = folder();
    ramp(40, 40).save(folder.path().join("x.png")).expect("saved");
    let detect = ["detect", "x.png", "--json", "--mm-per-pixel", "0.5"];
    let ran = run_without_adapter(folder.path(), &detect).expect(0);
    // That is what `auto` means: nothing to tell.
    assert!(ran.told().is_empty(), "{:?}", ran.told());
    assert_eq!(ran.json()[0]["adapter"], "CPU (f32)");
}

/// Runs the program where the Vulkan loader finds one driver, which does `what` when it is loaded.
#[cfg(target_os = "linux")]
fn run_with_driver(folder: &Path, what: &str, arguments: &[&str]) -> Ran {
    let (source, library) = (folder.join("driver.rs"), folder.join("libdriver.so"));
    let text = format!(
        "#[unsafe(no_mangle)]
        pub extern \"C\" fn vk_icdNegotiateLoaderICDInterfaceVersion(_: *mut u32) -> i32 {{ {what} }}
        #[unsafe(no_mangle)]
        pub extern \"C\" fn vk_icdGetInstanceProcAddr(_: usize, _: usize) -> usize {{ {what} }}"
    );
    fs::write(&source, text).expect("written");
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    let mut compile = Command::new(rustc);
    compile.args(["--edition", "2024", "--crate-type", "cdylib", "-o"]).args([&library, &source]);
    let compiled = compile.output().expect("the compiler that made this test");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let icd = serde_json::json!({
        "file_format_version": "1.0.0",
        "ICD": { "library_path": library, "api_version": "1.3.0" },
    });
    fs::write(folder.join("icd.json"), icd.to_string()).expect("written");
    let mut command = command(folder);
    for variable in ["VK_ICD_FILENAMES", "VK_DRIVER_FILES"] {
        command.env(variable, folder.join("icd.json"));
    }
    command.args(arguments).output().expect("the program runs").into()
}

/// As a driver does that is damaged, or of a card that is.
#[cfg(target_os = "linux")]
#[test]
fn a_driver_that_crashes_takes_nothing_with_it() {
    let folder = folder();
    ramp(40, 40).save(folder.path().join("x.png")).expect("saved");
    let crash = "unsafe { (8 as *mut u8).write_volatile(1) }; 0";
    let run = |arguments: &[&str]| run_with_driver(folder.path(), crash, arguments);
    let told = "a GPU driver failed while it was loaded (signal: 11 (SIGSEGV)";
    let ran = run(&["detect", "x.png", "--json"]).expect(0).tells(told);
    assert_eq!(ran.told().iter().filter(|line| line.contains("driver")).count(), 1);
    assert_eq!(ran.tells("; going on with the CPU").json()[0]["adapter"], "CPU (f32)");
    // What asks for no GPU does not look for any; what asks for one says why there is none.
    let ran = run(&["detect", "x.png", "--device", "CPU"]).expect(0);
    assert!(!ran.stderr.contains("driver"), "{}", ran.stderr);
    run(&["detect", "x.png", "--device", "gpu"]).expect(4).tells(told);
    run(&["devices"]).expect(4).tells(told);
    run(&["check", "softmax", "--device", "0"]).expect(4).tells(told);
    run(&["bench"]).expect(4).tells(told);
    run(&["compare", "x.png", "--device", "gpu"]).expect(4).tells(told);
}

#[cfg(target_os = "linux")]
#[test]
fn a_driver_that_hangs_is_not_waited_for() {
    let folder = folder();
    ramp(40, 40).save(folder.path().join("x.png")).expect("saved");
    let hang = "loop { std::thread::sleep(std::time::Duration::from_secs(3600)) }";
    let ran = run_with_driver(folder.path(), hang, &["detect", "x.png", "--json"]).expect(0);
    let told = "the GPU drivers gave no answer within 5 s; going on with the CPU";
    assert_eq!(ran.tells(told).json()[0]["adapter"], "CPU (f32)");
}

/// Good and bad pictures of every sort, in one folder, and how each bad one is refused.
fn pictures(folder: &Path) -> (Vec<&'static str>, Vec<(&'static str, &'static str)>) {
    let save = |name: &str, picture: &image::DynamicImage| {
        picture.save(folder.join(name)).expect("saved");
    };
    let rgb = ramp(160, 120);
    save("rgb.png", &rgb.clone().into());
    save("rgb.bmp", &rgb.clone().into());
    save("grey.png", &GrayImage::from_fn(50, 70, |x, _| Luma([x as u8])).into());
    save("grey_alpha.png", &GrayAlphaImage::new(33, 31).into());
    let deep = ImageBuffer::from_fn(64, 64, |x, y| Luma([(x * y * 16) as u16]));
    save("sixteen_bit.png", &image::DynamicImage::ImageLuma16(deep));
    save("one_pixel.png", &ramp(1, 1).into());
    save("tall.png", &ramp(1, 8192).into());
    fs::copy(format!("{PICTURES}/cmyk.jpg"), folder.join("cmyk.jpg")).expect("copied");
    fs::copy(format!("{PICTURES}/turned.jpg"), folder.join("turned.jpg")).expect("copied");
    fs::copy(format!("{PICTURES}/palette.png"), folder.join("palette.png")).expect("copied");

    let whole = fs::read(folder.join("rgb.png")).expect("the picture");
    fs::write(folder.join("truncated.png"), &whole[..whole.len() / 2]).expect("written");
    fs::write(folder.join("text.png"), "no picture").expect("written");
    fs::write(folder.join("empty.png"), "").expect("written");
    fs::copy(format!("{PICTURES}/huge.png"), folder.join("huge.png")).expect("copied");
    let good = vec![
        "cmyk.jpg",
        "grey.png",
        "grey_alpha.png",
        "one_pixel.png",
        "palette.png",
        "rgb.bmp",
        "rgb.png",
        "sixteen_bit.png",
        "tall.png",
        "turned.jpg",
    ];
    let bad = vec![
        ("empty.png", "expected a PNG, JPEG, BMP or TIFF picture"),
        ("huge.png", "expected at most 33554432 pixels, got 60000 × 60000"),
        ("text.png", "expected a PNG, JPEG, BMP or TIFF picture"),
        ("truncated.png", "expected a whole PNG, got one that ends early"),
    ];
    (good, bad)
}

#[test]
fn bad_pictures_are_named_and_good_ones_go_through() {
    let folder = folder();
    let (good, bad) = pictures(folder.path());
    fs::create_dir(folder.path().join("none")).expect("created");
    let arguments = ["detect", ".", "none", "*.gif", "gone.png", "--json", "--save", "drawn"];
    let ran = run(folder.path(), &arguments).expect(1);

    let told = ran.told();
    // One more line, once a size, for the good ones, whose scale is assumed, and one for the first without a snap.
    let records = ran.json();
    let size = |r: &Value| ["width", "height"].map(|side| r[side].as_u64().expect("a side"));
    let sizes: BTreeSet<_> = records.iter().map(size).collect();
    assert!(sizes.len() > 1, "{sizes:?}");
    assert_eq!(told.len(), bad.len() + 4 + sizes.len(), "{told:#?}");
    let assumed = told.iter().filter(|line| line.contains(": assumed "));
    assert_eq!(assumed.count(), sizes.len(), "{told:#?}");
    for (file, phrase) in bad.iter().chain(&[
        ("none", "expected a folder with pictures"),
        ("*.gif", "matches none"),
        ("gone.png", "No such file"),
    ]) {
        let line = told.iter().find(|l| l.contains(file));
        let line = line.unwrap_or_else(|| panic!("{file} is not named: {told:#?}"));
        assert!(line.contains(phrase), "{line}");
    }

    let files: Vec<&str> = records.iter().map(|r| r["file"].as_str().expect("a name")).collect();
    let expected: Vec<String> = good.iter().map(|g| format!("./{g}")).collect();
    assert_eq!(files, expected);
    for (record, file) in records.iter().zip(&good) {
        let [width, height] = ["width", "height"].map(|k| record[k].as_u64().expect("a size"));
        let drawn = folder.path().join("drawn").join(drawn_name(file));
        let size = image::image_dimensions(&drawn).expect("drawn");
        assert_eq!(size, (width as u32, height as u32), "{file}");
        assert!(record["timings_ms"]["total"].as_f64().expect("a time") > 0.0);
        for detection in record["detections"].as_array().expect("a list") {
            let score = detection["score"].as_f64().expect("a score");
            assert!(score > 0.5 && score <= 1.0, "{detection}");
        }
    }
    let upright = records.iter().find(|r| r["file"] == "./turned.jpg").expect("the picture");
    assert_eq!((&upright["width"], &upright["height"]), (&16.into(), &32.into()));
}

/// `rgb.bmp` comes before `rgb.png`, so that one gets the number.
fn drawn_name(file: &str) -> String {
    match file {
        "rgb.png" => "rgb-2.png".into(),
        other => PathBuf::from(other).with_extension("png").display().to_string(),
    }
}

#[test]
fn stdin_is_a_picture_and_stages_are_dumped() {
    let folder = folder();
    let file = folder.path().join("x.png");
    ramp(100, 100).save(&file).expect("saved");
    let mut command = command(folder.path());
    command.args(["detect", "-", "--json", "--dump-stages", "stages.safetensors"]);
    command.stdin(fs::File::open(&file).expect("the picture"));
    let ran = Ran::from(command.output().expect("the program runs")).expect(0);
    assert_eq!(ran.json()[0]["file"], "-");
    let bytes = fs::read(folder.path().join("stages.safetensors")).expect("the dump");
    let (_, header) = SafeTensors::read_metadata(&bytes).expect("a header");
    let metadata = header.metadata().clone().expect("metadata");
    let config: Value = serde_json::from_str(&metadata["config"]).expect("JSON");
    let side = (40.0 * config["pixels_per_mm"].as_f64().expect("a scale")) as usize;
    let stages = SafeTensors::deserialize(&bytes).expect("tensors");
    let pixels = stages.tensor("input").expect("the network's input");
    assert_eq!((pixels.dtype(), pixels.shape()), (Dtype::F32, [3, side, side].as_slice()));
    let count = stages.tensor("detections.count").expect("the count");
    let found = ran.json()[0]["detections"].as_array().expect("a list").len();
    assert_eq!(
        (count.dtype(), count.data()),
        (Dtype::U32, (found as u32).to_le_bytes().as_slice())
    );
}

#[test]
fn devices_are_listed() {
    let folder = folder();
    let records = run(folder.path(), &["devices", "--json"]).expect(0).json();
    assert_eq!(records[0]["index"], 0);
    assert!(records[0]["limits"]["workgroup_memory_bytes"].as_u64() >= Some(16384));
    let name = records[0]["name"].as_str().expect("a name");
    assert!(run(folder.path(), &["devices"]).expect(0).stdout.contains(name));
}

#[test]
fn one_operation_runs_on_tensors_from_a_file() {
    let folder = folder();
    let file = folder.path().join("in.safetensors");
    let f32s = |shape: &[usize], values: &[f32]| (Dtype::F32, shape.to_vec(), f32_bytes(values));
    let input = f32s(&[1, 2, 2], &[1.0, 2.0, 3.0, -4.0]);
    let weight = f32s(&[1, 1, 1, 1], &[10.0]);
    let bias = f32s(&[1], &[0.5]);
    type Stored = (Dtype, Vec<usize>, Vec<u8>);
    let write = |tensors: &[(&str, &Stored)]| {
        let tensors: Vec<_> =
            tensors.iter().map(|(n, (d, s, b))| (*n, *d, s.clone(), b.clone())).collect();
        write_tensors(&file, &tensors);
    };
    let op = |extra: &[&str]| {
        let arguments = [&["op", "conv2d", "in.safetensors", "out.safetensors"], extra].concat();
        run(folder.path(), &arguments)
    };

    write(&[("input", &input), ("weight", &weight), ("bias", &bias)]);
    for device in ["gpu", "cpu"] {
        op(&["--device", device, "--param", "relu=true"]).expect(0);
        let bytes = fs::read(folder.path().join("out.safetensors")).expect("the output");
        let output = SafeTensors::deserialize(&bytes).expect("tensors");
        let output = output.tensor("output").expect("the output");
        // 10 x + 0.5, and the ReLU.
        assert_eq!(output.data(), f32_bytes(&[10.5, 20.5, 30.5, 0.0]), "{device}");
    }
    op(&["--param", "stride=0"]).expect(2).tells("stride");
    op(&["--param", "colour=red"]).expect(2).tells("colour");
    write(&[("input", &input), ("bias", &bias)]);
    op(&[]).expect(1).tells("no tensor `weight`");
    write(&[("input", &input), ("weight", &weight), ("extra", &bias)]);
    op(&[]).expect(1).tells("tensor `extra` is no input");
    let negative = (Dtype::I64, vec![1], (-3_i64).to_le_bytes().to_vec());
    write(&[("input", &negative), ("weight", &weight)]);
    op(&[]).expect(1).tells("tensor `input`: expected 0 to 4294967295, got -3");
    write(&[("input", &bias), ("weight", &weight)]);
    op(&[]).expect(1).tells("input");
    fs::write(&file, "junk").expect("written");
    op(&[]).expect(1).tells("expected a whole safetensors file");
    let listed = run(folder.path(), &["op", "--list"]).expect(0).stdout;
    assert!(
        listed.lines().any(|l| l == "conv2d") && listed.lines().any(|l| l == "nms"),
        "{listed}"
    );
}

#[test]
fn shaders_are_checked_on_the_users_machine() {
    let folder = folder();
    let check = |arguments: &[&str]| {
        let all = [&["check", "softmax", "--device", "gpu"], arguments].concat();
        run(folder.path(), &all)
    };
    let ran = check(&[]).expect(0);
    let lines: Vec<&str> = ran.stdout.lines().collect();
    assert!(
        lines[0].starts_with("operation") && lines[1].starts_with("softmax  "),
        "{}",
        ran.stdout
    );
    assert!(lines[1].contains("softmax/planar") && lines[1].contains("  ok "), "{}", lines[1]);

    // The last line, as a shell takes it, runs the nearest case alone and comes to the same.
    let command = lines.last().expect("a command");
    let words: Vec<&str> = command.split('\'').collect();
    let [start, case, end] = words[..] else { panic!("{command}") };
    assert!(lines[1].ends_with(case), "{command}");
    let arguments: Vec<&str> =
        start.split_whitespace().skip(1).chain([case]).chain(end.split_whitespace()).collect();
    let alone = run(folder.path(), &[&arguments[..], &["--json"]].concat()).expect(0).json();
    assert_eq!((alone.len(), &alone[0]["cases"]), (1, &1.into()));
    assert_eq!(alone[0]["command"], *command);
    let all = check(&["--json"]).expect(0).json();
    assert_eq!(alone[0]["share"], all[0]["share"]);
    assert!(all[0]["cases"].as_u64() > Some(20) && alone[0]["share"].as_f64() > Some(0.0));
    assert_eq!(all[0]["failures"], serde_json::json!([]));

    check(&["--case", "no such"]).expect(2).tells("`by hand`").tells("got `no such`");
    check(&["--kernel", "conv2d/direct"]).expect(2).tells("one of softmax/planar, cpu");
}

#[test]
fn the_network_is_held_to_its_reference_on_a_picture() {
    let folder = folder();
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/samples/mixed.png");
    // A small input, for speed.
    let gpu = ["compare", sample, "--size", "96", "--device", "gpu"];
    let ran = run(folder.path(), &gpu).expect(0);
    let stages = ["input", "backbone.conv1", "fusion", "rpn", "roi_head", "detections"];
    for stage in stages {
        assert!(ran.stdout.lines().any(|l| l.starts_with(stage)), "no {stage} in\n{}", ran.stdout);
    }
    assert!(ran.stdout.contains("scores within"), "{}", ran.stdout);
    // Several: a line each, and what cannot be read is named.
    fs::copy(sample, folder.path().join("a.png")).expect("copied");
    fs::write(folder.path().join("b.png"), "no picture").expect("written");
    let several = ["compare", "a.png", "b.png", "--size", "96"];
    let ran = run(folder.path(), &several).expect(1).tells("b.png");
    let lines: Vec<&str> = ran.stdout.lines().collect();
    assert!(lines.len() == 2 && lines[0].starts_with("file") && lines[1].starts_with("a.png"));
    let ran = run(folder.path(), &["compare", sample, "--size", "96", "--json"]).expect(0);
    let record: serde_json::Value = serde_json::from_str(&ran.stdout).expect("one object");
    assert_eq!(record["ok"], true);
    assert_eq!(record["failures"], serde_json::json!([]));
    let shares = record["stages"].as_array().expect("stages").iter().map(|s| s["share"].as_f64());
    assert!(shares.clone().count() >= 10 && shares.flatten().all(|s| s <= 1.0), "{record}");
    let reference = run(folder.path(), &["compare", sample, "--device", "reference"]);
    reference.expect(2).tells("expected what is held to the reference");
    let cores = run(folder.path(), &["compare", sample, "--size", "96", "--device", "cpu"]);
    assert!(cores.expect(0).stdout.contains("scores within"));
    run(folder.path(), &["compare", sample, "--size", "100"]).expect(2).tells("multiple of 32");
    run(folder.path(), &["compare", "none.png"]).expect(1).tells("none.png");
}

#[test]
fn evaluation_counts_misses_and_names_unreadable_pictures() {
    let folder = folder();
    fs::create_dir(folder.path().join("images")).expect("created");
    ramp(80, 80).save(folder.path().join("images/0.png")).expect("saved");
    let labels = serde_json::json!({
        // The third is in no annotation, as some tools write one.
        "categories":
            [{"id": 1, "name": "a"}, {"id": 2, "name": "b"}, {"id": 0, "name": "snaps"}],
        "images": [
            {"id": 7, "file_name": "0.png", "width": 80, "height": 80},
            {"id": 8, "file_name": "gone.png", "width": 80, "height": 80}
        ],
        // A snap that nobody finds in a ramp, and one in the picture that is gone.
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 1, "bbox": [70, 0, 2, 2]},
            {"id": 2, "image_id": 8, "category_id": 2, "bbox": [10, 10, 30, 30]}
        ]
    });
    let file = folder.path().join("annotations.json");
    fs::write(&file, labels.to_string()).expect("written");
    let arguments = ["eval", "--data", ".", "--json"];
    let ran = run(folder.path(), &arguments).expect(1).tells("gone.png");
    let report = &ran.json()[0];
    assert_eq!((&report["pictures"], &report["failed"]), (&1.into(), &1.into()));
    let [a, b] = [&report["classes"][0], &report["classes"][1]];
    assert_eq!((&a["class"], &a["snaps"], &a["right"]), (&"A".into(), &1.into(), &0.into()));
    assert_eq!((&a["mean_best_iou"], &a["ap50"]), (&0.0.into(), &0.0.into()));
    assert_eq!((&b["snaps"], &b["mean_best_iou"]), (&0.into(), &Value::Null));
    // The paper's figures are of its own snaps, not of any class with such a name.
    assert_eq!(a["paper"], Value::Null);
    let arguments = ["eval", "--data", ".", "--json", "--device", "cpu", "--size", "32"];
    let with_paper = [&arguments[..], &["--paper"]].concat();
    let report = &run(folder.path(), &with_paper).expect(1).json()[0];
    let iou = report["classes"][0]["paper"]["mean_iou"].as_f64().expect("an overlap");
    assert!((iou - 0.9178).abs() < 1e-12, "{iou}");

    let by_condition = ["eval", "--data", ".", "--device", "cpu", "--size", "32", "--by-condition"];
    let ran = run(folder.path(), &by_condition).expect(1).tells("the labels state no conditions");
    assert!(!ran.stdout.contains('|'), "{}", ran.stdout);

    // As a crowd the first is no snap to be found.
    let crowd = labels.to_string().replace("\"image_id\":7", "\"image_id\":7,\"iscrowd\":1");
    fs::write(&file, crowd).expect("written");
    let report = &run(folder.path(), &arguments).expect(1).json()[0];
    assert_eq!((&report["classes"][0]["snaps"], &report["all"]["snaps"]), (&0.into(), &0.into()));

    // What tests/coco.rs has more of: annotations that are refused, by the file's name.
    for (from, to, phrase) in [
        ("[70,0,2,2]", "[70,0,-2,2]", "annotations.json: annotation 1: expected a bbox"),
        ("\"gone.png\"", "\"../gone.png\"", "expected a file_name inside the folder"),
        ("\"gone.png\"", "\"images/0.png\"", "which is image 7's"),
    ] {
        let text = labels.to_string();
        assert!(text.contains(from), "{text}");
        fs::write(&file, text.replace(from, to)).expect("written");
        run(folder.path(), &arguments).expect(1).tells(phrase);
    }
    // Refused before it is opened: nobody writes into the pipe.
    fs::remove_file(&file).expect("removed");
    std::process::Command::new("mkfifo").arg(&file).status().expect("mkfifo");
    run(folder.path(), &arguments)
        .expect(1)
        .tells("annotations.json: expected a file, got a named pipe");
    fs::remove_file(&file).expect("removed");

    let renamed = labels.to_string().replace("\"name\":\"b\"", "\"name\":\"screw\"");
    fs::write(&file, renamed).expect("written");
    run(folder.path(), &arguments).expect(1).tells("got `screw`");
    run(folder.path(), &["eval", "--data", "nowhere"]).expect(1).tells("nowhere");
}

/// Two sets: a snap that nobody finds in a ramp, and a ramp without one.
fn two_sets() -> tempfile::TempDir {
    let folder = folder();
    for (set, snaps) in [("one", 1), ("none", 0)] {
        fs::create_dir(folder.path().join(set)).expect("created");
        ramp(80, 80).save(folder.path().join(set).join("0.png")).expect("saved");
        let snap = serde_json::json!({"id": 1, "image_id": 7, "category_id": 1,
            "bbox": [70, 0, 2, 2], "depth_mm": 0.5, "yaw_deg": 30, "whole": true});
        let labels = serde_json::json!({
            "categories": [{"id": 1, "name": "A"}],
            "images": [{"id": 7, "file_name": "0.png", "mm_per_pixel": 0.5,
                "conditions": {"markers_mm": 2.0 * f64::from(snaps)}}],
            "annotations": vec![snap; snaps as usize]
        });
        let file = folder.path().join(set).join("annotations.json");
        fs::write(file, labels.to_string()).expect("written");
    }
    folder
}

#[test]
fn evaluation_of_several_sets_is_one_table() {
    let folder = two_sets();
    let arguments = ["eval", "--data", "one", "none", "--device", "cpu"];
    let ran = run(folder.path(), &[&arguments[..], &["--by-condition", "--calibration"]].concat());
    let ran = ran.expect(0).tells("0 false boxes in 0 of 1 picture without a snap");
    let rows: Vec<Vec<&str>> =
        ran.stdout.lines().map(|line| line.split('|').map(str::trim).collect()).collect();
    let cell = |name: &str, column: usize| {
        let row = rows.iter().find(|row| row.get(1) == Some(&name));
        row.unwrap_or_else(|| panic!("no {name} in {}", ran.stdout))[column]
    };
    assert_eq!((cell("set", 2), cell("set", 4)), ("pictures", "IoU, %"));
    assert_eq!((cell("one", 2), cell("one", 3), cell("one", 4)), ("1", "1", "0.00 (0.0–0.0)"));
    assert_eq!((cell("none", 3), cell("none", 4), cell("none", 12)), ("0", "-", "0 in 0 of 1"));
    assert_eq!((cell("all", 2), cell("all", 3)), ("2", "1"));
    assert_eq!(cell("markers' pitch, mm: without", 2), "1");
    assert_eq!(cell("markers' pitch, mm: 2 to 3", 3), "1");
    assert!(ran.stdout.contains("expected calibration error: "), "{}", ran.stdout);

    let ran = run(folder.path(), &[&arguments[..], &["--json", "--save", "worst"]].concat());
    let reports = ran.expect(0).json();
    let names: Vec<&Value> = reports.iter().map(|report| &report["data"]).collect();
    assert_eq!(names, ["one", "none", "all"]);
    assert_eq!(reports[2]["all"]["without_snap"]["pictures"], 1);
    assert_eq!(reports[2]["conditions"][0]["condition"], "markers' pitch, mm");
    assert_eq!(reports[0]["all"]["interval_95"]["mean_best_iou"], serde_json::json!([0.0, 0.0]));
    // The set without a mistake has no worst picture.
    let sheet = image::open(folder.path().join("worst/worst-one.png")).expect("a picture");
    assert_eq!((sheet.width(), sheet.height()), (416, 440));
    assert!(!folder.path().join("worst/worst-none.png").exists());

    // A sheet that cannot be written takes no figures with it; a folder has a name wherever one stands.
    let arguments = ["eval", "--data", ".", "--device", "cpu", "--json", "--save"];
    let one = folder.path().join("one");
    let ran = run(&one, &[&arguments[..], &["/proc/self"]].concat()).expect(6);
    assert_eq!(ran.json()[0]["pictures"], 1);
    ran.tells("/proc/self/worst-one.png: cannot write");
    run(&one, &[&arguments[..], &["../here"]].concat()).expect(0);
    assert!(folder.path().join("here/worst-one.png").exists());

    // A mistake in the last set is told before the first is looked at.
    let ran = run(folder.path(), &["eval", "--data", "one", "nowhere", "--json"]);
    assert_eq!(ran.expect(1).tells("nowhere").stdout, "");
}

#[cfg(unix)]
#[test]
fn no_input_is_overwritten() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("links")).expect("created");
    ramp(8, 8).save(path("soft.png")).expect("saved");
    let original = fs::read(path("soft.png")).expect("the picture");
    fs::write(path("hard.png"), &original).expect("written");
    std::os::unix::fs::symlink(path("soft.png"), path("links/soft.png")).expect("linked");
    fs::hard_link(path("hard.png"), path("links/hard.png")).expect("linked");
    run(folder.path(), &["detect", "links/soft.png", "hard.png", "--save", "links"]).expect(0);
    for name in ["soft.png", "hard.png", "links/soft.png"] {
        assert_eq!(fs::read(path(name)).expect("a picture"), original, "{name}");
    }
    assert!(path("links/soft-2.png").exists());
    let ran = run(folder.path(), &["detect", "soft.png", "--dump-stages", "links/soft.png"]);
    ran.expect(2).tells("expected a file that is no input");
    assert_eq!(fs::read(path("soft.png")).expect("a picture"), original);

    fs::write(path("annotations.json"), "mine").expect("written");
    run(folder.path(), &["simulate", "--out", ".", "--count", "1", "--seed", "1"])
        .tells("another program");
    assert_eq!(fs::read(path("annotations.json")).expect("kept"), b"mine");
}

#[test]
fn unwritable_outputs_are_named() {
    let folder = folder();
    ramp(8, 8).save(folder.path().join("x.png")).expect("saved");
    fs::write(folder.path().join("file"), "").expect("written");
    run(folder.path(), &["detect", "x.png", "--save", "file"]).expect(6).tells("file");
    let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("Linux's full device");
    let output = command(folder.path()).args(["devices"]).stdout(full).output();
    Ran::from(output.expect("the program runs")).expect(6).tells("stdout");
}

#[test]
fn a_reader_that_leaves_ends_the_program_quietly() {
    let folder = folder();
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let output = command(folder.path()).args(["op", "--list"]).stdout(writer).output();
    let ran = Ran::from(output.expect("the program runs")).expect(141);
    assert_eq!(ran.stderr, "");
}

/// A picture of 400 × 300 pixels that show 20 × 15 mm: what is said of it follows the options.
#[test]
fn the_sensor_sets_scale_and_input() {
    let folder = folder();
    ramp(400, 300).save(folder.path().join("x.png")).expect("saved");
    let detect = |more: &[&str]| {
        let common = ["detect", "x.png", "--json", "--device", "cpu"];
        run(folder.path(), &[&common[..], more].concat())
    };
    let scale = |ran: &Ran| ran.json()[0]["mm_per_pixel"].as_f64().expect("a scale") as f32;
    let assumed = detect(&[]).expect(0);
    assert_eq!(scale(&assumed), 40.0 / 300.0);
    let assumption = "x.png: 400 × 300: assumed 0.1333 mm a pixel; --sensor, or --mm-per-pixel";
    assert_eq!(assumed.tells(assumption).json()[0]["scale_from"], "assumed");
    run(folder.path(), &["compare", "x.png", "--size", "32"]).expect(0).tells(assumption);
    let labels = |stated: &str| {
        let labels = r#"{ "categories": [], "annotations": [], "images":
            [{ "id": 1, "file_name": "x.png" STATED }, { "id": 2, "file_name": "y.png" STATED }] }"#;
        let file = folder.path().join("annotations.json");
        fs::write(file, labels.replace("STATED", stated)).expect("written");
        run(folder.path(), &["eval", "--data", ".", "--device", "cpu"]).expect(0)
    };
    fs::copy(folder.path().join("x.png"), folder.path().join("y.png")).expect("copied");
    let told = labels("").tells("2 pictures, 2 at an assumed scale on").tells(assumption).stderr;
    assert_eq!(told.matches(": assumed").count(), 1, "{told}");
    let told = labels(r#", "mm_per_pixel": 0.05"#).stderr;
    assert_eq!(told.matches(": assumed").count(), 0, "{told}");
    let stated = detect(&["--mm-per-pixel", "0.05", "--strict-scale"]).expect(0);
    assert!(stated.told().is_empty(), "{:?}", stated.told());
    assert_eq!(scale(&stated), 0.05);
    assert_eq!(stated.json()[0]["scale_from"], "stated");
    detect(&["--strict-scale"]).expect(1).tells("x.png: 400 × 300 pixels: expected its scale");
    let part = detect(&["--mm-per-pixel", "0.05", "--gel", "20,10,300,250"]).expect(0);
    let want = serde_json::json!({ "x": 20, "y": 10, "width": 300, "height": 250 });
    assert_eq!((scale(&part), &part.json()[0]["gel"]), (0.05, &want));
    let outside = detect(&["--mm-per-pixel", "0.05", "--gel", "200,10,300,250"]).expect(1);
    outside.tells("x.png: 400 × 300 pixels: gel: expected a part of the frame");
    detect(&["--gel", "1,2,3"]).expect(2).tells("`all` or X,Y,WIDTH,HEIGHT");
    let plain = detect(&["--sensor", "plain"]).expect(0);
    assert_eq!(scale(&plain), 40.0 / 300.0);
    // Frames of the shape of GelSight Mini's, with 5/4 of its pixels: or raw ones, scaled.
    let mini = detect(&["--sensor", "gelsight-mini"]).expect(0);
    assert_eq!(scale(&mini), 0.0634 / 1.25);
    mini.tells("x.png: 400 × 300: assumed 0.0507 mm a pixel");
    // A pixel of the pictures that come has what is stated, as these of the paper's gel alone.
    ramp(500, 500).save(folder.path().join("gel.png")).expect("saved");
    let mini = detect(&["--sensor", "gelsight-mini", "--mm-per-pixel", "0.05"]).expect(0);
    assert_eq!(scale(&mini), 0.05);
    let gel = ["detect", "gel.png", "--json", "--device", "cpu", "--sensor", "paper"];
    let gel = run(folder.path(), &[&gel[..], &["--mm-per-pixel", "0.08"]].concat()).expect(0);
    assert_eq!(scale(&gel), 0.08);
    let text = r#"{ "name": "mine", "frame": [800, 600], "mm_per_pixel": 0.025 }"#;
    fs::write(folder.path().join("mine.json"), text).expect("written");
    assert_eq!(scale(&detect(&["--sensor", "mine.json"]).expect(0)), 0.05);
    // A reference that can be of none of its frames.
    let text = r#"{ "name": "mine", "frame": [800, 600], "reference": "x.png" }"#;
    fs::write(folder.path().join("other.json"), text).expect("written");
    detect(&["--sensor", "other.json"])
        .expect(2)
        .tells("x.png: expected 800 × 600 pixels as the sensor's frames, got 400 × 300");

    detect(&["--sensor", "paper"])
        .expect(1)
        .tells("sensor `paper`: expected frames of the shape of");
    detect(&["--sensor", "nobody"])
        .expect(2)
        .tells("expected paper, gelsight-mini, digit, plain or a file");
    detect(&["--mm-per-pixel", "0.5"]).expect(1).tells("expected a field of 10 to 60 mm");
    for scale in ["0", "-1", "NaN", "1e9"] {
        detect(&["--mm-per-pixel", scale]).expect(2).tells("--mm-per-pixel");
    }
    fs::write(folder.path().join("mine.json"), "{}").expect("written");
    detect(&["--sensor", "mine.json"]).expect(2).tells("missing field `name`");
}

/// As long as their longest name, the columns of tables stand below their heads.
#[test]
fn tables_are_as_wide_as_the_names_of_classes() {
    let folder = folder();
    let bytes = fs::read(SMALL_WEIGHTS).expect("the weights");
    let (length, header) = SafeTensors::read_metadata(&bytes).expect("a header");
    let config = &header.metadata().as_ref().expect("metadata")["config"];
    let [old, new] = [config, &config.replace("\"B\"", "\"a bracket\"")]
        .map(|config| serde_json::to_string(config).expect("JSON"));
    let text = std::str::from_utf8(&bytes[8..][..length]).expect("text");
    let mut text = text.replace(&old, &new).into_bytes();
    assert!(text.len() > length);
    text.resize(text.len().next_multiple_of(8), b' ');
    let mut file = (text.len() as u64).to_le_bytes().to_vec();
    file.extend(text.iter().chain(&bytes[8 + length..]));
    fs::write(folder.path().join("w.safetensors"), file).expect("written");
    let stud = concat!(env!("CARGO_MANIFEST_DIR"), "/samples/stud.png");
    let detect = ["detect", stud, "--weights", "w.safetensors", "--device", "cpu"];
    let ran = run(folder.path(), &detect).expect(0);
    let lines: Vec<&str> = ran.stdout.lines().collect();
    let [head, row] = lines[..] else { panic!("a snap: {}", ran.stdout) };
    let at = |line: &str, word: &str| {
        let place = line.find(word).unwrap_or_else(|| panic!("no {word} in {line}"));
        line[..place].chars().count()
    };
    assert_eq!(at(row, "a bracket"), at(head, "class"), "{}", ran.stdout);
    let score = row.split("a bracket").nth(1).expect("a score").trim_start();
    assert_eq!(at(row, score), at(head, "score"), "{}", ran.stdout);
}

/// Files whose names are no UTF-8 stay two, in every output that names them.
#[cfg(target_os = "linux")]
#[test]
fn names_that_are_no_utf_8_are_told_apart() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = folder();
    let names = [&b"a\xff.png"[..], b"a\xfe.png", "ä.png".as_bytes()].map(OsStr::from_bytes);
    for name in names {
        let file = std::io::Cursor::new(Vec::new());
        let mut png = file;
        ramp(40, 40).write_to(&mut png, image::ImageFormat::Png).expect("encoded");
        fs::write(folder.path().join(name), png.get_ref()).expect("written");
    }
    let with = |arguments: &[&str]| {
        let mut command = command(folder.path());
        command.arg(arguments[0]).args(names).args(&arguments[1..]);
        Ran::from(command.output().expect("the program runs")).expect(0)
    };
    let quick = ["--size", "32", "--json"];
    for ran in [
        with(&[&["detect"], &quick[..], &["--device", "cpu", "--save", "out"]].concat()),
        with(&[&["compare"], &quick[..]].concat()),
    ] {
        let files: Vec<[Value; 2]> =
            ran.json().iter().map(|o| ["file", "file_base64"].map(|key| o[key].clone())).collect();
        let want = [
            ["a\\xff.png".into(), "Yf8ucG5n".into()],
            ["a\\xfe.png".into(), "Yf4ucG5n".into()],
            ["ä.png".into(), Value::Null],
        ];
        assert_eq!(files, want);
    }
    let mut saved: Vec<_> = fs::read_dir(folder.path().join("out"))
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name())
        .collect();
    saved.sort();
    assert_eq!(saved, ["a\\xfe.png", "a\\xff.png", "ä.png"]);

    // A folder of labels.
    let set = folder.path().join(OsStr::from_bytes(b"set\xff"));
    fs::create_dir(&set).expect("created");
    ramp(40, 40).save(set.join("0.png")).expect("saved");
    let labels =
        r#"{ "categories": [], "annotations": [], "images": [{ "id": 1, "file_name": "0.png" }] }"#;
    fs::write(set.join("annotations.json"), labels).expect("written");
    let mut eval = command(folder.path());
    eval.args(["eval", "--size", "32", "--json", "--device", "cpu", "--data"]).arg(&set);
    let ran = Ran::from(eval.output().expect("the program runs")).expect(0);
    let data = ran.json()[0]["data"].as_str().expect("a name").to_owned();
    assert!(data.ends_with("/set\\xff"), "{data}");
    assert!(ran.json()[0]["data_base64"].is_string());
}

/// Labels from Windows, also with a byte order mark.
#[cfg(unix)]
#[test]
fn backslashes_in_labels_lead_to_files_inside_the_folder() {
    let folder = folder();
    for set in ["set", "set/left", "images"] {
        fs::create_dir(folder.path().join(set)).expect("created");
        ramp(40, 40).save(folder.path().join(set).join("a.png")).expect("saved");
    }
    let eval = |name: &str| {
        let labels = serde_json::json!({ "categories": [], "annotations": [],
            "images": [{ "id": 1, "file_name": name }] });
        let file = folder.path().join("set/annotations.json");
        fs::write(file, format!("\u{feff}{labels}")).expect("written");
        let arguments = ["eval", "--size", "32", "--json", "--device", "cpu", "--data", "set"];
        run(folder.path(), &arguments)
    };
    assert_eq!(eval("left\\a.png").expect(0).json()[0]["pictures"], 1);
    eval("..\\images\\a.png").expect(1).tells("set/images/..\\images\\a.png: No such file");
    // A file of that very name comes first.
    fs::write(folder.path().join("set/left\\a.png"), "no picture").expect("written");
    eval("left\\a.png").expect(1).tells("set/left\\a.png: ");
}

/// A few bytes ask for no gigabytes, whatever the command.
#[test]
fn a_sensor_of_too_many_pixels_is_refused_where_it_is_read() {
    let folder = folder();
    fs::write(folder.path().join("s.json"), r#"{ "name": "s", "frame": [65535, 65535] }"#)
        .expect("written");
    for command in [&["bench"][..], &["tune"], &["detect", "x.png"], &["compare", "x.png"]] {
        run(folder.path(), &[command, &["--sensor", "s.json"]].concat())
            .expect(2)
            .tells("sensor `s.json`: frame: expected at most 33554432 pixels, got 65535 × 65535");
    }
    let text = "\u{feff}{ \"name\": \"s\", \"frame\": [64, 64] }";
    fs::write(folder.path().join("s.json"), text).expect("written");
    ramp(64, 64).save(folder.path().join("x.png")).expect("saved");
    let detect = ["detect", "x.png", "--size", "32", "--device", "cpu", "--sensor", "s.json"];
    run(folder.path(), &detect).expect(0);
}
