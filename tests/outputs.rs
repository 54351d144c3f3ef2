//! What the program writes: whole or not at all, over nothing that is an input or somebody else's,
//! and with an exit code that says what was delivered.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;

use image::{Rgb, RgbImage};
use safetensors::tensor::Dtype;
use smr_gpu::simulator::Error;
use smr_gpu::simulator::dataset::{Settings, simulate};
use smr_gpu::simulator::render::Request;
use smr_gpu::simulator::scene::Mix;

#[path = "support/program.rs"]
mod program;
use program::{Ran, WEIGHTS, command, f32_bytes, folder, ramp, run, write_tensors};

/// Small and on the CPU, for speed.
const QUICK: [&str; 4] = ["--size", "32", "--device", "cpu"];

/// Runs `detect` with these arguments.
fn detect(folder: &Path, arguments: &[&str]) -> Ran {
    run(folder, &[&["detect"], arguments, &QUICK].concat())
}

/// Runs a line of shell in which `$0` is the program.
fn shell(folder: &Path, line: &str) -> Ran {
    let mut shell = Command::new("sh");
    shell.args(["-c", line, env!("CARGO_BIN_EXE_smr-gpu")]).current_dir(folder);
    shell.env("SMR_GPU_WEIGHTS", WEIGHTS).stdin(Stdio::null());
    shell.output().expect("a shell").into()
}

fn make_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().expect("mkfifo").success());
}

/// Everything below a folder: its files with their bytes, anything else without; but for the lock,
/// in which each run leaves its number.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let entry = entry.expect("an entry");
        let (path, kind) = (entry.path(), entry.file_type().expect("a kind"));
        if kind.is_dir() {
            found.extend(contents(&path));
        }
        let bytes = kind.is_file().then(|| fs::read(&path).expect("a file"));
        if !path.ends_with(".simulate.lock") {
            found.insert(path, bytes);
        }
    }
    found
}

/// The folder as `simulate` would leave it after `count` pictures.
fn data_set(out: &Path, count: u32) -> Ran {
    let count = count.to_string();
    run(out, &["simulate", "--out", ".", "--count", &count, "--seed", "5", "--kind", "none"])
}

#[test]
fn drawn_pictures_replace_nothing_but_drawn_pictures() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("out")).expect("created");
    for name in ["a.png", "b.png", "c.png", "out/d.png", "e.png"] {
        ramp(8, 8).save(path(name)).expect("saved");
    }
    fs::write(path("precious"), "mine").expect("written");
    // Names that an earlier version used on the way, and that nobody may touch.
    symlink("../precious", path("out/a.unfinished")).expect("linked");
    make_pipe(&path("out/b.unfinished"));
    // Names that are taken by what no picture replaces.
    symlink("../precious", path("out/a.png")).expect("linked");
    fs::create_dir(path("out/b.png")).expect("created");
    make_pipe(&path("out/c.png"));
    fs::write(path("out/e.png"), "an earlier picture").expect("written");
    // An input by another name.
    fs::hard_link(path("c.png"), path("out/c-2.png")).expect("linked");

    let sources = ["a.png", "b.png", "c.png", "out/d.png", "e.png"];
    let before = contents(folder.path());
    detect(folder.path(), &[&sources[..], &["--save", "out"]].concat()).expect(0);
    let mut after = contents(folder.path());
    for new in ["out/a-2.png", "out/b-2.png", "out/c-3.png", "out/d-2.png", "out/e.png"] {
        let bytes = after.remove(&path(new)).flatten().expect(new);
        image::load_from_memory(&bytes).expect(new);
    }
    let mut kept = before;
    kept.remove(&path("out/e.png"));
    assert!(after == kept, "{:?} against {:?}", after.keys(), kept.keys());
}

