//! `smr-gpu op`: runs one operation on tensors from a file.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::Arc;

use smr_gpu::engine::ops::{self, Entry, Op, Param, Params};
use smr_gpu::engine::tensor::Value;
use smr_gpu::files::Outputs;
use smr_gpu::verify::check::run_op;
use smr_gpu::{Device, Error};

use super::detector::{DeviceArgs, open_gpu};
use super::exit::{Exit, Failure};
use super::output::line;
use super::tensors;

/// Largest output of an operation; a device's limits are below it.
const MAX_OUTPUT_BYTES: u64 = 256 << 20;

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu op --list
  smr-gpu op nms in.safetensors out.safetensors --param iou_threshold=0.5
  smr-gpu op conv2d in.safetensors out.safetensors --device reference";

/// Run one operation on tensors from a file
///
/// The file names the tensors as the operation names its inputs. Where an operation computes a count, such as that of
/// the boxes it keeps, its outputs have no meaning past that count.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// The operation's name.
    #[arg(required_unless_present = "list")]
    name: Option<String>,

    /// The inputs: F16, F32, U32, I32 or I64.
    #[arg(required_unless_present = "list", value_name = "IN.safetensors")]
    input: Option<PathBuf>,

    /// Where to write the outputs, as F32 and U32.
    #[arg(required_unless_present = "list", value_name = "OUT.safetensors")]
    output: Option<PathBuf>,

    /// A parameter of the operation; may be given several times.
    #[arg(long = "param", value_name = "KEY=VALUE", value_parser = key_value)]
    params: Vec<(String, String)>,

    /// List the operations with their inputs, outputs and parameters.
    #[arg(long, exclusive = true)]
    list: bool,

    #[command(flatten)]
    device: DeviceArgs,
}

fn key_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) if !key.is_empty() => Ok((key.into(), value.into())),
        _ => Err("expected KEY=VALUE".into()),
    }
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let (Some(name), Some(input), Some(output)) = (&args.name, &args.input, &args.output) else {
        ops::OPS.iter().try_for_each(|entry| list(entry))?;
        return Ok(Exit::Done);
    };
    let Some(entry) = ops::find(name) else {
        let known: Vec<_> = ops::OPS.iter().map(|e| e.name).collect();
        let known = known.join(", ");
        return Err(Failure::usage(format!("operation: expected one of {known}; got `{name}`")));
    };
    let params: BTreeMap<_, _> = args.params.iter().cloned().collect();
    if params.len() < args.params.len() {
        return Err(Failure::usage("--param: expected each key once, got one several times"));
    }
    let mut files = Outputs::sparing([input]);
    files.check(output)?;
    let mut tensors = tensors::read(input)?;
    let present: Vec<&str> = tensors.keys().map(String::as_str).collect();
    let mut params = Params::new(name, params);
    let op = (entry.build)(&mut params, &present)?;
    params.finish()?;
    let inputs = take_inputs(op.as_ref(), &mut tensors)
        .map_err(|e| Failure::new(Exit::Inputs, format!("{}: {e}", input.display())))?;
    let op: Arc<dyn Op> = op.into();
    let outputs = compute(&op, &inputs, &args.device.device)?;
    let named = op.outputs().into_iter().zip(&outputs);
    tensors::write(&mut files, output, named, HashMap::new())?;
    Ok(Exit::Done)
}

/// Prints what an operation takes and gives.
fn list(entry: &Entry) -> Result<(), Failure> {
    line(entry.name)?;
    line(format!("   takes   {}", entry.takes))?;
    line(format!("   gives   {}", entry.gives))?;
    for param in entry.params.iter().filter(|p| !p.by_tensors) {
        let Param { name, value, range, .. } = param;
        line(match param.required {
            true => format!("   param   {name}: {range}; required, such as {value}"),
            false => format!("   param   {name}={value}: {range}"),
        })?;
    }
    Ok(())
}

/// The operation's inputs in its order; every tensor of the file must be one.
fn take_inputs(op: &dyn Op, tensors: &mut BTreeMap<String, Value>) -> Result<Vec<Value>, String> {
    let names = op.inputs();
    let expected = || format!("{} takes {}", op.name(), names.join(", "));
    let mut inputs = Vec::with_capacity(names.len());
    for name in &names {
        let tensor = tensors.remove(*name);
        inputs.push(tensor.ok_or_else(|| format!("no tensor `{name}`; {}", expected()))?);
    }
    match tensors.keys().next() {
        Some(extra) => Err(format!("tensor `{extra}` is no input; {}", expected())),
        None => Ok(inputs),
    }
}

fn compute(op: &Arc<dyn Op>, inputs: &[Value], device: &Device) -> Result<Vec<Value>, Failure> {
    let values: Vec<_> = inputs.iter().collect();
    // The CPU path has no device to refuse a size that no memory holds.
    let needed = op.check(&values)?.iter().map(|s| s.bytes()).max().unwrap_or(0);
    if needed > MAX_OUTPUT_BYTES {
        let what = format!("{}: bytes for an output", op.name());
        return Err(Error::Capacity { what, needed, available: MAX_OUTPUT_BYTES }.into());
    }
    Ok(match open_gpu(device)? {
        Some(gpu) => run_op(&gpu, op, inputs)?,
        None => op.reference(&values)?,
    })
}
