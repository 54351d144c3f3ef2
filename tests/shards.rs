//! Runs that do a list together: what they leave is what one run leaves.
#![cfg(unix)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use serde_json::Value;

#[path = "support/program.rs"]
mod program;
use program::{Ran, command, folder, ramp, run};

const SAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/samples");
const SHARDS: [&str; 3] = ["1/3", "2/3", "3/3"];

/// The files of a folder by their names in it, but for the lock, which has the number of a run.
fn names(folder: &Path) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if !path.ends_with(".simulate.lock") {
                found.insert(path.strip_prefix(folder).expect("below").to_owned());
            }
        }
    }
    found
}

/// The same with their bytes, of a folder that nobody writes to.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let read = |name: PathBuf| (name.clone(), fs::read(folder.join(name)).expect("a file"));
    names(folder).into_iter().map(read).collect()
}

#[track_caller]
fn assert_same(one: &Path, other: &Path) {
    let (one, other) = (contents(one), contents(other));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(*bytes == other[name], "{} differs", name.display());
    }
}

/// Eight pictures, of which some hold snaps, two have one name, and one's name is hard on tables.
fn pictures(folder: &Path) {
    fs::create_dir_all(folder.join("in/deep")).expect("created");
    for (from, to) in [
        ("faint_stud", "a"),
        ("hooks", "one, \"two\"\nthree"),
        ("lettering", "c"),
        ("mixed", "same"),
        ("stud", "y"),
        ("hooks", "deep/same"),
        ("mixed", "deep/z"),
    ] {
        let to = folder.join(format!("in/{to}.png"));
        fs::copy(Path::new(SAMPLES).join(format!("{from}.png")), to).expect("copied");
    }
    ramp(64, 64).save(folder.join("in/none.png")).expect("saved");
}

/// The arguments of a run that writes into `out`, its lists under a name of their own.
fn arguments(out: &str, list: &str) -> Vec<String> {
    let mut line = "detect in --recursive --json --weights small --device cpu".to_owned();
    for kind in ["save", "crops", "yolo"] {
        line += &format!(" --{kind} {out}/{kind}");
    }
    line += &format!(" --csv {list}.csv --coco {list}.coco");
    line.split(' ').map(str::to_owned).collect()
}

fn detect(folder: &Path, arguments: &[String]) -> Ran {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    run(folder, &arguments).expect(0)
}

/// Records without the times, which no two runs share.
fn timeless(lines: &str) -> Vec<Value> {
    let parse = |line| {
        let mut record: Value = serde_json::from_str(line).expect("JSON");
        assert!(record["timings_ms"].take().is_object());
        record
    };
    lines.lines().map(parse).collect()
}

#[test]
fn shards_find_what_one_run_finds() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    pictures(folder.path());
    let whole = detect(folder.path(), &arguments("whole", "whole"));
    assert_eq!(whole.stdout.lines().count(), 8);

    // One of three is killed at its work, and runs again.
    for (number, shard) in (1..).zip(SHARDS) {
        let list = format!("list{number}");
        let mut arguments = arguments("parts", &list);
        arguments.extend(["--shard", shard].map(str::to_owned));
        if number == 2 {
            let mut shard = command(folder.path());
            shard.args(&arguments).stdout(Stdio::piped()).stderr(Stdio::null());
            let mut running = shard.spawn().expect("it runs");
            let mut line = String::new();
            let stdout = running.stdout.take().expect("a pipe");
            BufReader::new(stdout).read_line(&mut line).expect("a record");
            running.kill().expect("killed");
            running.wait().expect("ended");
        }
        let ran = detect(folder.path(), &arguments);
        let want = [3, 3, 2][number - 1];
        assert_eq!(ran.stdout.lines().count(), want, "{shard}");
        fs::write(path(&format!("{list}.json")), ran.stdout).expect("written");
    }
    // What the killed run had not finished stays beside what is whole.
    for name in names(&path("parts")) {
        if name.extension().is_some_and(|ending| ending == "unfinished") {
            fs::remove_file(path("parts").join(name)).expect("removed");
        }
    }
    assert_same(&path("whole"), &path("parts"));
    for kind in ["csv", "coco"] {
        let lists = [3, 1, 2].map(|number| format!("list{number}.{kind}"));
        let merged = run(folder.path(), &["merge", &lists[0], &lists[1], &lists[2]]).expect(0);
        let whole = fs::read_to_string(path(&format!("whole.{kind}"))).expect("a list");
        assert!(whole.lines().count() > 8, "{whole}");
        assert_eq!(merged.stdout, whole);
    }
    let merged = run(folder.path(), &["merge", "list1.json", "list2.json", "list3.json"]).expect(0);
    assert_eq!(timeless(&merged.stdout), timeless(&whole.stdout));
    let own = fs::read_to_string(path("list1.json")).expect("records");
    let lines: Vec<&str> = merged.stdout.lines().step_by(3).collect();
    assert_eq!(lines, own.lines().collect::<Vec<_>>());
}

#[test]
fn each_nth_picture_is_shared_too() {
    let folder = folder();
    pictures(folder.path());
    let indices = |shard| {
        let more = "--every 2 --size 32 --shard";
        let more = more.split(' ').chain([shard]).map(str::to_owned);
        let ran = detect(
            folder.path(),
            &arguments("out", "list").into_iter().chain(more).collect::<Vec<_>>(),
        );
        ran.json().iter().map(|r| r["index"].as_u64().expect("an index")).collect::<Vec<_>>()
    };
    assert_eq!(SHARDS.map(indices), [vec![0, 6], vec![2], vec![4]]);
}

