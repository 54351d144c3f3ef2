//! `smr-gpu check`: holds a device's operations to their references.

use smr_gpu::ops::{self, Case, Entry, Report};
use smr_gpu::{Device, host};

use super::detector::{DeviceArgs, open_gpu};
use super::exit::{Exit, Failure, exit_of};
use super::output::{line, tell};

/// Hold each operation's kernel to its reference on this machine
///
/// Runs the library's cases: hand-computed ones, edges and prime sizes, on poisoned and guarded
/// buffers. Prints for each operation its number of cases and the largest error as a share of its
/// bound; at most 1 passes.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Check this operation alone.
    name: Option<String>,

    #[command(flatten)]
    device: DeviceArgs,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let wanted = |e: &&&Entry| args.name.as_deref().is_none_or(|n| n == e.name);
    let entries: Vec<&Entry> = ops::OPS.iter().filter(wanted).copied().collect();
    if entries.is_empty() {
        let known: Vec<_> = ops::OPS.iter().map(|e| e.name).collect();
        let name = args.name.unwrap_or_default();
        let known = known.join(", ");
        return Err(Failure::usage(format!("operation: expected one of {known}; got `{name}`")));
    }
    let gpu = match &args.device.device {
        Device::Reference => {
            return Err(Failure::usage("--device: expected what is held to the reference, got it"));
        }
        other => open_gpu(other)?,
    };
    let run: Box<Run> = match gpu {
        None => {
            tell("CPU (f32)");
            Box::new(host::check)
        }
        Some(gpu) => {
            tell(format!("{} ({})", gpu.info().name, gpu.info().backend));
            Box::new(move |case| smr_gpu::check::check(&gpu, case))
        }
    };
    line(format!("{:<20}  {:>5}  {:>14}", "operation", "cases", "error / bound"))?;
    let mut exit = Exit::Done;
    for entry in entries {
        if !check(&run, entry)? {
            exit = Exit::Inputs;
        }
    }
    Ok(exit)
}

/// Runs a case and holds it to its reference.
type Run = dyn Fn(&Case) -> smr_gpu::Result<Report>;

/// Checks one operation; `false` if a case failed.
fn check(run: &Run, entry: &Entry) -> Result<bool, Failure> {
    let cases = (entry.cases)();
    let (mut share, mut failures) = (0.0_f64, Vec::new());
    for case in &cases {
        match run(case) {
            Ok(report) => {
                share = share.max(report.max_share);
                failures.extend(report.failures);
            }
            Err(e) if exit_of(&e) == Exit::Lost => return Err(e.into()),
            Err(e) => failures.push(format!("{} / {}: {e}", entry.name, case.name)),
        }
    }
    let verdict = if failures.is_empty() { "ok" } else { "FAILED" };
    line(format!("{:<20}  {:>5}  {share:>14.3}  {verdict}", entry.name, cases.len()))?;
    let passed = failures.is_empty();
    failures.into_iter().for_each(tell);
    Ok(passed)
}
