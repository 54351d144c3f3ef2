//! Weights are found by name, listed, and stored whole or not at all.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;
use smr_gpu::smr::catalog::{PUBLISHED, file_name};
use tempfile::TempDir;

#[path = "support/program.rs"]
mod program;
use program::{Ran, folder, ramp};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Small and on the CPU, for speed.
const QUICK: [&str; 4] = ["--size", "32", "--device", "cpu"];

fn small() -> PathBuf {
    Path::new(ROOT).join("weights/smrnet-s.safetensors")
}

/// A user who has the program alone, far from any checkout.
struct User {
    home: TempDir,
}

impl User {
    fn new() -> Self {
        let home = folder();
        for path in ["a/b/bin", "here"] {
            fs::create_dir_all(home.path().join(path)).expect("created");
        }
        // By a process of its own: a program that this one has open to write cannot be run, nor while a child
        // of another test holds it so.
        let mut copy = Command::new("cp");
        copy.arg(env!("CARGO_BIN_EXE_smr-gpu")).arg(home.path().join("a/b/bin/smr-gpu"));
        assert!(copy.status().expect("cp").success());
        ramp(64, 64).save(home.path().join("here/x.png")).expect("saved");
        Self { home }
    }

    fn at(&self, path: &str) -> PathBuf {
        self.home.path().join(path)
    }

    /// The folder in which `weights add` stores.
    fn data(&self) -> PathBuf {
        self.at(match cfg!(target_os = "macos") {
            true => "Library/Application Support/smr-gpu/weights",
            false => ".local/share/smr-gpu/weights",
        })
    }

    /// What is in it.
    fn stored(&self) -> Vec<String> {
        let entries = fs::read_dir(self.data()).into_iter().flatten();
        entries
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
            .collect()
    }

    /// The program, with nothing in the environment but a home.
    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(self.at("a/b/bin/smr-gpu"));
        command.args(arguments).current_dir(self.at("here")).stdin(Stdio::null());
        command.env_clear().env("HOME", self.home.path());
        command
    }

    fn run(&self, arguments: &[&str]) -> Ran {
        ran(&mut self.command(arguments))
    }
}

