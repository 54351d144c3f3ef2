//! `smr-gpu check`: holds a device's operations to their references.

use smr_gpu::gpu::{Gpu, GpuOptions};
use smr_gpu::ops::{self, Entry};
use std::sync::Arc;

use super::detector::{DeviceArgs, gpu_only};
use super::exit::{Exit, Failure, exit_of};
use super::output::{line, tell};

/// Hold each operation's shader to its reference on this machine
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
    let adapter = gpu_only(&args.device.device)?.clone();
    let options = GpuOptions { adapter, ..GpuOptions::default() };
    let gpu = pollster::block_on(Gpu::open(options))?;
    tell(format!("{} ({})", gpu.info().name, gpu.info().backend));
    line(format!("{:<20}  {:>5}  {:>14}", "operation", "cases", "error / bound"))?;
    let mut exit = Exit::Done;
    for entry in entries {
        if !check(&gpu, entry)? {
            exit = Exit::Inputs;
        }
    }
    Ok(exit)
}

/// Checks one operation; `false` if a case failed.
fn check(gpu: &Arc<Gpu>, entry: &Entry) -> Result<bool, Failure> {
    let cases = (entry.cases)();
    let (mut share, mut failures) = (0.0_f64, Vec::new());
    for case in &cases {
        match ops::check(gpu, case) {
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
