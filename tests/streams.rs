//! Streams in, files out: what `detect` reads frame by frame, and what it writes of each.
#![cfg(unix)]

use std::fs;
use std::io::{BufRead, BufReader, Cursor, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};

use image::{ImageFormat, RgbImage};
use serde_json::Value;

#[path = "support/program.rs"]
mod program;
use program::{Ran, command, folder, ramp};

const SMALL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet-s.safetensors");
const SAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/samples");

/// `detect` with the small network on the CPU.
fn detect(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = command(folder);
    command.arg("detect").args(arguments);
    command.args(["--weights", SMALL, "--device", "cpu"]);
    // Where a test puts its own ffmpeg, and nobody else's.
    command.env("PATH", format!("{}:/bin:/usr/bin", folder.join("bin").display()));
    command
}

/// Runs it with these bytes on stdin.
fn fed(mut command: Command, bytes: &[u8]) -> Ran {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut running = command.spawn().expect("the program runs");
    let mut stdin = running.stdin.take().expect("a pipe");
    std::thread::scope(|scope| {
        scope.spawn(move || {
            // It may have heard enough.
            let _ = stdin.write_all(bytes);
        });
        running.wait_with_output().expect("it ends").into()
    })
}

fn ran(mut command: Command) -> Ran {
    command.output().expect("the program runs").into()
}

fn stored(picture: &RgbImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("encoded");
    bytes.into_inner()
}

fn sample(name: &str) -> RgbImage {
    image::open(Path::new(SAMPLES).join(name)).expect("a sample").to_rgb8()
}

/// What does not change from run to run.
fn found(record: &Value) -> [&Value; 4] {
    ["detections", "width", "height", "regions"].map(|key| &record[key])
}

/// Frames' names, indices and times.
fn frames(ran: &Ran) -> Vec<(String, u64, Option<f64>)> {
    let frame = |record: &Value| {
        let name = record["frame"].as_str().expect("a name").to_owned();
        (name, record["index"].as_u64().expect("an index"), record["time_s"].as_f64())
    };
    ran.json().iter().map(frame).collect()
}

/// Puts a program called ffmpeg before all others.
fn fake_ffmpeg(folder: &Path, script: &str) {
    let file = folder.join("bin/ffmpeg");
    fs::create_dir_all(folder.join("bin")).expect("created");
    fs::write(&file, format!("#!/bin/sh\n{script}\n")).expect("written");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).expect("set");
}

