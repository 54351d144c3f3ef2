//! Plants faults in the host's code, one at a time, and tells which tests notice them.
//!
//! ```sh
//! cargo run --release --example host_faults -- [--search] [--target DIR] [WORD]
//! ```
//!
//! A copy of the tracked files gets every fault of `tests/support/host_faults.rs` behind a switch that a
//! process reads once from its environment, so that one build of the tests has them all. Without a fault
//! each named test must pass, and with its fault fail. With `--search` all tests of the crates that the
//! list names are run where the named one does not fail. WORD chooses faults by file, words or test.

#[path = "../tests/support/host_faults.rs"]
mod host_faults;

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use host_faults::{FAULTS, Fault};

/// The variable that says which fault is switched on, counted from 1.
const SWITCH: &str = "SMR_GPU_PLANTED";
/// Longest run of tests: one that does not end notices the fault too.
const LONGEST: Duration = Duration::from_secs(300);

type Outcome<T> = Result<T, Box<dyn Error>>;

/// What the copy's crate gets.
const FUNCTION: &str = r#"
pub(crate) fn planted(fault: usize) -> bool {
    static ON: std::sync::OnceLock<usize> = std::sync::OnceLock::new();
    let on = || std::env::var("SMR_GPU_PLANTED").ok().and_then(|n| n.parse().ok()).unwrap_or(0);
    *ON.get_or_init(on) == fault
}
"#;

fn main() -> Outcome<()> {
    let mut target = env::temp_dir().join("smr-gpu-host-faults");
    let (mut search, mut word) = (false, String::new());
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--search" => search = true,
            "--target" => target = arguments.next().ok_or("--target needs a folder")?.into(),
            other => word = other.to_owned(),
        }
    }
    // Always the same folder: what did not change is not built again.
    let copy = target.join("copy");
    plant(Path::new(env!("CARGO_MANIFEST_DIR")), &copy)?;
    let binaries = build(&copy, &target)?;
    let run = |binary: Option<&'static str>, test: Option<&str>, fault: usize| {
        tests(&copy, &binaries[binary.unwrap_or("smr_gpu")], test, fault)
    };

    let chosen = |fault: &Fault| {
        [fault.what, fault.file, fault.test].iter().any(|text| text.contains(&word))
    };
    let chosen: Vec<_> = FAULTS.iter().zip(1..).filter(|(fault, _)| chosen(fault)).collect();
    let named: BTreeSet<_> = chosen.iter().map(|(fault, _)| fault.place()).collect();
    for (binary, test) in named {
        match run(binary, Some(&test), 0)? {
            Verdict::Passed => {}
            _ if search => println!("without a fault, {test} does not pass"),
            other => return Err(format!("without a fault, {test}: {other:?}").into()),
        }
    }
    let mut missed = Vec::new();
    for (fault, number) in &chosen {
        let (binary, test) = fault.place();
        let verdict = run(binary, Some(&test), *number)?;
        let said = match verdict {
            Verdict::Failed(_) => format!("noticed by {}", fault.test),
            Verdict::Endless => format!("noticed by {}, which does not end", fault.test),
            Verdict::Passed | Verdict::None => {
                missed.push(*fault);
                let mut others = Vec::new();
                for binary in binaries.keys().filter(|_| search) {
                    if let Verdict::Failed(tests) = tests(&copy, &binaries[binary], None, *number)?
                    {
                        others.extend(tests.into_iter().map(|test| format!("{binary}: {test}")));
                    }
                }
                format!("NOT noticed by {}: {others:?}", fault.test)
            }
        };
        println!("{number:3} {}: {}: {said}", fault.file, fault.what);
    }
    println!(
        "{} of {} faults noticed by the tests that are named",
        chosen.len() - missed.len(),
        chosen.len()
    );
    match missed.is_empty() {
        true => Ok(()),
        false => Err("not all were noticed".into()),
    }
}