#[test]
fn a_picture_that_cannot_be_saved_ends_no_other() {
    let folder = folder();
    let save =
        |name: &str| ramp(8, 8).save_with_format(folder.path().join(name), image::ImageFormat::Png);
    let (long, too_long) = (format!("{}.png", "b".repeat(246)), "c".repeat(255));
    for name in ["a.png", &long, &too_long, "d.png"] {
        save(name).expect("saved");
    }
    let sources = ["a.png", &long, &too_long, "gone.png", "d.png", "--json", "--save", "out"];
    // A name without an ending gets one, and is too long then.
    let ran = detect(folder.path(), &sources).expect(6).tells("ccc.png: cannot write");
    // These two, and the scale that is assumed.
    assert_eq!(ran.told().len(), 3, "{:?}", ran.told());
    assert_eq!(ran.json().len(), 4);
    let saved = contents(&folder.path().join("out"));
    let names: Vec<_> = saved.keys().filter_map(|p| p.file_name()?.to_str()).collect();
    assert_eq!(names, ["a.png", &long, "d.png"]);
}

#[test]
fn no_tensors_replace_an_input() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    ramp(8, 8).save(path("x.png")).expect("saved");
    fs::hard_link(path("x.png"), path("hard")).expect("linked");
    fs::copy(WEIGHTS, path("w.safetensors")).expect("copied");
    fs::hard_link(path("w.safetensors"), path("hard weights")).expect("linked");
    write_tensors(&path("in"), &[("input", Dtype::F32, vec![1, 1], f32_bytes(&[1.0]))]);
    symlink("in", path("soft in")).expect("linked");
    make_pipe(&path("pipe"));
    symlink("elsewhere", path("link")).expect("linked");
    let before = contents(folder.path());

    let dump =
        |to| detect(folder.path(), &["x.png", "--weights", "w.safetensors", "--dump-stages", to]);
    for input in ["x.png", "hard", "w.safetensors", "hard weights"] {
        dump(input).expect(2).tells(&format!("{input}: expected a file that is no input"));
    }
    let mut on_stdin = command(folder.path());
    on_stdin.args(["detect", "-", "--dump-stages", "hard"]).args(QUICK);
    on_stdin.stdin(File::open(path("x.png")).expect("the picture"));
    Ran::from(on_stdin.output().expect("the program runs")).expect(2).tells("no input");
    let op = |to| run(folder.path(), &["op", "softmax", "in", to, "--device", "cpu"]);
    for input in ["in", "soft in"] {
        op(input).expect(2).tells("expected a file that is no input");
    }
    for (other, phrase) in [
        ("pipe", "got a named pipe"),
        ("link", "got a symbolic link"),
        (".", "got a folder"),
        ("/dev/null", "got a device"),
    ] {
        dump(other).expect(6).tells(phrase);
        op(other).expect(6).tells(phrase);
    }
    assert!(contents(folder.path()) == before);
    op("out").expect(0);
    // Nor the picture that the same run has drawn.
    let both = detect(folder.path(), &["x.png", "--save", "drawn", "--dump-stages", "drawn/x.png"]);
    both.expect(2).tells("drawn/x.png: expected a file that is no input or other output");
    image::open(path("drawn/x.png")).expect("the drawn picture");
}