#[test]
fn every_file_has_what_was_printed() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir_all(path("in/deep")).expect("created");
    for (from, to) in [("hooks.png", "in/deep/two.png"), ("stud.png", "in/one.png")] {
        fs::copy(Path::new(SAMPLES).join(from), path(to)).expect("copied");
    }
    ramp(64, 64).save(path("in/none.png")).expect("saved");
    let arguments =
        "in --recursive --json -v --csv t.csv --coco c.json --yolo yolo --crops crops --save drawn";
    let ran = ran(detect(folder.path(), &arguments.split(' ').collect::<Vec<_>>())).expect(0);
    let records = ran.json();
    let names: Vec<_> = frames(&ran);
    let want = [("in/none.png", 0), ("in/one.png", 1), ("in/deep/two.png", 2)];
    assert_eq!(names, want.map(|(name, index)| (name.to_owned(), index, None)));

    let snaps: Vec<(usize, &Value, &Value)> = records
        .iter()
        .enumerate()
        .flat_map(|(at, r)| {
            r["detections"].as_array().expect("a list").iter().map(move |d| (at, r, d))
        })
        .collect();
    assert!(snaps.len() >= 2, "{}", ran.stdout);
    let number = |value: &Value| value.as_f64().expect("a number") as f32;
    let corners = |d: &Value| [0, 1, 2, 3].map(|i| number(&d["box"][i]));

    let table = fs::read_to_string(path("t.csv")).expect("the table");
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    let head = "frame,index,time_s,class,score,x1,y1,x2,y2,x_mm,y_mm,yaw_deg,whole";
    assert_eq!((rows[0].join(","), rows.len()), (head.to_owned(), snaps.len() + 1));
    let coco: Vec<Value> =
        serde_json::from_slice(&fs::read(path("c.json")).expect("results")).expect("JSON");
    assert_eq!(coco.len(), snaps.len());
    for (((at, record, snap), row), result) in snaps.iter().zip(&rows[1..]).zip(&coco) {
        let [x1, y1, x2, y2] = corners(snap);
        let name = record["frame"].as_str().expect("a name");
        assert_eq!(row[..4], [name, &at.to_string(), "", snap["class"].as_str().expect("a class")]);
        let numbers: Vec<f32> =
            row[4..11].iter().map(|text| text.parse().expect("a number")).collect();
        let center = [0, 1].map(|i| number(&snap["center_mm"][i]));
        assert_eq!(numbers, [number(&snap["score"]), x1, y1, x2, y2, center[0], center[1]]);
        let class = snap["class_index"].as_u64().expect("a class");
        assert_eq!(
            (&result["image_id"], &result["category_id"]),
            (&(*at).into(), &(class + 1).into())
        );
        assert_eq!((&result["file_name"], &result["score"]), (&record["frame"], &snap["score"]));
        assert_eq!([0, 1, 2, 3].map(|i| number(&result["bbox"][i])), [x1, y1, x2 - x1, y2 - y1]);
    }

    assert_eq!(fs::read_to_string(path("yolo/classes.txt")).expect("classes"), "A\nB\n");
    assert_eq!(fs::read_to_string(path("yolo/none.txt")).expect("a text"), "");
    let [(_, _, stud)] = &snaps.iter().filter(|(at, ..)| *at == 1).collect::<Vec<_>>()[..] else {
        panic!("one stud: {}", ran.stdout)
    };
    let [x1, y1, x2, y2] = corners(stud).map(|v| v / 1000.0);
    let parts = [(x1 + x2) / 2.0, (y1 + y2) / 2.0, x2 - x1, y2 - y1, number(&stud["score"])];
    let text = fs::read_to_string(path("yolo/one.txt")).expect("a text");
    let got: Vec<f32> = text.split_whitespace().map(|v| v.parse().expect("a number")).collect();
    assert_eq!(got[0], 1.0, "a stud is the second class");
    assert!(got[1..].iter().zip(parts).all(|(a, b)| (a - b).abs() < 2e-6), "{text}, {parts:?}");

    let [x1, y1, x2, y2] = corners(stud);
    let [left, top, right, bottom] =
        [x1.floor(), y1.floor(), x2.ceil(), y2.ceil()].map(|v| v as u32);
    let crop = image::open(path("crops/one.1.png")).expect("a crop").to_rgb8();
    let want =
        image::imageops::crop_imm(&sample("stud.png"), left, top, right - left, bottom - top)
            .to_image();
    assert!(crop == want, "another part of the picture");
    assert_eq!(fs::read_dir(path("crops")).expect("a folder").count(), snaps.len());
    assert_eq!(fs::read_dir(path("drawn")).expect("a folder").count(), 3);
    ran.tells(" ms to read, ");
}

