//! `smr-gpu check`: holds a device's operations to their references.

use serde::Serialize;
use smr_gpu::verify::check::{Row, Selection, Target, rows};
use smr_gpu::{Device, Error, Precision};

use super::detector::{DeviceArgs, open_gpu};
use super::exit::{Exit, Failure};
use super::message::{remark, tell};
use super::output::{json_line, line};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu check
  smr-gpu check conv2d --precision f16
  smr-gpu check --device cpu";

/// Is each kernel right here? Compare each with the f64 reference
///
/// Runs the cases of each operation: hand-computed ones, edges and prime sizes, stiff and extreme values, on buffers
/// that are filled with NaN and guarded, in each precision. Prints for each kernel and precision the number of cases,
/// the largest error / bound, which passes up to 1, and the case it is from. The last line is the command that runs
/// the case nearest to its bound. Says where numbers overflow on the device that do not in f64.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Check only this operation.
    name: Option<String>,

    /// Check only this kernel, by its name in the second column.
    #[arg(long, value_name = "KERNEL")]
    kernel: Option<String>,

    /// Run only this case, by its name in the last column.
    #[arg(long, value_name = "NAME")]
    case: Option<String>,

    /// Check only this precision (f32, f16, bf16, int8).
    #[arg(long, value_name = "PRECISION")]
    precision: Option<Precision>,

    /// Print one line of JSON for each kernel and precision.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    device: DeviceArgs,
}

/// A row as JSON.
#[derive(Serialize)]
struct Object<'a> {
    operation: &'a str,
    kernel: &'a str,
    precision: Precision,
    cases: usize,
    share: f64,
    nearest: &'a str,
    failures: &'a [String],
    overflows: &'a [String],
    command: String,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let device = args.device.but_the_reference()?;
    let selection = Selection {
        operation: args.name.clone(),
        kernel: args.kernel.clone(),
        case: args.case.clone(),
        precision: args.precision,
    };
    let entries = selection.entries()?;
    let target = match open_gpu(&device)? {
        None => {
            remark("CPU (f32)");
            Target::Cpu
        }
        Some(gpu) => {
            remark(format!("{} ({})", gpu.info().name, gpu.info().backend));
            Target::Gpu(gpu)
        }
    };
    let mut all: Vec<Row> = Vec::new();
    let mut no_case = None;
    for entry in entries {
        let found = match rows(&target, entry, &selection) {
            // Another operation may have the case.
            Err(e @ Error::Param { .. }) if selection.operation.is_none() => {
                no_case = Some(e);
                continue;
            }
            found => found?,
        };
        for row in found {
            if all.is_empty() && !args.json {
                let [operation, kernel, cases] = ["operation", "kernel", "cases"];
                line(format!(
                    "{operation:<17}  {kernel:<25}  in   {cases:>5}  {:>13}          {}",
                    "error / bound", "nearest case"
                ))?;
            }
            print(&row, &args)?;
            row.failures.iter().for_each(tell);
            for line in &row.overflows {
                remark(format!("{} in {}: {line}", row.kernel, row.precision));
            }
            all.push(row);
        }
    }
    if all.is_empty() {
        let none = || Failure::usage("check: expected a kernel that fits a case here, got none");
        return Err(no_case.map_or_else(none, Failure::from));
    }
    let failed = |row: &Row| !row.failures.is_empty();
    let worse = |a: &&Row, b: &&Row| failed(a).cmp(&failed(b)).then(a.share.total_cmp(&b.share));
    if let Some(row) = all.iter().max_by(worse).filter(|_| !args.json && args.case.is_none()) {
        line("")?;
        line("nearest to its bound, alone:")?;
        line(command(row, &args.device.device))?;
    }
    Ok(if all.iter().any(failed) { Exit::Inputs } else { Exit::Done })
}

fn print(row: &Row, args: &Args) -> Result<(), Failure> {
    let Row { operation, kernel, precision, cases, share, nearest, failures, overflows } = row;
    if args.json {
        let command = command(row, &args.device.device);
        return json_line(&Object {
            operation,
            kernel,
            precision: *precision,
            cases: *cases,
            share: *share,
            nearest,
            failures,
            overflows,
            command,
        });
    }
    let verdict = if failures.is_empty() { "ok" } else { "FAILED" };
    line(format!(
        "{operation:<17}  {kernel:<25}  {precision}  {cases:>5}  {share:>13.3}  {verdict:<6}  {nearest}"
    ))
}

/// What a shell runs to see the case of a row alone.
fn command(row: &Row, device: &Device) -> String {
    let (device, case) = (quoted(&device.to_string()), quoted(&row.nearest));
    format!(
        "smr-gpu check {} --kernel {} --precision {} --case {case} --device {device}",
        row.operation, row.kernel, row.precision
    )
}

/// A word for a shell, in quotes where it must be.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(quoted("gpu"), "gpu");
        assert_eq!(quoted("2x2 by hand"), "'2x2 by hand'");
        assert_eq!(quoted("the sensor's"), r"'the sensor'\''s'");
        assert_eq!(quoted(""), "''");
    }
}