/// What a command reads besides pictures: weights, a sensor's file and its reference frame, a table, and
/// labels.
#[test]
fn nothing_that_is_read_is_replaced() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    for name in ["x.png", "bg.png", "worst-set.png"] {
        ramp(8, 8).save(path(name)).expect("saved");
    }
    fs::create_dir(path("d")).expect("created");
    fs::copy(path("bg.png"), path("d/bg.png")).expect("copied");
    fs::write(path("s.json"), r#"{ "name": "s", "reference": "bg.png" }"#).expect("written");
    fs::copy(WEIGHTS, path("w.safetensors")).expect("copied");
    let setup =
        r#"{ "weights": "w.safetensors", "size": 32, "device": "cpu", "kernels": [], "batch": 1 }"#;
    let digest = smr_gpu::evaluation::tradeoff::digest(&fs::read(WEIGHTS).expect("the weights"));
    let table = format!(
        r#"{{ "place": null, "weights": [["w.safetensors", "{digest}"]], "pictures": 1, "stopped": false,
            "base": {setup}, "rows": [{{ "setup": {setup}, "wall_ms": {ONE}, "device_ms": null,
            "peak_bytes": null, "stages": [], "shift": {{ "mm": {ONE}, "score": null, "boxes": 1,
            "lost": 0, "gained": 0 }}, "quality": null }}] }}"#
    );
    fs::write(path("t.json"), table).expect("written");
    // Labels of a picture whose name is one of an output.
    fs::create_dir(path("set")).expect("created");
    for name in ["set/tradeoff.png", "set/worst-set.png"] {
        ramp(8, 8).save(path(name)).expect("saved");
    }
    let annotations = r#"{ "categories": [{ "id": 1, "name": "A" }, { "id": 2, "name": "B" }], "images": [
        { "id": 1, "file_name": "tradeoff.png", "width": 8, "height": 8 },
        { "id": 2, "file_name": "worst-set.png", "width": 8, "height": 8 }], "annotations": [
        { "id": 1, "image_id": 1, "category_id": 1, "bbox": [0, 0, 4, 4], "area": 16, "iscrowd": 0 },
        { "id": 2, "image_id": 2, "category_id": 1, "bbox": [0, 0, 4, 4], "area": 16, "iscrowd": 0 }] }"#;
    fs::write(path("set/annotations.json"), annotations).expect("written");
    let before = contents(folder.path());

    for (arguments, file) in [
        ("detect x.png --size 32 --device cpu --sensor s.json --dump-stages s.json", "s.json"),
        ("detect x.png --size 32 --device cpu --sensor s.json --dump-stages bg.png", "bg.png"),
        ("detect x.png --tradeoff t.json --max-shift-mm 9 --dump-stages t.json", "t.json"),
        ("tune --seconds 1 --size 32 --weights w.safetensors --out w.safetensors", "w.safetensors"),
        ("tune --seconds 1 --size 32 --sensor s.json --out s.json", "s.json"),
        ("tradeoff --sizes 32 --device cpu --limit 1 --data set --out set", "set/tradeoff.png"),
    ] {
        let ran = run(folder.path(), &arguments.split(' ').collect::<Vec<_>>());
        ran.expect(2).tells(&format!("{file}: expected a file that is no input"));
    }
    assert!(contents(folder.path()) == before);

    // Where a picture is drawn, it gets a number.
    let numbered = |arguments: &str, name: &str| {
        run(folder.path(), &arguments.split(' ').collect::<Vec<_>>()).expect(0);
        fs::remove_file(path(name)).expect(name);
        assert!(contents(folder.path()) == before, "{arguments}");
    };
    numbered("detect d/bg.png --size 32 --device cpu --sensor s.json --save .", "bg-2.png");
    let eval = "eval --size 32 --device cpu --data set --limit 1 --save set";
    numbered(eval, "set/worst-set-2.png");
    numbered(&format!("{eval} --sensor s.json"), "set/worst-set-2.png");
}

/// A spread of a table.
const ONE: &str = r#"{ "median": 1, "percentile_95": 1, "worst": 1 }"#;

#[test]
fn a_full_disk_leaves_no_part_of_a_file() {
    let folder = folder();
    // Noise does not compress.
    let mut state = 1_u32;
    let noise = RgbImage::from_fn(100, 100, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        Rgb([8, 16, 24].map(|shift| (state >> shift) as u8))
    });
    noise.save(folder.path().join("x.png")).expect("saved");
    fs::write(folder.path().join("stages"), "an earlier dump").expect("written");
    fs::create_dir(folder.path().join("out")).expect("created");
    let before = contents(folder.path());
    // No file may grow past 8 KiB at most: as on a full disk, the first part can be written.
    let line = format!(
        "trap '' XFSZ; ulimit -f 8; exec \"$0\" detect x.png --save out --dump-stages stages {}",
        QUICK.join(" ")
    );
    let ran = shell(folder.path(), &line).expect(6);
    let ran = ran.tells("stages: cannot write").tells("out/x.png: cannot write");
    assert!(ran.stdout.contains("x.png"), "no result: {}", ran.stdout);
    assert!(contents(folder.path()) == before);
}