#[test]
fn frames_of_a_stream_are_what_their_pictures_are() {
    let folder = folder();
    let (hooks, stud) = (sample("hooks.png"), sample("stud.png"));
    for (name, picture) in [("a.png", &hooks), ("b.png", &stud)] {
        picture.save(folder.path().join(name)).expect("saved");
    }
    let alone = ran(detect(folder.path(), &["a.png", "b.png", "--json"])).expect(0).json();
    let alone: Vec<_> = alone.iter().map(found).collect();
    assert!(alone.iter().all(|[d, ..]| d.as_array().is_some_and(|d| !d.is_empty())));

    let stream = [stored(&hooks, ImageFormat::Png), stored(&stud, ImageFormat::Bmp)].concat();
    let piped = fed(detect(folder.path(), &["-", "--json", "--save", "drawn"]), &stream).expect(0);
    assert_eq!(piped.json().iter().map(found).collect::<Vec<_>>(), alone);
    assert_eq!(frames(&piped), [("-#0".into(), 0, None), ("-#1".into(), 1, None)]);
    for name in ["drawn/stdin-000000.png", "drawn/stdin-000001.png"] {
        image::open(folder.path().join(name)).expect(name);
    }

    // Blue first, without a header.
    let bare = |picture: &RgbImage| -> Vec<u8> {
        picture.pixels().flat_map(|p| [p.0[2], p.0[1], p.0[0]]).collect()
    };
    let raw = [bare(&hooks), bare(&stud)].concat();
    let arguments = ["-", "--json", "--raw", "1000x1000:bgr8", "--crops", "crops"];
    let piped = fed(detect(folder.path(), &arguments), &raw).expect(0);
    assert_eq!(piped.json().iter().map(found).collect::<Vec<_>>(), alone);
    image::open(folder.path().join("crops/stdin-000001.1.png")).expect("a crop");
}

#[test]
fn each_nth_frame_is_looked_at() {
    let folder = folder();
    let stream = stored(&ramp(40, 40), ImageFormat::Png).repeat(7);
    let piped = fed(detect(folder.path(), &["-", "--json", "--every", "3"]), &stream).expect(0);
    assert_eq!(frames(&piped).iter().map(|f| f.1).collect::<Vec<_>>(), [0, 3, 6]);
    ran(detect(folder.path(), &["-", "--every", "0"])).expect(2).tells("--every");
}

#[test]
fn the_latest_frame_is_looked_at_and_others_are_counted() {
    let folder = folder();
    let stream = stored(&ramp(40, 40), ImageFormat::Bmp).repeat(500);
    let piped = fed(detect(folder.path(), &["-", "--json", "--latest"]), &stream).expect(0);
    let seen = frames(&piped);
    assert_eq!(seen.last().map(|f| f.1), Some(499));
    assert!(seen.is_sorted_by(|a, b| a.1 < b.1), "{seen:?}");
    piped.tells(&format!("; {} frames dropped", 500 - seen.len()));
}

#[test]
fn what_is_no_frame_is_named_and_the_others_go_through() {
    let folder = folder();
    let png = stored(&ramp(40, 40), ImageFormat::Png);
    let half = &png[..png.len() / 2];
    for (stream, told, indices) in [
        (
            [&png, half].concat(),
            vec!["-#1: expected a whole PNG, got one that ends early"],
            vec![0],
        ),
        (
            [&png, &b"garbage"[..], &png].concat(),
            vec!["-#1: expected a PNG, JPEG, BMP or TIFF picture, got 7 bytes of something else"],
            vec![0, 1],
        ),
        (vec![], vec!["-#0: expected a PNG, JPEG, BMP or TIFF picture, got an empty one"], vec![]),
    ] {
        let piped = fed(detect(folder.path(), &["-", "--json", "--quiet"]), &stream).expect(1);
        let seen: Vec<u64> = frames(&piped).iter().map(|f| f.1).collect();
        assert_eq!(seen, indices, "{told:?}");
        let lines: Vec<&str> = piped.stderr.lines().filter(|line| line.contains("-#")).collect();
        assert_eq!(lines, told.iter().map(|t| format!("smr-gpu: {t}")).collect::<Vec<_>>());
    }
    let raw = |arguments: &[&str], bytes: usize| {
        let all = [&["-", "--json", "--raw"], arguments].concat();
        fed(detect(folder.path(), &all), &vec![7; bytes])
    };
    let short = raw(&["10x10:rgb8"], 450).expect(1);
    assert_eq!(short.json().len(), 1);
    short.tells("smr-gpu: -#1: expected 300 bytes of a raw frame, got 150");
    raw(&["10x10:rgb8"], 0).expect(1).tells("-#0: expected 300 bytes of a raw frame, got 0");
    raw(&["99999x99999:rgb8"], 0)
        .expect(2)
        .tells("expected 1 to 33554432 pixels, got 99999 × 99999");
    raw(&["10x10:mjpeg"], 0).expect(2).tells("expected one of `rgb8`");
    ran(detect(folder.path(), &["x.png", "--raw", "10x10:rgb8"]))
        .expect(2)
        .tells("--raw: expected `-`");
}

