//! `smr-gpu teach` from outside, with a stand-in for the training package: what is asked of it, what comes of its
//! failures, and that a stopped run goes on. The package itself is tested by weights/training/run.sh.
#![cfg(unix)]

use std::fs;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use tempfile::TempDir;

#[path = "support/program.rs"]
mod program;
use program::Ran;

/// A Python of a few lines: it learns nothing, and gives back the network that it is to begin with. What it is
/// called with stands in `calls`; a file `fail` holds the exit status of `fit`, and what it says; while there is a
/// file `wait` fit does not end.
const STAND_IN: &str = r#"#!/bin/sh
here=$(dirname "$0")
if [ "$1" = -c ]; then
    [ -e "$here/lacks" ] && { cat "$here/lacks" >&2; exit 1; }
    echo VERSION
    exit 0
fi
shift 2
echo "$*" >> "$here/calls"
command=$1
shift
estimate=
while [ $# -gt 0 ]; do
    case $1 in
    --out) out=$2 ;;
    --init) init=$2 ;;
    --weights) weights=$2 ;;
    --estimate) estimate=1 ;;
    --resume) init=$out/init ;;
    esac
    shift
done
if [ -n "$estimate" ]; then
    echo "some words"
    echo '{"pictures": 5, "without_snap": 1, "snaps": {"A": 3, "B": 4}, "directed": ["A"], "device": "cpu", "threads": 2, "seconds_per_step": 30.0, "steps": 4}'
    exit 0
fi
if [ "$command" = calibrate ]; then
    cp "$weights" "$out"
    exit 0
fi
mkdir -p "$out"
echo '{}' > "$out/run.json"
[ -e "$out/init" ] || cp "$init" "$out/init"
if [ -e "$here/fail" ]; then
    tail -n +2 "$here/fail" >&2
    exit "$(head -n 1 "$here/fail")"
fi
echo waiting > "$out/waiting"
while [ -e "$here/wait" ]; do sleep 0.05; done
printf '%s\n' '{"step": 2, "steps": 4, "seconds_left": 3, "loss": 1.5}' '{"step": 4, "steps": 4, "seconds_left": 0, "loss": 0.5}' '{"step": 4, "val": {"calibration/plain": {"all": {"iou": 0.9}}}}' > "$out/history.jsonl"
cp "$out/init" "$out/weights.safetensors"
"#;

/// A user with a folder, and a Python in it.
struct User(TempDir);

impl User {
    fn new() -> Self {
        let folder = program::folder();
        let script = STAND_IN.replace("VERSION", env!("CARGO_PKG_VERSION"));
        // By a process of its own: nobody can run what a child of another test may hold open to write.
        fs::write(folder.path().join("text"), script).expect("written");
        let install = ["-m", "755", "text", "python"];
        let status = Command::new("install").args(install).current_dir(folder.path()).status();
        assert!(status.expect("install").success());
        Self(folder)
    }

    fn at(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.at(name), text).expect("written");
    }

    fn calls(&self) -> Vec<String> {
        let text = fs::read_to_string(self.at("calls")).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    }

    fn command(&self, more: &[&str]) -> Command {
        let mut command = program::command(self.0.path());
        command.args(["teach", "--pictures", "5", "--test", "2", "--steps", "4"]).args(more);
        for (option, value) in [("--python", "./python"), ("--out", "new.safetensors")] {
            if !more.contains(&option) {
                command.args([option, value]);
            }
        }
        command
    }

    fn teach(&self, more: &[&str]) -> Ran {
        self.command(more).output().expect("the program").into()
    }
}

fn small() -> Vec<u8> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/smrnet-s.safetensors");
    fs::read(file).expect("the small network")
}

#[test]
fn what_is_taught_is_written_with_a_report() {
    let user = User::new();
    let ran = user.teach(&["A", "B"]).expect(0);
    assert!(ran.stderr.contains("5 simulated pictures of A, B"), "{}", ran.stderr);
    assert!(ran.stderr.contains(" of them without a snap; "), "{}", ran.stderr);
    assert!(ran.stderr.contains("4 steps of training take about 2 minutes (cpu, 2 threads)"));
    assert!(ran.stdout.contains("new.safetensors: done"), "{}", ran.stdout);
    // The stand-in gives back what it began with, the small network.
    assert!(fs::read(user.at("new.safetensors")).expect("weights") == small());
    let report = fs::read_to_string(user.at("new.teach/report.md")).expect("a report");
    for line in ["| plain, 2 | A |", "| wide, 2 | B |", "## Learning", "![The best](hits.png)"] {
        assert!(report.contains(line), "no `{line}` in {report}");
    }
    for name in ["precision", "reliability", "learning", "hits", "parts"] {
        let picture = image::open(user.at(&format!("new.teach/{name}.png")));
        assert!(picture.expect(name).width() >= 400, "{name}");
    }
    let calls = user.calls();
    let [estimate, fit, calibrate] = &calls[..] else { panic!("{calls:?}") };
    assert!(estimate.ends_with("--estimate"), "{estimate}");
    let folders =
        ["plain", "wide", "strong", "plain-other", "wide-other", "plain-alike", "wide-alike"];
    let data = folders.map(|name| format!("new.teach/train/{name}")).join(" ");
    let val = "new.teach/calibration/plain new.teach/calibration/wide";
    assert!(fit.starts_with(&format!("fit --data {data} --val {val} --init ")), "{fit}");
    assert!(fit.contains("--steps 4 --seed 1 "), "{fit}");
    assert!(calibrate.ends_with(&format!("--data {val}")), "{calibrate}");

    // Again: all is there, and nothing is learnt twice.
    user.teach(&["A", "B"]).expect(0);
    assert_eq!(user.calls().len(), 4, "calibrated again alone");
    // Something else in the same folder is refused, by name.
    user.teach(&["A", "B", "--seed", "2"]).expect(2).tells("begun with seed 1, got 2");
    user.teach(&["B"]).expect(2).tells("begun with parts");
}