#[test]
fn a_stranger_s_folder_stays_as_it_is() {
    for strange in ["labels/000000.json", "images/000000.png", "annotations.json"] {
        let folder = folder();
        let file = folder.path().join(strange);
        fs::create_dir_all(file.parent().expect("a folder")).expect("created");
        fs::write(&file, "mine").expect("written");
        let before = contents(folder.path());
        data_set(folder.path(), 1).expect(2).tells("another program");
        assert!(contents(folder.path()) == before, "{strange}");
    }
    // What is there beside a data set is no matter, nor is an empty folder.
    let folder = folder();
    fs::write(folder.path().join("notes"), "mine").expect("written");
    fs::create_dir(folder.path().join("images")).expect("created");
    data_set(folder.path(), 1).expect(0);
}

#[test]
fn an_earlier_run_s_pictures_count_if_they_are_whole() {
    let folder = folder();
    let [picture, label] =
        ["images/000000.png", "labels/000000.json"].map(|f| folder.path().join(f));
    data_set(folder.path(), 2).expect(0).tells("2 pictures (2 new)");
    let whole = contents(folder.path());
    data_set(folder.path(), 2).expect(0).tells("2 pictures (0 new)");

    let mend = |damage: &dyn Fn()| {
        damage();
        data_set(folder.path(), 2).expect(0).tells("2 pictures (1 new)");
        assert!(contents(folder.path()) == whole);
    };
    let text = fs::read_to_string(&label).expect("the label");
    let bytes = fs::read(&picture).expect("the picture");
    mend(&|| fs::write(&picture, "").expect("written"));
    mend(&|| fs::write(&picture, &bytes[..bytes.len() / 2]).expect("written"));
    mend(&|| fs::write(&label, "").expect("written"));
    // An early version's label, without the picture's size.
    let size = format!("\"picture_bytes\":{},", bytes.len());
    assert!(text.contains(&size), "{text}");
    mend(&|| fs::write(&label, text.replace(&size, "")).expect("written"));

    // What no run wrote there is named, and nothing is written.
    let other = fs::read(folder.path().join("labels/000001.json")).expect("a label");
    for (strange, phrase) in [(&b"mine"[..], "what an earlier run wrote"), (&other, "scene seed")] {
        fs::write(&label, strange).expect("written");
        fs::remove_file(folder.path().join("images/000001.png")).ok();
        let before = contents(folder.path());
        data_set(folder.path(), 2).expect(6).tells("000000.json: expected").tells(phrase);
        assert!(contents(folder.path()) == before, "{phrase}");
    }
}

#[test]
fn one_run_at_a_time_writes_a_data_set() {
    let folder = folder();
    let settings = Settings {
        out: folder.path().into(),
        count: 1,
        seed: 1,
        request: Request::plain(Mix::None),
        shard: None,
    };
    let second = Mutex::new(None);
    simulate(&settings, &|_| {
        second.lock().expect("no panic").get_or_insert_with(|| simulate(&settings, &|_| ()));
    })
    .expect("the first");
    let error = second.into_inner().expect("no panic").expect("a second").expect_err("locked");
    let this = std::process::id();
    assert!(matches!(error, Error::Busy { holder: Some(id), .. } if id == this), "{error}");

    let lock = File::open(folder.path().join(".simulate.lock")).expect("the lock");
    lock.lock().expect("locked");
    let arguments = ["simulate", "--out", ".", "--count", "1", "--seed", "1", "--kind", "none"];
    let ran = run(folder.path(), &arguments).expect(6);
    ran.tells(&format!("got one that process {this} writes to"));
    drop(lock);
    run(folder.path(), &arguments).expect(0).tells("(0 new)");
}

/// What has the lock's name is not written, whatever other name it has.
#[test]
fn no_lock_is_written_into_a_file_of_the_user_s() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let simulate = |more: &[&str]| {
        let arguments = ["simulate", "--out", "o", "--count", "1", "--seed", "1", "--kind", "none"];
        run(folder.path(), &[&arguments[..], more].concat())
    };
    fs::create_dir(path("o")).expect("created");
    fs::write(path("thesis.txt"), "mine").expect("written");
    fs::hard_link(path("thesis.txt"), path("o/.simulate.lock")).expect("linked");
    let before = contents(folder.path());
    let told =
        "o/.simulate.lock: expected a free name or a file to replace, got a file that is no lock";
    simulate(&[]).expect(6).tells(told);
    assert!(contents(folder.path()) == before);

    fs::remove_file(path("o/.simulate.lock")).expect("removed");
    let sensor = r#"{ "name": "s", "frame": [320, 240], "mm_per_pixel": 0.06 }"#;
    fs::write(path("o/.simulate.lock"), sensor).expect("written");
    let before = contents(folder.path());
    simulate(&["--sensor", "o/.simulate.lock"]).expect(6).tells(told);
    assert!(contents(folder.path()) == before);
}