#[test]
fn videos_come_through_ffmpeg_with_their_times() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("frame.bmp"), stored(&ramp(40, 40), ImageFormat::Bmp)).expect("written");
    fs::write(path("clip.mp4"), "what ffmpeg reads").expect("written");
    let tell = |number: u32, time: &str| {
        format!(
            "echo '[Parsed_showinfo_0 @ 0x1] [info] n:   {number} pts: 1 pts_time:{time} pos: 9' >&2; cat frame.bmp"
        )
    };
    let two = [tell(0, "0.5"), tell(1, "0.75")].join("\n");
    fake_ffmpeg(folder.path(), &two);
    let arguments = ["clip.mp4", "--json", "--csv", "t.csv"];
    let seen = ran(detect(folder.path(), &arguments)).expect(0);
    let want = [("clip.mp4#0".into(), 0, Some(0.5)), ("clip.mp4#1".into(), 1, Some(0.75))];
    assert_eq!(frames(&seen), want);
    let seen = seen.tells("smr-gpu: clip.mp4: ffmpeg -nostdin -i file:clip.mp4 -map 0:v:0 ");
    assert!(seen.stdout.contains(r#""file":"clip.mp4""#), "{}", seen.stdout);

    // It dies in the middle; the password of a camera is nobody's business.
    fake_ffmpeg(
        folder.path(),
        &format!("{two}\necho '[error] rtsp://me:secret@cam/1: Connection reset' >&2\nexit 3"),
    );
    let seen = ran(detect(folder.path(), &["rtsp://me:secret@cam/1", "--json"])).expect(1);
    assert_eq!(seen.json().len(), 2);
    let seen = seen.tells(
        "smr-gpu: rtsp://…@cam/1#2: expected a frame or the end, got none: ffmpeg ended with exit status: 3, and \
         said: rtsp://…@cam/1: Connection reset",
    );
    assert!(!seen.stderr.contains("secret"), "{}", seen.stderr);

    fake_ffmpeg(folder.path(), "exit 0");
    let seen = ran(detect(folder.path(), &["clip.mp4", "-q"])).expect(1);
    assert_eq!(seen.stderr, "smr-gpu: clip.mp4: expected frames, got none\n");
    fs::remove_file(path("bin/ffmpeg")).expect("removed");
    let mut none = detect(folder.path(), &["clip.mp4", "/dev/video7"]);
    none.env("PATH", path("bin"));
    let seen = ran(none)
        .expect(1)
        .tells("smr-gpu: clip.mp4: ffmpeg is not installed: `apt install ffmpeg`");
    seen.tells("/dev/video7: ffmpeg is not installed");
    ran(detect(folder.path(), &["gone.mp4"])).expect(1).tells("gone.mp4: No such file");
}

#[test]
fn a_video_is_written_whole_or_not_at_all() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    for (name, side) in [("a.png", 40), ("b.png", 40), ("c.png", 20)] {
        ramp(side, side).save(path(name)).expect("saved");
    }
    // The last word is the file.
    fake_ffmpeg(folder.path(), "echo \"$@\" > asked; for to; do :; done; cat > \"${to#file:}\"");
    let arguments =
        ["a.png", "b.png", "c.png", "--video", "v.mkv", "--fps", "10", "--save", "drawn"];
    let seen = ran(detect(folder.path(), &arguments)).expect(1);
    seen.tells("c.png: left out of v.mkv: expected 40 × 40 pixels, got 20 × 20");
    let drawn =
        ["drawn/a.png", "drawn/b.png"].map(|name| image::open(path(name)).expect(name).to_rgb8());
    let want = drawn.map(RgbImage::into_raw).concat();
    assert!(fs::read(path("v.mkv")).expect("the video") == want, "other frames");
    let asked = fs::read_to_string(path("asked")).expect("the arguments");
    assert!(asked.contains("-video_size 40x40 -framerate 10 -i - "), "{asked}");

    fake_ffmpeg(folder.path(), "echo '[error] no such encoder' >&2; exit 1");
    fs::write(path("v.mkv"), "an earlier video").expect("written");
    let seen =
        ran(detect(folder.path(), &["a.png", "b.png", "--video", "v.mkv", "--json"])).expect(6);
    assert_eq!(seen.json().len(), 2);
    seen.tells("v.mkv: ffmpeg ended with exit status: 1, and said: no such encoder");
    assert_eq!(fs::read(path("v.mkv")).expect("kept"), b"an earlier video");
    ran(detect(folder.path(), &["a.png", "--video", "v.gif"])).expect(2).tells("ends in .mp4");
}