#[test]
fn what_would_be_is_said_and_nothing_done() {
    let user = User::new();
    let ran = user.teach(&["A", "--estimate"]).expect(0);
    assert!(ran.stderr.contains("all together about"), "{}", ran.stderr);
    assert_eq!(user.calls().len(), 1);
    assert!(!user.at("new.safetensors").exists());
    let left = fs::read_dir(user.at("new.teach")).expect("a folder");
    let mut left: Vec<_> = left.map(|entry| entry.expect("a file").file_name()).collect();
    left.sort();
    assert_eq!(left, [".teach.lock", "parts.png", "training.log"]);
    // Nothing was begun: another part may be meant.
    user.teach(&["B", "--estimate"]).expect(0);
}

#[test]
fn what_cannot_be_is_said() {
    let user = User::new();
    user.teach(&[]).expect(2).tells("expected parts, --data or both");
    user.teach(&["a=gone.stl"]).expect(1).tells("gone.stl");
    user.teach(&["A", "A"]).expect(2).tells("got `A` twice");
    user.teach(&["A", "--data-share", "1"]).expect(2).tells("less than 1");
    user.teach(&["A", "--sensor", "plain"]).expect(2).tells("states a `frame`");
    user.teach(&["A", "--out", "python/new.safetensors"]).expect(6).tells("python/new");
    // A Python that is none, and one without torch.
    user.teach(&["A", "--python", "./no"]).expect(2).tells("--python ./no: cannot be run");
    user.write("lacks", "Traceback\nModuleNotFoundError: No module named 'torch'\n");
    let ran = user.teach(&["A"]).expect(2).tells("No module named 'torch'");
    assert!(ran.stderr.contains("-m pip install ./weights/training"), "{}", ran.stderr);
    assert!(!user.at("new.teach/train").exists(), "nothing is simulated for nobody");
}

#[test]
fn a_run_that_failed_goes_on() {
    let user = User::new();
    user.write(
        "fail",
        "6\nsmr-gpu-train: run/checkpoint.pt: cannot be written: No space left on device\n",
    );
    let ran = user.teach(&["A"]).expect(6);
    let said = "training: run/checkpoint.pt: cannot be written: No space left on device";
    assert!(ran.stderr.contains(said), "{}", ran.stderr);
    assert!(!user.at("new.safetensors").exists());
    fs::remove_file(user.at("fail")).expect("removed");
    user.teach(&["A"]).expect(0);
    assert!(user.calls()[2].starts_with("fit --resume --out new.teach/run"), "{:?}", user.calls());
    assert!(fs::read(user.at("new.safetensors")).expect("weights") == small());
}

#[test]
fn ctrl_c_ends_the_training_in_order() {
    // As in a terminal Ctrl-C goes to the whole group; a service's end goes to the program alone.
    for [signal, to] in [["-INT", "-"], ["-TERM", ""]] {
        ends_the_training_in_order(signal, to);
    }
}

fn ends_the_training_in_order(signal: &str, to: &str) {
    let user = User::new();
    user.write("wait", "");
    let mut command = user.command(&["A"]);
    let mut running = command.process_group(0).spawn().expect("the program");
    while !user.at("new.teach/run/waiting").exists() {
        assert!(running.try_wait().expect("a status").is_none(), "it ended without training");
        std::thread::sleep(Duration::from_millis(20));
    }
    let to = format!("{to}{}", running.id());
    assert!(Command::new("kill").args([signal, "--", &to]).status().expect("kill").success());
    assert_eq!(running.wait().expect("ended").code(), Some(130));
    assert!(!user.at("new.safetensors").exists());
    fs::remove_file(user.at("wait")).expect("removed");
    // Its child is gone too, and learns nothing any more.
    std::thread::sleep(Duration::from_millis(300));
    assert!(!user.at("new.teach/run/weights.safetensors").exists());
    user.teach(&["A"]).expect(0);
    assert!(user.at("new.safetensors").exists());
}
