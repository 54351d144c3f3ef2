//! Which kernels are fastest here: measured once, kept in a file, and taken from there.
//!
//! The network runs a few times with each kernel wherever it fits, and each operation keeps the one
//! with which it and the conversions before it took least.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use web_time::Instant;

use crate::engine::gpu::{Gpu, Profile, Program, ProgramOptions, Slot};
use crate::engine::graph::{Graph, TensorId};
use crate::engine::kernels;
use crate::engine::lower::{KernelChoice, Request, lower, works};
use crate::engine::precision::Precision;
use crate::engine::tensor::Value;
use crate::engine::tuned::{Place, Tuned};
use crate::error::{Error, Result};

/// Runs of each kernel, of which the fastest counts.
const RUNS: usize = 3;

/// Measures which kernels are fastest for `graph` on `gpu`, stored in `precision`, for at most about `limit`.
/// `progress` hears of each kernel's turn: how many there were, and are.
///
/// # Errors
/// [`Error::Device`] for an adapter without timestamps; what the device returns.
pub fn tune(
    gpu: &Arc<Gpu>,
    graph: &Graph,
    inputs: &[(TensorId, &Value)],
    precision: Precision,
    limit: Duration,
    mut progress: impl FnMut(usize, usize),
) -> Result<Tuned> {
    let start = Instant::now();
    // By operation and shapes: the kernels that fit, the preferred first.
    let mut candidates: BTreeMap<String, Vec<&'static str>> = BTreeMap::new();
    works(graph, (1, precision, gpu.caps()), |work| {
        let fitting = kernels::of(work.op)?.iter().filter(|k| k.fits(work)).map(|k| k.id());
        candidates.insert(KernelChoice::key(work), fitting.collect());
        Ok(())
    })?;
    let turns = candidates.values().map(Vec::len).max().unwrap_or(0);
    let mut best: BTreeMap<String, (Duration, &'static str)> = BTreeMap::new();
    for turn in 0..turns {
        if turn > 0 && start.elapsed() > limit {
            break;
        }
        let of_turn = |ids: &Vec<&'static str>| (*ids.get(turn).unwrap_or(&ids[0])).to_owned();
        let by_shape = candidates.iter().map(|(key, ids)| (key.clone(), of_turn(ids)));
        let kernels = KernelChoice { by_shape: by_shape.collect(), ..KernelChoice::default() };
        for (key, (time, kernel)) in times(gpu, graph, inputs, (&kernels, precision))? {
            let entry = best.entry(key).or_insert((time, kernel));
            if time < entry.0 {
                *entry = (time, kernel);
            }
        }
        progress(turn + 1, turns);
    }
    // What has one kernel needs no choice.
    let chosen =
        best.into_iter().filter(|(key, _)| candidates.get(key).is_some_and(|c| c.len() > 1));
    let by_shape = chosen.map(|(key, (_, kernel))| (key, kernel.to_owned())).collect();
    let kernels = KernelChoice { by_shape, ..KernelChoice::default() };
    Ok(Tuned { place: Place::of(gpu), kernels })
}

/// For each operation and shape, the mean time of its commands and of the conversions before them.
fn times(
    gpu: &Arc<Gpu>,
    graph: &Graph,
    inputs: &[(TensorId, &Value)],
    (kernels, precision): (&KernelChoice, Precision),
) -> Result<BTreeMap<String, (Duration, &'static str)>> {
    let request = Request { keep: &[], batch: 1, precision, caps: gpu.caps(), kernels };
    let lowered = lower(graph, &request)?;
    let options = ProgramOptions { profile: Profile::Commands, ..ProgramOptions::default() };
    let mut slot = pollster::block_on(async {
        let program = Program::new(gpu, &lowered, None, options).await?;
        Slot::new(&Arc::new(program)).await
    })?;
    let mut fastest: Vec<Duration> = vec![Duration::MAX; lowered.owners.len()];
    for _ in 0..RUNS {
        let times = slot.run(inputs)?.stages;
        if times.len() != fastest.len() {
            let message = "it has no timestamps, by which kernels are timed".into();
            return Err(Error::Device { adapter: gpu.info().name.clone(), message });
        }
        fastest.iter_mut().zip(times).for_each(|(best, t)| *best = (*best).min(t.time));
    }
    let mut by_node: BTreeMap<usize, Duration> = BTreeMap::new();
    for (owner, time) in lowered.owners.iter().zip(fastest) {
        *by_node.entry(*owner).or_default() += time;
    }
    let mut sums: BTreeMap<String, (Duration, u32, &'static str)> = BTreeMap::new();
    works(graph, (1, precision, gpu.caps()), |work| {
        let kernel = kernels.kernel(work)?.id();
        let time = by_node.get(&work.node).copied().unwrap_or_default();
        let sum = sums.entry(KernelChoice::key(work)).or_insert((Duration::ZERO, 0, kernel));
        *sum = (sum.0 + time, sum.1 + 1, kernel);
        Ok(())
    })?;
    let mean =
        |(key, (time, count, kernel)): (_, (Duration, u32, _))| (key, (time / count, kernel));
    Ok(sums.into_iter().map(mean).collect())
}
