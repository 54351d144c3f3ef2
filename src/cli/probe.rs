//! Looks for adapters in a process of its own: a driver that crashes or hangs while it loads takes nothing else
//! with it.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use super::adapters::Record;
use super::exit::{Exit, Failure};
use super::output::json_line;

/// The command that [`answer`]s.
pub(super) const COMMAND: &str = "look-for-adapters";
/// Longest wait for drivers where the CPU can do the work.
pub(super) const BRIEFLY: Duration = Duration::from_secs(5);
/// The same where a GPU is asked for: some of a server take long to wake up.
pub(super) const PATIENTLY: Duration = Duration::from_secs(60);
/// Between two looks at whether the process has ended.
const PAUSE: Duration = Duration::from_millis(1);

/// What runs in the process of its own: prints the adapters on one line.
///
/// # Errors
/// As [`json_line`].
pub(super) fn answer() -> Result<Exit, Failure> {
    json_line(&Record::all())?;
    Ok(Exit::Done)
}

/// The adapters, best first. Looked for once: later calls get the same.
///
/// # Errors
/// What became of the drivers, in words.
pub(super) fn adapters(limit: Duration) -> Result<&'static [Record], &'static str> {
    static FOUND: OnceLock<Result<Vec<Record>, String>> = OnceLock::new();
    let found = FOUND.get_or_init(|| find(limit));
    found.as_deref().map_err(String::as_str)
}

fn find(limit: Duration) -> Result<Vec<Record>, String> {
    // Where no process is to be had, this one must do.
    let Some(mut child) = start() else { return Ok(Record::all()) };
    let end = Instant::now() + limit;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return read(child, status),
            Ok(None) if Instant::now() < end => std::thread::sleep(PAUSE),
            _ => break,
        }
    }
    // Not waited for: what hangs within the kernel cannot be ended.
    let _ = child.kill();
    let _ = child.try_wait();
    Err(format!("the GPU drivers gave no answer within {} s", limit.as_secs()))
}

fn start() -> Option<Child> {
    let mut command = Command::new(std::env::current_exe().ok()?);
    // What drivers have to say they say when they are loaded for use.
    command.arg(COMMAND).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    command.spawn().ok()
}

fn read(mut child: Child, status: ExitStatus) -> Result<Vec<Record>, String> {
    if !status.success() {
        return Err(format!("a GPU driver failed while it was loaded ({status})"));
    }
    let mut line = String::new();
    // A line, since a process that a driver started may hold the pipe open.
    let told = child.stdout.take().map(|out| BufReader::new(out).read_line(&mut line));
    let records = serde_json::from_str(&line).ok().filter(|_| matches!(told, Some(Ok(_))));
    records.ok_or_else(|| "the look for GPU drivers gave no list".into())
}
