//! The training package as a child: what it is asked for, how far it is, and what it says where it fails.

use std::fs::{self, File, OpenOptions};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use serde::Deserialize;
use smr_gpu::files;

use super::super::exit::{Exit, Failure};
use super::super::message::tell;
use super::super::names::shown;

/// How often a child is looked at.
const PAUSE: Duration = Duration::from_millis(200);
/// Longest output and longest history that are read, in bytes.
const MAX_OUTPUT: u64 = 1 << 26;

/// How often Ctrl-C was pressed, or an end asked for otherwise.
static STOPPED: AtomicUsize = AtomicUsize::new(0);
static CHILD_RUNS: AtomicBool = AtomicBool::new(false);

/// Lets Ctrl-C, and what else asks for an end, end a child in order, and the program at once where there is none.
pub(super) fn stop_in_order() {
    let handler = ctrlc::set_handler(|| {
        STOPPED.fetch_add(1, Ordering::SeqCst);
        if !CHILD_RUNS.load(Ordering::SeqCst) {
            tell(AGAIN);
            std::process::exit(Exit::Interrupted as i32);
        }
    });
    if let Err(e) = handler {
        tell(format!("Ctrl-C will lose what was learnt since the last checkpoint: {e}"));
    }
}

const AGAIN: &str = "stopped; the same command goes on";

/// What `fit --estimate` says.
#[derive(Debug, Deserialize)]
pub(super) struct Estimate {
    pub pictures: usize,
    pub without_snap: usize,
    /// Snaps by class.
    pub snaps: std::collections::BTreeMap<String, usize>,
    pub device: String,
    pub threads: usize,
    pub seconds_per_step: f64,
}

/// A line of a run's history: a step's losses, or what was found in validation pictures.
#[derive(Debug, Deserialize)]
pub(super) struct Line {
    pub step: u32,
    #[serde(default)]
    pub loss: Option<f64>,
    #[serde(default)]
    pub seconds_left: Option<f64>,
    /// By folder and class.
    #[serde(default)]
    pub val: Option<std::collections::BTreeMap<String, serde_json::Map<String, serde_json::Value>>>,
}

/// A Python with the training package.
pub(super) struct Python {
    program: PathBuf,
    /// Where children's output goes.
    log: PathBuf,
}

impl Python {
    /// # Errors
    /// [`Exit::Usage`] if the program cannot be run, or lacks the package or what that needs.
    pub fn new(program: &Path, work: &Path) -> Result<Self, Failure> {
        let name = shown(program.as_os_str());
        let lacks = |what: &str| {
            Failure::usage(format!(
                "--python {name}: {what}. From the sources of smr-gpu, `{name} -m pip install \
                 ./weights/training` installs what is needed; its README says how to get a CPU build of torch, \
                 0.2 GB in place of 5.6"
            ))
        };
        let check = "import smr_gpu_train, torch, torchvision; print(smr_gpu_train.__version__)";
        let ran = Command::new(program).args(["-c", check]).stdin(Stdio::null()).output();
        let ran = ran.map_err(|e| lacks(&format!("cannot be run: {e}")))?;
        if !ran.status.success() {
            let said = String::from_utf8_lossy(&ran.stderr);
            return Err(lacks(said.trim().lines().last().unwrap_or("it said nothing")));
        }
        let version = String::from_utf8_lossy(&ran.stdout).trim().to_owned();
        if version != env!("CARGO_PKG_VERSION") {
            let own = env!("CARGO_PKG_VERSION");
            return Err(lacks(&format!("expected smr-gpu-train {own}, got {version}")));
        }
        Ok(Self { program: program.to_owned(), log: work.join("training.log") })
    }

    /// Runs a subcommand to its end; `look` is called now and then meanwhile. Returns what it wrote to stdout and
    /// stderr.
    ///
    /// # Errors
    /// [`Exit::Interrupted`] if it was stopped; what it said last, if it failed.
    pub fn run(&self, arguments: &[String], look: &mut dyn FnMut()) -> Result<String, Failure> {
        let failed = |e: std::io::Error| {
            Failure::new(Exit::Output, format!("{}: {e}", shown(self.log.as_os_str())))
        };
        let mut log = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .open(&self.log)
            .map_err(failed)?;
        let before = log.seek(SeekFrom::End(0)).map_err(failed)?;
        CHILD_RUNS.store(true, Ordering::SeqCst);
        let status = self.wait(arguments, &log, look);
        CHILD_RUNS.store(false, Ordering::SeqCst);
        let status = status.map_err(failed)?;
        log.seek(SeekFrom::Start(before)).map_err(failed)?;
        let mut said = Vec::new();
        log.take(MAX_OUTPUT).read_to_end(&mut said).map_err(failed)?;
        let said = String::from_utf8_lossy(&said).into_owned();
        if status.success() {
            return Ok(said);
        }
        if STOPPED.load(Ordering::SeqCst) > 0 || status.code() == Some(Exit::Interrupted as i32) {
            return Err(Failure::new(Exit::Interrupted, AGAIN));
        }
        let last = said.trim().lines().last().unwrap_or("").trim_start_matches("smr-gpu-train: ");
        let exit = match status.code() {
            Some(2) => Exit::Usage,
            Some(6) => Exit::Output,
            _ => Exit::Inputs,
        };
        let log = shown(self.log.as_os_str());
        Err(Failure::new(exit, format!("training: {last} ({status}; {log} has all that it said)")))
    }

    fn wait(
        &self,
        arguments: &[String],
        log: &File,
        look: &mut dyn FnMut(),
    ) -> std::io::Result<ExitStatus> {
        let mut command = Command::new(&self.program);
        command.args(["-m", "smr_gpu_train"]).args(arguments).stdin(Stdio::null());
        command.stdout(log.try_clone()?).stderr(log.try_clone()?);
        // A terminal's Ctrl-C goes to this process alone, which passes on what else asks for an end too.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let mut told = 0;
        loop {
            if let Some(status) = child.try_wait()? {
                return Ok(status);
            }
            while told < STOPPED.load(Ordering::SeqCst) {
                told += 1;
                end(&child);
            }
            look();
            thread::sleep(PAUSE);
        }
    }
}

/// Asks a child to end: it lets its step end, asked twice it does not. On Windows the console has asked it.
fn end(child: &Child) {
    #[cfg(unix)]
    if let Some(id) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
        // It may have ended by itself.
        let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
    }
    #[cfg(not(unix))]
    let _ = child;
}

const HISTORY: &str = "history.jsonl";

/// Bytes of a run's history.
pub(super) fn history_length(run: &Path) -> u64 {
    fs::metadata(run.join(HISTORY)).map_or(0, |file| file.len())
}

/// The lines of a run's history; what is no whole line of one is left out.
pub(super) fn history(run: &Path) -> Vec<Line> {
    let file = run.join(HISTORY);
    let text = match files::read(&file, MAX_OUTPUT) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(_) => String::new(),
    };
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// Whether a run came to its end.
pub(super) fn weights_of(run: &Path) -> Option<PathBuf> {
    let weights = run.join("weights.safetensors");
    fs::exists(&weights).unwrap_or(false).then_some(weights)
}