#[test]
fn what_cannot_be_shared_is_refused() {
    let folder = folder();
    let refuses = |line: &str, phrase: &str| {
        run(folder.path(), &line.split(' ').collect::<Vec<_>>()).expect(2).tells(phrase);
    };
    for shard in ["0/2", "3/2", "2"] {
        let phrase = format!("expected i/n with 1 ≤ i ≤ n, got {shard}");
        refuses(&format!("detect x.png --shard {shard}"), &phrase);
        refuses(&format!("simulate --out o --count 1 --seed 1 --shard {shard}"), &phrase);
    }
    refuses("detect x.png --shard 1/2 --latest", "'--latest'");
    let expected = "--shard: expected picture files, or one video, got";
    for (sources, got) in
        [("-", "-"), ("x.png rtsp://me:x@h/1", "rtsp://…@h/1"), ("a.mp4 b.mp4", "a.mp4")]
    {
        refuses(&format!("detect {sources} --shard 1/2"), &format!("{expected} {got}"));
    }
}

#[test]
fn lists_that_are_no_shards_are_not_merged() {
    let folder = folder();
    let head = "frame,index,time_s,class,score,x1,y1,x2,y2,x_mm,y_mm,yaw_deg,whole";
    let rows = format!("{head}\na,0,,A\nb,2,,B\n");
    for (name, text) in [
        ("a.csv", &rows[..]),
        ("b.csv", &rows),
        ("c.json", "{\"index\":1}\n"),
        ("d.csv", "frame,score\nx,1\n"),
        ("e.json", "{\"index\":1}\n{\"ind"),
        ("none.json", ""),
        ("none.coco", "[\n]\n"),
    ] {
        fs::write(folder.path().join(name), text).expect("written");
    }
    for (files, phrase) in [
        (
            &["a.csv", "b.csv"][..],
            "b.csv: expected frames of another shard than a.csv's, got frame 0",
        ),
        (&["a.csv", "c.json"], "c.json: expected Csv as a.csv, got Json"),
        (&["d.csv"], "d.csv: expected the columns frame,index,time_s,"),
        (&["e.json"], "e.json: expected what `detect` writes"),
        (&["gone"], "gone: "),
    ] {
        let ran = run(folder.path(), &[&["merge"], files].concat()).expect(1).tells(phrase);
        assert_eq!(ran.stdout, "");
    }
    // Frames without a snap are in no table; a table may have all of one frame's rows.
    for (files, want) in [
        (&["a.csv"][..], &rows[..]),
        (&["none.json", "c.json"], "{\"index\":1}\n"),
        (&["none.json"], ""),
        (&["none.coco"], "[\n]\n"),
    ] {
        let ran = run(folder.path(), &[&["merge"], files].concat()).expect(0);
        assert_eq!(ran.stdout, want);
    }
}

/// Draws a data set of seven pictures, or a shard of it.
fn simulate(out: &Path, shard: Option<&str>) -> std::process::Command {
    let mut command = command(out);
    let line = "simulate --out . --count 7 --seed 5 --kind mixed";
    command.args(line.split(' ')).args(shard.iter().flat_map(|shard| ["--shard", shard]));
    command.stderr(Stdio::piped());
    command
}

#[test]
fn shards_draw_what_one_run_draws() {
    let [whole, together, one, two] = [(); 4].map(|()| folder());
    let ran = |out: &Path, shard| Ran::from(simulate(out, shard).output().expect("it runs"));
    ran(whole.path(), None).expect(0).tells("7 pictures (7 new)");

    // Into one folder at a time, and one of them is killed as soon as a picture is whole.
    let [mut first, mut second, third] =
        SHARDS.map(|shard| simulate(together.path(), Some(shard)).spawn().expect("it runs"));
    while !names(together.path()).iter().any(|name| name.starts_with("labels"))
        && second.try_wait().expect("a child").is_none()
    {
        std::thread::yield_now();
    }
    second.kill().expect("killed");
    second.wait().expect("ended");
    assert!(first.wait().expect("ended").success());
    Ran::from(third.wait_with_output().expect("ended")).expect(0).tells("2 pictures (2 new)");
    ran(together.path(), Some("2/3")).expect(0).tells("2 pictures (");
    assert!(!together.path().join("annotations.json").exists());
    // The folder is not for one run alone as long as a shard writes there.
    let lock = File::open(together.path().join(".simulate.lock")).expect("the lock");
    lock.lock_shared().expect("shared");
    ran(together.path(), None).expect(6).tells("got one that another process writes to");
    ran(together.path(), Some("1/3")).expect(0).tells("3 pictures (0 new)");
    drop(lock);
    ran(together.path(), None).expect(0).tells("7 pictures (0 new)");
    assert_same(whole.path(), together.path());

    // Into folders that are put together; what no shard drew is drawn then.
    ran(one.path(), Some("1/3")).expect(0);
    ran(two.path(), Some("3/3")).expect(0);
    for (name, bytes) in contents(two.path()) {
        fs::write(one.path().join(name), bytes).expect("written");
    }
    ran(one.path(), None).expect(0).tells("7 pictures (2 new)");
    assert_same(whole.path(), one.path());
}
