//! `smr-gpu bench`: where the time goes on an adapter.

use serde::Serialize;
use smr_gpu::verify::{laboratory, profile};
use smr_gpu::{Device, GpuDetector, Savings};

use super::detector::{AdapterArgs, NetworkArgs};
use super::exit::{Exit, Failure};
use super::message::remark;
use super::output::{json_line, line};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu bench
  smr-gpu bench --ops --runs 20
  smr-gpu bench --weights small --json";

/// Where does the time go? Time every command of the network on an adapter
///
/// Prints for each stage, or with --ops for each dispatch and copy, the best time of several runs, the bytes that it
/// must read and write, its multiply-adds, and what share of the adapter's own measured rates that is. Each command is
/// timed in a pass of its own, so that their sum is longer than a detection.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Print a line for each command instead of each stage.
    #[arg(long)]
    ops: bool,

    /// Number of runs; the best counts.
    #[arg(long, default_value_t = 5, value_name = "N")]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=1000))]
    #[arg(allow_negative_numbers = true)]
    runs: u16,

    /// Print lines of JSON.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    network: NetworkArgs,

    #[command(flatten)]
    device: AdapterArgs,
}

#[derive(Debug, Default, Serialize)]
struct Record {
    stage: String,
    tensor: String,
    what: String,
    ms: f64,
    bytes: u64,
    multiply_adds: u64,
    /// Shares of the adapter's measured rates.
    of_copy: f64,
    of_multiply_add: f64,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let mut config = args.network.config(Savings::NONE)?;
    let gpu = args.device.open(&args.network)?;
    config.device = Device::Reference;
    let runs = args.runs.into();
    let roof = profile::roof(&gpu, runs)?;
    remark(format!(
        "{} ({}): {:.1} GMAC/s of multiply-adds, {:.1} GB/s of copies",
        gpu.info().name,
        gpu.info().backend,
        roof.multiply_adds / 1e9,
        roof.bytes / 1e9
    ));
    let mut records: Vec<Record> = Vec::new();
    let detector = GpuDetector::new(config)?;
    for command in laboratory::profile(&detector, &gpu, runs, remark)? {
        let seconds = command.time.as_secs_f64();
        let record = Record {
            stage: command.stage,
            tensor: command.tensor,
            what: command.what,
            ms: seconds * 1e3,
            bytes: command.bytes,
            multiply_adds: command.multiply_adds,
            ..Record::default()
        };
        match records.last_mut().filter(|last| !args.ops && last.stage == record.stage) {
            Some(last) => {
                last.ms += record.ms;
                last.bytes += record.bytes;
                last.multiply_adds += record.multiply_adds;
            }
            None if args.ops => records.push(record),
            None => records.push(Record { tensor: "all".into(), what: String::new(), ..record }),
        }
    }
    for record in &mut records {
        let seconds = (record.ms / 1e3).max(f64::MIN_POSITIVE);
        record.of_copy = record.bytes as f64 / seconds / roof.bytes;
        record.of_multiply_add = record.multiply_adds as f64 / seconds / roof.multiply_adds;
    }
    if args.json {
        records.iter().try_for_each(json_line)?;
        return Ok(Exit::Done);
    }
    let names = ["stage", "tensor", "ms", "MB", "MMAC", "of copy", "of MAC", "command"];
    let [stage, tensor, ms, mb, mmac, copy, mac, what] = names;
    line(format!("{stage:<16} {tensor:<32} {ms:>8} {mb:>8} {mmac:>8} {copy:>8} {mac:>8}  {what}"))?;
    for r in &records {
        line(format!(
            "{:<16} {:<32} {:>8.3} {:>8.2} {:>8.1} {:>7.1}% {:>7.1}%  {}",
            r.stage,
            r.tensor,
            r.ms,
            r.bytes as f64 / 1e6,
            r.multiply_adds as f64 / 1e6,
            r.of_copy * 100.0,
            r.of_multiply_add * 100.0,
            r.what
        ))?;
    }
    let total: f64 = records.iter().map(|r| r.ms).sum();
    line(format!("{:<16} {:<32} {total:>8.3}", "all", ""))?;
    Ok(Exit::Done)
}