/// Copies the tracked files of `from`, as they are now, and puts the faults into them.
fn plant(from: &Path, to: &Path) -> Outcome<()> {
    let mut list = Command::new("git");
    let list = list.args(["ls-files", "-z", "-c", "-o", "--exclude-standard"]).current_dir(from);
    let listed = String::from_utf8(list.output()?.stdout)?;
    // Those of one expression have one switch.
    let mut places: BTreeMap<(String, &str), Vec<(usize, &str)>> = BTreeMap::new();
    for (number, fault) in (1..).zip(FAULTS) {
        places.entry((fault.path(), fault.from)).or_default().push((number, fault.to));
    }
    for file in listed.split('\0').filter(|file| from.join(file).is_file()) {
        let mut bytes = fs::read(from.join(file))?;
        let here: Vec<_> = places.iter().filter(|((path, _), _)| path == file).collect();
        if !here.is_empty() {
            let mut text = String::from_utf8(bytes)?;
            for ((_, expression), faults) in here {
                if text.matches(expression).count() != 1 {
                    let expected = "expected once, and in no other fault";
                    return Err(format!("{file}: {expected}: {expression}").into());
                }
                let ways = faults.iter().map(|(number, faulty)| {
                    format!("if crate::planted({number}) {{ {faulty} }} else ")
                });
                let switch = format!("({}{{ {expression} }})", ways.collect::<String>());
                text = text.replacen(expression, &switch, 1);
            }
            bytes = format!("#![allow(warnings)]\n{text}").into();
        }
        if file == "src/lib.rs" {
            bytes.extend(FUNCTION.bytes());
        }
        let to = to.join(file);
        if fs::read(&to).ok() != Some(bytes.clone()) {
            fs::create_dir_all(to.parent().ok_or("a file in a folder")?)?;
            fs::write(to, bytes)?;
        }
    }
    Ok(())
}

/// Builds the tests that the list names: their programs, by crate.
fn build(copy: &Path, target: &Path) -> Outcome<BTreeMap<String, PathBuf>> {
    let mut command = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    command.args(["test", "--release", "--no-run", "--message-format=json", "--lib"]);
    for binary in FAULTS.iter().filter_map(|fault| fault.place().0).collect::<BTreeSet<_>>() {
        command.args(["--test", binary]);
    }
    let command =
        command.current_dir(copy).env("CARGO_TARGET_DIR", target).stderr(Stdio::inherit());
    let output = command.output()?;
    let mut binaries = BTreeMap::new();
    for line in String::from_utf8(output.stdout)?.lines() {
        let message: serde_json::Value = serde_json::from_str(line)?;
        if let Some(text) = message["message"]["rendered"].as_str()
            && message["message"]["level"] == "error"
        {
            eprintln!("{text}");
        }
        if message["profile"]["test"] == true
            && let (Some(program), Some(name)) =
                (message["executable"].as_str(), message["target"]["name"].as_str())
        {
            binaries.insert(name.to_owned(), program.into());
        }
    }
    match output.status.success() {
        true => Ok(binaries),
        false => Err("the copy's tests were not built".into()),
    }
}

/// What became of a run of tests.
#[derive(Debug)]
enum Verdict {
    Passed,
    /// These failed.
    Failed(Vec<String>),
    /// It was ended.
    Endless,
    /// There is no such test.
    None,
}

/// Runs one test of a program, or all, with a fault.
fn tests(copy: &Path, program: &Path, test: Option<&str>, fault: usize) -> Outcome<Verdict> {
    let log = copy.join("tests.log");
    let mut command = Command::new(program);
    if let Some(test) = test {
        command.args(["--exact", test]);
    }
    command.current_dir(copy).env(SWITCH, fault.to_string()).env("CARGO_MANIFEST_DIR", copy);
    let mut child = command.stdout(fs::File::create(&log)?).stderr(Stdio::null()).spawn()?;
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if begun.elapsed() > LONGEST {
            child.kill()?;
            child.wait()?;
            return Ok(Verdict::Endless);
        }
        thread::sleep(Duration::from_millis(10));
    };
    let said = fs::read_to_string(&log)?;
    let failed = said.lines().filter_map(|line| line.strip_suffix("... FAILED"));
    let failed = failed.filter_map(|line| line.trim().strip_prefix("test ").map(str::to_owned));
    Ok(match status.success() {
        true if test.is_some() && !said.contains("1 passed") => Verdict::None,
        true => Verdict::Passed,
        false => Verdict::Failed(failed.collect()),
    })
}