fn ran(command: &mut Command) -> Ran {
    command.output().expect("the program runs").into()
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// What a file holds, altered in its last byte: it loads, and is another.
fn altered(file: &Path) -> Vec<u8> {
    let mut bytes = fs::read(file).expect("weights");
    // The low byte of an f16, which stays finite.
    let at = bytes.len() - 2;
    bytes[at] ^= 1;
    bytes
}

#[test]
fn a_lone_program_runs_the_small_network_and_says_so() {
    let user = User::new();
    let picture = Path::new(ROOT).join("samples/mixed.png");
    let detect = [&["detect", text(&picture), "--json"], &QUICK[2..]].concat();
    let lone = user.run(&detect).expect(0);
    let remarks: Vec<_> = lone.told().into_iter().filter(|l| l.contains("network")).collect();
    let expected = "smr-gpu: no weights of the large network were found: small (in the program) runs; \
                    `smr-gpu weights add FILE` adds the large one";
    assert_eq!(remarks, [expected]);
    let named = user.run(&[&detect[..], &["--weights", "small"]].concat()).expect(0);
    assert!(!named.stderr.contains("network"), "{}", named.stderr);
    let file = user.run(&[&detect[..], &["--weights", text(&small())]].concat()).expect(0);
    let found = |ran: &Ran| ran.json()[0]["detections"].clone();
    assert_eq!(found(&lone).as_array().map(Vec::len), Some(3));
    assert_eq!(found(&lone), found(&file));
    assert_eq!(found(&named), found(&file));

    let listed = user.run(&["weights", "--json"]).expect(0).json();
    let [record] = &listed[..] else { panic!("{listed:?}") };
    assert_eq!(record["name"], "small");
    assert_eq!(record["file"], Value::Null);
    assert_eq!(record["sha256"], PUBLISHED[1].sha256);
    assert!(user.run(&["weights"]).expect(0).stdout.contains("(in the program)"));
}

/// Not even with a home. What was asked for by name is not replaced by something else.
#[test]
fn missing_weights_are_named_with_every_place() {
    let user = User::new();
    for (weights, file) in [("large", PUBLISHED[0].file), ("no-such", "no-such.safetensors")] {
        let arguments = ["detect", "x.png", "--weights", weights];
        let missing = user.run(&arguments).expect(3);
        let beside = ["a/b/bin", "a/b", "a"].map(|f| user.at(f).join("weights").join(file));
        let share = user.at("a/b/share/smr-gpu/weights").join(file);
        let last = [share, Path::new("weights").join(file)];
        let places = [&[user.data().join(file)], &beside[..], &last].concat();
        let places: Vec<_> = places.iter().map(|p| text(p).to_owned()).collect();
        missing.tells(&format!(
            "weights: expected `{weights}` in one of {}; got none; `smr-gpu weights add FILE --name \
             {weights}` adds it\n",
            places.join(", ")
        ));
        let bare = ran(user.command(&arguments).env_clear());
        if weights == "no-such" {
            bare.expect(3).tells(&places[1]).tells(&places[5]);
        }
        // The variable asks, too.
        let variable = ran(user.command(&arguments[..2]).env("SMR_GPU_WEIGHTS", weights));
        variable.expect(3).tells(&places[0]);
    }
    let gone = user.run(&["detect", "x.png", "--weights", "gone.safetensors"]).expect(3);
    gone.tells("weights gone.safetensors: No such file");
    let gone = ran(user.command(&["detect", "x.png"]).env("SMR_GPU_WEIGHTS", "gone.safetensors"));
    gone.expect(3).tells("weights gone.safetensors: No such file");
    ran(user.command(&["detect", "x.png"]).args(QUICK).env("SMR_GPU_WEIGHTS", "")).expect(0);
}

#[test]
fn the_nearest_weights_are_found() {
    let user = User::new();
    fs::create_dir(user.at("set")).expect("created");
    let places = [
        PathBuf::from("weights"),
        user.at("a/weights"),
        user.at("a/b/bin/weights"),
        user.data(),
        user.at("set"),
    ];
    let variable = user.at("set");
    for place in places {
        let folder = user.at("here").join(&place);
        fs::create_dir_all(&folder).expect("created");
        for name in ["large", "small", "mine"] {
            symlink(small(), folder.join(file_name(name))).expect("linked");
        }
        let mut listing = user.command(&["weights", "--json"]);
        let listed = ran(listing.env("SMR_GPU_WEIGHTS", &variable)).expect(0).json();
        let found: Vec<_> = listed.iter().map(|r| [&r["name"], &r["file"]]).collect();
        let file = |name| Value::from(text(&place.join(file_name(name))));
        let expected = ["large", "mine", "small"].map(|name| [Value::from(name), file(name)]);
        assert_eq!(found, expected.each_ref().map(|row| row.each_ref()));
    }
    // Damaged ones are named, and nothing further off serves instead.
    fs::write(user.data().join("damaged.safetensors"), "junk").expect("written");
    let listed = user.run(&["weights"]).expect(3).tells("damaged.safetensors: not a whole");
    assert_eq!(listed.stdout.lines().count(), 3);
    fs::remove_file(user.data().join("smrnet.safetensors")).expect("removed");
    fs::write(user.data().join("smrnet.safetensors"), "junk").expect("written");
    user.run(&["detect", "x.png"])
        .expect(3)
        .tells("share/smr-gpu/weights/smrnet.safetensors: not a");
}

/// Whoever changes the networks changes what the program knows of them.
#[test]
fn published_digests_are_those_of_the_files() {
    let user = User::new();
    let mut command = user.command(&["weights", "--json"]);
    command.env("SMR_GPU_WEIGHTS", Path::new(ROOT).join("weights"));
    let listed = ran(&mut command).expect(0).json();
    assert_eq!(listed.len(), PUBLISHED.len());
    for (record, network) in listed.iter().zip(PUBLISHED) {
        let file = Path::new(ROOT).join("weights").join(network.file);
        assert_eq!(record["name"], network.name);
        assert_eq!(record["file"], text(&file));
        assert_eq!(record["sha256"], network.sha256);
        assert_eq!(record["bytes"], fs::metadata(&file).expect("weights").len());
        assert_eq!(record["classes"], serde_json::json!(["A", "B"]));
    }
}

#[test]
fn added_weights_are_found_by_every_command() {
    let user = User::new();
    let added = user.run(&["weights", "add", text(&small()), "--name", "mine"]).expect(0);
    let path = user.data().join("mine.safetensors");
    assert!(added.stdout.starts_with("mine ") && added.stdout.contains(text(&path)));
    assert_eq!(fs::read(&path).expect("stored"), fs::read(small()).expect("weights"));
    assert_eq!(user.stored(), ["mine.safetensors"]);
    user.run(&[&["detect", "x.png", "--weights", "mine"], &QUICK[..]].concat()).expect(0);

    // Once more is no harm; other weights do not take the name.
    user.run(&["weights", "add", text(&path)]).expect(0);
    let other = user.at("here/other.safetensors");
    fs::write(&other, altered(&small())).expect("written");
    let refused = user.run(&["weights", "add", "other.safetensors", "--name", "mine"]).expect(6);
    refused.tells(text(&path)).tells("remove them, or give another --name");
    assert_eq!(fs::read(&path).expect("stored"), fs::read(small()).expect("weights"));

    // What the program knows has its name, whatever the file is called; what it does not, the file's.
    fs::copy(small(), user.at("here/net (1).bin")).expect("copied");
    user.run(&["weights", "add", "net (1).bin"]).expect(0);
    let digest = user.run(&["weights", "add", "other.safetensors"]).expect(0);
    let digest = digest.stdout.split_whitespace().nth(3).expect("a digest").to_uppercase();
    let mut stored = user.stored();
    stored.sort();
    assert_eq!(stored, ["mine.safetensors", "other.safetensors", "smrnet-s.safetensors"]);
    // A large network of one's own is asked for by its digest.
    let own = ["weights", "add", "other.safetensors", "--name", "large"];
    user.run(&own).expect(3).tells("expected the SHA-256").tells(PUBLISHED[0].sha256);
    user.run(&[&own[..], &["--sha256", &digest]].concat()).expect(0);
    let quiet = user.run(&[&["detect", "x.png"], &QUICK[..]].concat()).expect(0);
    assert!(!quiet.stderr.contains("network"), "{}", quiet.stderr);
}

#[test]
fn what_fails_a_check_is_not_stored() {
    let user = User::new();
    let put =
        |name: &str, bytes: &[u8]| fs::write(user.at("here").join(name), bytes).expect("written");
    let whole = fs::read(small()).expect("weights");
    put("junk.safetensors", b"no weights");
    put("half.safetensors", &whole[..whole.len() / 2]);
    put("smrnet.safetensors", &altered(&small()));
    put("a.b.safetensors", &altered(&small()));
    let small = small();
    let wrong = "0".repeat(64);
    let cases: &[(i32, &[&str], &str)] = &[
        (3, &["junk.safetensors"], "junk.safetensors: not a whole safetensors file"),
        (3, &["half.safetensors"], "half.safetensors: not a whole safetensors file"),
        (3, &["gone.safetensors"], "gone.safetensors: No such file"),
        (3, &["."], "expected a file, got a folder"),
        (3, &[text(&small), "--sha256", &wrong], "expected the SHA-256 0000"),
        (3, &[text(&small), "--name", "large"], PUBLISHED[0].sha256),
        (3, &["smrnet.safetensors"], PUBLISHED[0].sha256),
        (3, &["smrnet.safetensors", "--name", "smrnet-s"], PUBLISHED[1].sha256),
        (2, &["a.b.safetensors"], "--name: expected one"),
        (2, &[text(&small), "--name", ".."], "expected a plain word"),
        (2, &[text(&small), "--name", "../x"], "expected a plain word"),
        (2, &[text(&small), "--name", "a/b"], "expected a plain word"),
        (2, &[text(&small), "--name", ""], "expected a plain word"),
        (2, &[text(&small), "--sha256", "12"], "expected 64 hexadecimal digits"),
        (2, &[text(&small), "--sha256", &"g".repeat(64)], "expected 64 hexadecimal digits"),
        (2, &[], "<FILE>"),
    ];
    for (code, arguments, phrase) in cases {
        let ran = user.run(&[&["weights", "add"], *arguments].concat()).expect(*code).tells(phrase);
        assert_eq!(ran.stdout, "", "{arguments:?}");
        assert!(!user.data().exists(), "{arguments:?}");
    }
}

/// No file may grow past 8 KiB: as on a full disk, the first part can be written.
#[test]
fn a_full_disk_stores_nothing() {
    let user = User::new();
    let full = |arguments: &str| {
        let line = format!("trap '' XFSZ; ulimit -f 8; exec \"$0\" weights add {arguments}");
        let mut shell = Command::new("/bin/sh");
        shell.args(["-c", &line]).arg(user.at("a/b/bin/smr-gpu")).arg(small());
        ran(shell.env_clear().env("HOME", user.home.path()).current_dir(user.at("here")))
    };
    full("\"$1\"").expect(6).tells("smrnet-s.safetensors: cannot write");
    assert_eq!(user.stored(), [""; 0]);
    // What was there stays.
    user.run(&["weights", "add", text(&small())]).expect(0);
    full("\"$1\" --name other").expect(6);
    assert_eq!(user.stored(), ["smrnet-s.safetensors"]);
    let stored = fs::read(user.data().join("smrnet-s.safetensors")).expect("stored");
    assert!(stored == fs::read(small()).expect("weights"));
}

/// Nor does a name that something else has, or a home that is no folder.
#[test]
fn what_cannot_be_written_is_named() {
    let user = User::new();
    fs::create_dir_all(user.data()).expect("created");
    symlink(user.at("elsewhere"), user.data().join("link.safetensors")).expect("linked");
    fs::create_dir(user.data().join("folder.safetensors")).expect("created");
    for name in ["link", "folder"] {
        let ran = user.run(&["weights", "add", text(&small()), "--name", name]).expect(6);
        ran.tells(text(&user.data().join(file_name(name))));
    }
    assert!(!user.at("elsewhere").exists());
    let mut homeless = user.command(&["weights", "add", text(&small())]);
    ran(homeless.env("HOME", user.at("here/x.png"))).expect(6).tells("here/x.png");
}