#[test]
fn ctrl_c_keeps_what_was_found() {
    let folder = folder();
    let png = stored(&sample("stud.png"), ImageFormat::Png);
    let mut command = detect(folder.path(), &["-", "--json", "--coco", "c.json", "--csv", "t.csv"]);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut running = command.spawn().expect("the program runs");
    let mut stdin = running.stdin.take().expect("a pipe");
    stdin.write_all(&png).expect("written");
    // The stream stays open; the first frame's line says that it was looked at.
    let mut stdout = BufReader::new(running.stdout.take().expect("a pipe"));
    let mut line = String::new();
    stdout.read_line(&mut line).expect("a line");
    stdin.write_all(&png).expect("written");
    let mut second = String::new();
    stdout.read_line(&mut second).expect("a line");
    assert!(
        Command::new("kill")
            .args(["-INT", &running.id().to_string()])
            .status()
            .expect("kill")
            .success()
    );
    assert_eq!(running.wait().expect("ended").code(), Some(130));
    let mut rest = String::new();
    stdout.read_to_string(&mut rest).expect("UTF-8");
    assert_eq!(rest, "");
    let snaps = |line: &str| -> usize {
        let record: Value = serde_json::from_str(line).expect("JSON");
        record["detections"].as_array().expect("a list").len()
    };
    let all = snaps(&line) + snaps(&second);
    assert!(all >= 2, "{line}");
    let coco: Vec<Value> =
        serde_json::from_slice(&fs::read(folder.path().join("c.json")).expect("results"))
            .expect("JSON");
    let rows = fs::read_to_string(folder.path().join("t.csv")).expect("the table").lines().count();
    assert_eq!((coco.len(), rows), (all, all + 1));
}

#[test]
fn outputs_that_cannot_be_written_are_told_before_the_work() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    ramp(40, 40).save(path("a.png")).expect("saved");
    fs::write(path("file"), "mine").expect("written");
    for (arguments, code, phrase) in [
        (["--csv", "a.png"], 2, "a.png: expected a file that is no input"),
        (["--coco", "."], 6, "got a folder"),
        (["--yolo", "file"], 6, "file: expected a folder, got a file"),
        (["--crops", "file/x"], 6, "file/x: cannot write"),
        (["--csv", "none/t.csv"], 6, "none/t.csv: cannot write"),
    ] {
        let ran = ran(detect(folder.path(), &[&["a.png"][..], &arguments].concat())).expect(code);
        assert_eq!(ran.tells(phrase).stdout, "", "{arguments:?}");
    }
    ran(detect(folder.path(), &["a.png", "--csv", "t", "--coco", "./t"]))
        .expect(2)
        .tells("other output");
    assert_eq!(fs::read(path("file")).expect("kept"), b"mine");

    // A reader of stdout that has gone ends the run, and the table is whole.
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let mut command = detect(folder.path(), &["a.png", "a.png", "--json", "--csv", "t.csv"]);
    Ran::from(command.stdout(writer).output().expect("the program runs")).expect(141);
    assert_eq!(fs::read_to_string(path("t.csv")).expect("the table").lines().count(), 1);
}
