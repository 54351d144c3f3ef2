//! `smr-gpu devices`: the adapters, with the limits that matter here.

use super::adapters::{Limits, Record};
use super::exit::{Exit, Failure};
use super::output::{json_line, line};
use super::probe;

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu devices
  smr-gpu devices --json
  smr-gpu detect picture.png --device 1";

/// List the adapters
///
/// The index is what --device takes. `auto` is the first hardware adapter that lacks nothing, or the CPU if there is
/// none. Drivers are loaded in a process of their own, so one that crashes or hangs ends that process alone.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Print one line of JSON for each adapter.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let failed = |why| Failure::new(Exit::Device, why);
    let found = probe::adapters(probe::PATIENTLY).map_err(failed)?;
    if found.is_empty() {
        let message = "no GPU adapter was found; the package `mesa-vulkan-drivers` brings one";
        return Err(Failure::new(Exit::Device, message));
    }
    for record in found {
        if args.json {
            json_line(record)?;
        } else {
            print(record)?;
        }
    }
    if found.iter().all(|record| !record.lacks.is_empty()) {
        let message = "every adapter lacks something that the shaders need; the package \
                       `mesa-vulkan-drivers` brings one that lacks nothing";
        return Err(Failure::new(Exit::Device, message));
    }
    Ok(Exit::Done)
}

fn print(r: &Record) -> Result<(), Failure> {
    let Limits {
        workgroup_memory_bytes,
        workgroup_invocations,
        storage_buffers_per_stage,
        storage_binding_bytes,
        workgroups_per_dimension,
        subgroup_sizes: [least, most],
    } = r.limits;
    let mib = storage_binding_bytes >> 20;
    let none_if_empty = |list: String| if list.is_empty() { "nothing".into() } else { list };
    line(format!("{}  {}", r.index, r.name))?;
    line(format!("   {} ({}), driver {}", r.backend, r.kind, r.driver))?;
    line(format!(
        "   workgroups: {workgroup_memory_bytes} bytes of memory, {workgroup_invocations} \
         invocations, {workgroups_per_dimension} a dimension; subgroups of {least} to {most}"
    ))?;
    line(format!("   storage: {storage_buffers_per_stage} buffers a stage, {mib} MiB a binding"))?;
    line(format!("   offers: {}", none_if_empty(r.features.join(", "))))?;
    line(format!("   lacks:  {}", none_if_empty(r.lacks.join("; "))))
}
