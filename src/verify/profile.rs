//! Where the time goes: every dispatch of a network beside what the adapter can do.
//!
//! For people who tune kernels; it changes with them.

use std::sync::Arc;
use std::time::Duration;

use crate::engine::gpu::{Gpu, Profile, Program, ProgramOptions, Slot};
use crate::engine::graph::{Graph, TensorId};
use crate::engine::kernels::{Caps, Command, Grid, Recording, Role, TensorInfo, roof};
use crate::engine::lower::{KernelChoice, Lowered, Request, lower};
use crate::engine::precision::Precision;
use crate::engine::shader::reflect;
use crate::engine::shape::{Extent, TensorSpec};
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

/// One command of a program.
#[derive(Clone, Debug)]
pub struct CommandTime {
    /// Stage of the network.
    pub stage: String,
    /// What the operation's first output is called.
    pub tensor: String,
    /// The shader with its entry point and variant, or `copy`.
    pub what: String,
    /// The shortest time of all runs.
    pub time: Duration,
    /// Bytes that the operation must read and write; 0 for all but the command that takes longest of
    /// those of an operation.
    pub bytes: u64,
    /// Multiply-adds of the operation's definition, likewise.
    pub multiply_adds: u64,
}

/// What an adapter does at best, measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roof {
    /// Multiply-adds a second of independent chains in registers.
    pub multiply_adds: f64,
    /// Bytes a second, read and written, of a copy from buffer to buffer by a shader.
    pub bytes: f64,
}

/// What one command asks of an adapter, known without any.
#[derive(Clone, Debug)]
pub struct Cost {
    /// Stage of the network.
    pub stage: String,
    /// The kernel, or `copy`.
    pub kernel: String,
    /// Workgroups; 0 for a copy, and where a count on the device decides.
    pub workgroups: u64,
    /// Invocations of a workgroup.
    pub invocations: u64,
    /// Bytes of the tensors that it reads and writes, each once; without the picture, whose size is its
    /// own.
    pub bytes: u64,
    /// Multiply-adds of the operation's definition; 0 for all but one of an operation's commands.
    pub multiply_adds: u64,
}

/// What the commands that run `graph` on an adapter like `caps` ask of it.
///
/// # Errors
/// As [`lower`].
pub fn costs(
    graph: &Graph,
    caps: &Caps,
    kernels: &KernelChoice,
    precision: Precision,
) -> Result<Vec<Cost>> {
    let lowered = lower(graph, &Request { keep: &[], batch: 1, precision, caps, kernels })?;
    let recording = &lowered.recording;
    let mut found: Vec<Cost> = Vec::new();
    for (command, node) in recording.commands().iter().zip(&lowered.owners) {
        let own = &graph.nodes()[*node];
        let spec = |ids: &[TensorId]| -> Vec<TensorSpec> {
            ids.iter().map(|id| graph.spec(*id).clone()).collect()
        };
        let (read, wrote) = (spec(&own.inputs), spec(&own.outputs));
        let tensors = command.tensors();
        let bytes = tensors.iter().map(|id| match &recording.tensors()[id.0] {
            TensorInfo { role: Role::Input(Extent::UpTo), .. } => 0,
            info => info.storage.bytes(),
        });
        let mut cost = Cost {
            stage: graph.stages()[own.stage].clone(),
            kernel: "copy".into(),
            workgroups: 0,
            invocations: 0,
            bytes: bytes.sum(),
            multiply_adds: 0,
        };
        if let Command::Dispatch(dispatch) = command {
            cost.kernel = dispatch.shader.stem.into();
            let reflection = reflect(dispatch.shader, &dispatch.variant)?;
            let entry = reflection.entries.iter().find(|e| e.name == dispatch.entry);
            cost.invocations =
                entry.map_or(0, |e| e.workgroup_size.iter().map(|n| u64::from(*n)).product());
            cost.workgroups = match dispatch.grid {
                Grid::Workgroups(grid) => grid.iter().map(|n| u64::from(*n)).product(),
                Grid::Counted(..) | Grid::Indirect(..) => 0,
            };
            cost.multiply_adds = own.op.multiply_adds(&read, &wrote);
        }
        found.push(cost);
    }
    // Of an operation in several passes, the one that reads most has the products.
    for (at, node) in lowered.owners.iter().enumerate() {
        let own = lowered.owners.iter().enumerate().filter(|(_, n)| *n == node).map(|(i, _)| i);
        let most = own.max_by_key(|i| (found[*i].multiply_adds > 0, found[*i].bytes));
        if most != Some(at) {
            found[at].multiply_adds = 0;
        }
    }
    Ok(found)
}