#[test]
fn a_data_set_does_not_go_where_links_lead() {
    for name in ["images", "labels"] {
        let folder = folder();
        fs::create_dir(folder.path().join("elsewhere")).expect("created");
        fs::create_dir(folder.path().join("set")).expect("created");
        symlink("../elsewhere", folder.path().join("set").join(name)).expect("linked");
        let before = contents(folder.path());
        data_set(&folder.path().join("set"), 1)
            .expect(6)
            .tells(&format!("{name}: expected a folder of its own, found a symbolic link"));
        assert!(contents(folder.path()) == before, "{name}");
        // Nor does one that was begun before the link came.
        fs::remove_file(folder.path().join("set").join(name)).expect("removed");
        data_set(&folder.path().join("set"), 1).expect(0);
        fs::remove_dir_all(folder.path().join("set").join(name)).expect("removed");
        symlink("../elsewhere", folder.path().join("set").join(name)).expect("linked");
        let before = contents(folder.path());
        data_set(&folder.path().join("set"), 2).expect(6).tells("found a symbolic link");
        assert!(contents(folder.path()) == before, "{name}");
    }
}

#[test]
fn the_largest_data_set_begins_at_once() {
    let folder = folder();
    let mut command = command(folder.path());
    command.args([
        "simulate",
        "--out",
        ".",
        "--seed",
        "1",
        "--kind",
        "none",
        "--count",
        "4294967295",
    ]);
    let mut running = command.stderr(Stdio::null()).spawn().expect("the program runs");
    // To look for each of the pictures would take hours, and to list them more memory than there is.
    let labels = folder.path().join("labels");
    let has_begun = || fs::read_dir(&labels).is_ok_and(|mut l| l.next().is_some());
    while !has_begun() {
        assert_eq!(running.try_wait().expect("a child"), None, "it ended");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    running.kill().expect("killed");
    running.wait().expect("ended");
}

#[test]
fn data_that_stdout_does_not_take_is_no_success() {
    let folder = folder();
    for arguments in ["op --list", "--help", "--version", "detect --help"] {
        let ran = shell(folder.path(), &format!("exec \"$0\" {arguments} >&-"));
        ran.expect(6).tells("stdout: closed");
        let ran = shell(folder.path(), &format!("exec \"$0\" {arguments} >/dev/full"));
        ran.expect(6).tells("stdout: No space left");
    }
    // What has nothing to say there needs no stdout.
    let file = folder.path().join("in");
    write_tensors(&file, &[("input", Dtype::F32, vec![1, 1], f32_bytes(&[1.0]))]);
    shell(folder.path(), "exec \"$0\" op softmax in out --device cpu >&-").expect(0);
    // As Python's subprocess.DEVNULL and systemd open it; Rust's start-up does the same.
    let null = OpenOptions::new().read(true).write(true).open("/dev/null").expect("the device");
    let output = command(folder.path()).args(["op", "--list"]).stdout(null).output();
    Ran::from(output.expect("the program runs")).expect(0);
}

#[test]
fn a_reader_that_leaves_early_is_told_from_success() {
    let folder = folder();
    ramp(40, 40).save(folder.path().join("first.png")).expect("saved");
    let mut command = command(folder.path());
    let detect = ["detect", "first.png", "-", "--mm-per-pixel", "1"];
    command.args(detect).args(QUICK).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut running = command.stderr(Stdio::piped()).spawn().expect("the program runs");
    let mut heading = String::new();
    let stdout = running.stdout.take().expect("a pipe");
    BufReader::new(stdout).read_line(&mut heading).expect("the heading");
    assert!(heading.starts_with("file"), "{heading}");
    // The reader is gone, as `head -1` is; now comes the picture.
    let mut picture = std::io::Cursor::new(Vec::new());
    ramp(40, 40).write_to(&mut picture, image::ImageFormat::Png).expect("encoded");
    let mut stdin = running.stdin.take().expect("a pipe");
    stdin.write_all(picture.get_ref()).expect("written");
    drop(stdin);
    let mut told = String::new();
    running.stderr.take().expect("a pipe").read_to_string(&mut told).expect("UTF-8");
    let code = running.wait().expect("ended").code();
    assert_eq!((code, told.as_str()), (Some(141), ""));
}

/// Writes presses for `calibrate`, all of them the same picture.
fn write_presses(folder: &Path, background: &RgbImage, press: &RgbImage, centers: &[[u32; 2]]) {
    let mut table = "file,center_x_px,center_y_px,contact_radius_px\n".to_owned();
    background.save(folder.join("background.png")).expect("saved");
    press.save(folder.join("press.png")).expect("saved");
    for [x, y] in centers {
        table += &format!("press.png,{x},{y},20\n");
    }
    fs::write(folder.join("presses.csv"), table).expect("written");
}

#[test]
fn presses_that_determine_no_sensor_are_refused() {
    let folder = folder();
    let presses = ["calibrate", "--presses", ".", "--mm-per-pixel", "0.0295"];
    let calibrate = |to: &str| run(folder.path(), &[&presses[..], &["--write", to]].concat());
    // One pixel, six times.
    let pixel = RgbImage::from_pixel(1, 1, Rgb([130; 3]));
    write_presses(folder.path(), &pixel, &pixel, &[[0, 0]; 6]);
    let before = contents(folder.path());
    calibrate("sensor.json").expect(1).tells(
        "expected presses that determine the 30 coefficients of each channel, got 6 pixels that \
         determine",
    );
    assert!(contents(folder.path()) == before);

    // Enough pixels, but nothing is to be seen in them.
    let grey = RgbImage::from_pixel(90, 90, Rgb([130; 3]));
    let centers = [[20, 20], [70, 20], [20, 70], [70, 70], [45, 45], [40, 60]];
    write_presses(folder.path(), &grey, &grey, &centers);
    let before = contents(folder.path());
    let ran = calibrate("sensor.json").expect(1).tells("L1 0.00; got 0.00");
    assert!(ran.stdout.contains("held out"), "no figures: {}", ran.stdout);
    for input in ["press.png", "presses.csv", "background.png"] {
        calibrate(input).expect(2).tells("expected a file that is no input");
    }
    assert!(contents(folder.path()) == before);
}

/// Whatever becomes of what is printed.
#[test]
fn a_fitted_sensor_is_kept() {
    let folder = folder();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/gelsight_ball_presses");
    let presses = folder.path().join("my presses");
    fs::create_dir(&presses).expect("created");
    let table = fs::read_to_string(source.join("presses.csv")).expect("the table");
    // A few of them: time goes with their number.
    let mut few = table.lines().take(1).collect::<Vec<_>>();
    few.extend(table.lines().skip(1).step_by(5));
    fs::write(presses.join("presses.csv"), few.join("\n")).expect("written");
    let names = few[1..].iter().filter_map(|line| line.split(',').next());
    for name in names.chain(["background.png"]) {
        fs::copy(source.join(name), presses.join(name)).expect("copied");
    }
    let line = "exec \"$0\" calibrate --presses 'my presses' --mm-per-pixel 0.0295 --write s.json \
                --optics o.json --save p.png >&-";
    let ran = shell(folder.path(), line).expect(6);
    ran.tells("s.json: for --sensor").tells("o.json: 1 sensor").tells("stdout: closed");
    let optics = fs::read_to_string(folder.path().join("o.json")).expect("optics");
    assert!(optics.contains(r#""name":"my presses""#), "{optics}");
    image::open(folder.path().join("p.png")).expect("a picture");
    let press = format!("my presses/{}", few[1].split(',').next().expect("a name"));
    detect(folder.path(), &[&press, "--sensor", "s.json"]).expect(0);
}
