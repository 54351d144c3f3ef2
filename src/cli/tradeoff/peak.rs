//! The most memory that a process takes for one picture: measured by a process of its own.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use smr_gpu::Config;
use smr_gpu::evaluation::tradeoff::Setup;

use super::super::detector;
use super::super::exit::{Exit, Failure};
use super::super::output::line;
use super::super::source::Source;
use super::setups::{configured, weights_of};

/// Detect in one picture and print the process's peak resident memory in bytes.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Args {
    /// The picture.
    picture: PathBuf,

    /// The setup as JSON.
    setup: String,
}

pub(in crate::cli) fn run(args: Args) -> Result<Exit, Failure> {
    let setup: Setup =
        serde_json::from_str(&args.setup).map_err(|e| Failure::usage(e.to_string()))?;
    let (config, _) = configured(&setup, Config::with_weights(weights_of(&setup)?))?;
    let detector = detector::open(config)?;
    let source = Source::File(args.picture);
    let picture = source.picture().map_err(|e| Failure::new(Exit::Inputs, e))?;
    detector.detect(&picture)?;
    if let Some(bytes) = peak_bytes() {
        line(bytes)?;
    }
    Ok(Exit::Done)
}

/// The most resident memory that this process had; `None` where the system does not tell.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// What a process of its own takes for one picture with this setup; `None` where the system does not tell.
///
/// # Errors
/// In words, if the process failed.
pub(super) fn of(setup: &Setup, picture: &Path) -> Result<Option<u64>, String> {
    let program = std::env::current_exe().map_err(|e| e.to_string())?;
    let setup = serde_json::to_string(setup).map_err(|e| e.to_string())?;
    let mut command = Command::new(program);
    command.arg("tradeoff-peak").arg(picture).arg(setup);
    // A group of its own, which a Ctrl-C of the terminal does not reach: its setup is finished first.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let output = command.stdin(Stdio::null()).output().map_err(|e| e.to_string())?;
    if !output.status.success() {
        let told = String::from_utf8_lossy(&output.stderr);
        let last = told.lines().rfind(|line| line.starts_with("smr-gpu: "));
        return Err(format!("its process: {}, {}", output.status, last.unwrap_or("nothing said")));
    }
    let told = String::from_utf8_lossy(&output.stdout);
    match told.trim() {
        "" => Ok(None),
        bytes => bytes.parse().map(Some).map_err(|_| format!("its process said `{bytes}`")),
    }
}