/// Runs `graph` on `gpu` so many times with every command timed for itself.
///
/// # Errors
/// [`Error::Device`] for an adapter without timestamps; what the device returns.
pub fn commands(
    gpu: &Arc<Gpu>,
    graph: &Graph,
    inputs: &[(TensorId, &Value)],
    (kernels, precision): (&KernelChoice, Precision),
    runs: usize,
) -> Result<Vec<CommandTime>> {
    let request = Request { keep: &[], batch: 1, precision, caps: gpu.caps(), kernels };
    let lowered = lower(graph, &request)?;
    let names: Vec<(usize, String)> = lowered
        .owners
        .iter()
        .map(|node| (*node, graph.name(graph.nodes()[*node].outputs[0]).into()))
        .collect();
    let mut slot = slot(gpu, &lowered)?;
    let mut best: Vec<Duration> = Vec::new();
    let mut what = Vec::new();
    for _ in 0..runs.max(1) {
        let times = slot.run(inputs)?.stages;
        if times.is_empty() {
            let message = "it has no timestamps, by which commands are timed".into();
            return Err(Error::Device { adapter: gpu.info().name.clone(), message });
        }
        best.resize(times.len(), Duration::MAX);
        best.iter_mut().zip(&times).for_each(|(best, time)| *best = (*best).min(time.time));
        what = times.into_iter().map(|time| time.stage).collect();
    }
    let longest = |node: usize| {
        let own = names.iter().enumerate().filter(|(_, (n, _))| *n == node).map(|(at, _)| at);
        own.max_by_key(|at| best[*at])
    };
    let mut found = Vec::new();
    for (at, ((node, tensor), what)) in names.iter().zip(what).enumerate() {
        let spec = |ids: &[TensorId]| -> Vec<TensorSpec> {
            ids.iter().map(|id| graph.spec(*id).clone()).collect()
        };
        let own = &graph.nodes()[*node];
        let (read, wrote) = (spec(&own.inputs), spec(&own.outputs));
        let (mut bytes, mut multiply_adds) = (0, 0);
        if longest(*node) == Some(at) {
            // A picture has a size of its own, at most that of the graph's.
            let given = |id: &TensorId| inputs.iter().find(|(input, _)| input == id);
            let each = own.inputs.iter().chain(&own.outputs).map(|id| match given(id) {
                Some((_, value)) => value.spec().bytes(),
                None => graph.spec(*id).bytes(),
            });
            bytes = each.sum();
            multiply_adds = own.op.multiply_adds(&read, &wrote);
        }
        let stage = graph.stages()[own.stage].clone();
        let (tensor, time) = (tensor.clone(), best[at]);
        found.push(CommandTime { stage, tensor, what, time, bytes, multiply_adds });
    }
    Ok(found)
}

fn slot(gpu: &Arc<Gpu>, lowered: &Lowered) -> Result<Slot> {
    let options = ProgramOptions { profile: Profile::Commands, ..ProgramOptions::default() };
    pollster::block_on(async {
        let program = Program::new(gpu, lowered, None, options).await?;
        Slot::new(&Arc::new(program)).await
    })
}

/// Measures an adapter: the best of so many runs.
///
/// # Errors
/// As [`commands`].
pub fn roof(gpu: &Arc<Gpu>, runs: usize) -> Result<Roof> {
    let mut recording = Recording::new(1, Precision::F32, gpu.caps().clone());
    recording.begin_stage("roof");
    roof::record(&mut recording);
    let lowered = Lowered {
        recording,
        places: Default::default(),
        precision: Precision::F32,
        kernels: Vec::new(),
        owners: Vec::new(),
    };
    let mut slot = slot(gpu, &lowered)?;
    let mut best = [f64::INFINITY; 2];
    for _ in 0..runs.max(1) {
        let times = slot.run(&[])?.stages;
        if times.len() != 2 {
            let message = "it has no timestamps, by which it is measured".into();
            return Err(Error::Device { adapter: gpu.info().name.clone(), message });
        }
        for (best, time) in best.iter_mut().zip(times) {
            *best = best.min(time.time.as_secs_f64());
        }
    }
    Ok(Roof { multiply_adds: roof::MULTIPLY_ADDS / best[0], bytes: roof::BYTES / best[1] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::gpu::GpuOptions;
    use crate::engine::ops::{Conv2d, GatherRows};
    use crate::engine::tensor::Tensor;

    /// A map on its way to a texture: to quads, the copy, the products.
    #[test]
    fn a_copy_takes_time() {
        let gpu = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
        let mut graph = Graph::default();
        let input = graph.input("input", TensorSpec::f32([64, 64, 64]), Extent::Exact);
        let weight = graph.constant("weight", Tensor::from_fn([16, 64, 1, 1], |i| i as f32));
        let op = Conv2d { bias: false, ..Conv2d::default() };
        let output = graph.apply1("conv", op, &[input, weight]).expect("a map");
        graph.mark_output(output);
        let value = Value::from(Tensor::<f32>::zeros([64, 64, 64]));
        let how = (&KernelChoice::force("conv2d/scalar").expect("a kernel"), Precision::F32);
        let times = commands(&gpu, &graph, &[(input, &value)], how, 2).expect("times");
        assert!(times.iter().any(|time| time.what == "copy"), "{times:?}");
        let none: Vec<_> = times.iter().filter(|time| time.time.is_zero()).collect();
        assert!(none.is_empty(), "{none:?}");
    }

    /// Room for a hundred rows, of which a run gives ten and gathers five.
    #[test]
    fn bytes_are_those_given() {
        let gpu = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
        let mut graph = Graph::default();
        let input = graph.input("rows", TensorSpec::u32([100]), Extent::UpTo);
        let indices = graph.constant("indices", Tensor::from_fn([5], |i| i as u32));
        let count = graph.constant("count", Tensor::from_fn([1], |_| 5u32));
        let output = graph.apply1("gather", GatherRows {}, &[input, indices, count]);
        graph.mark_output(output.expect("rows"));
        let value = Value::from(Tensor::from_fn([10], |i| i as u32));
        let how = (&KernelChoice::default(), Precision::F32);
        let times = commands(&gpu, &graph, &[(input, &value)], how, 1).expect("times");
        assert_eq!(times.iter().map(|time| time.bytes).sum::<u64>(), 4 * (10 + 5 + 1 + 5));
    }
}
