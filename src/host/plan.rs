//! A [`HostPlan`]: a graph made ready to run on the CPU.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::kernel::{Data, Kernel, Layout, convert};
use super::packs::Packs;
use super::reference::Reference;
use crate::error::{Error, Result};
use crate::graph::{Graph, Source, StageTime, TensorId};
use crate::shape::{DType, TensorSpec};
use crate::tensor::{Constant, Tensor, Value};

/// A tensor's values in one layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Version {
    tensor: TensorId,
    layout: Layout,
}

#[derive(Debug)]
struct Step {
    work: Work,
    /// `None` for what the kernel keeps itself.
    inputs: Vec<Option<Version>>,
    outputs: Vec<Version>,
    stage: usize,
}

#[derive(Debug)]
enum Work {
    Kernel(Box<dyn Kernel>),
    /// To the other layout, from this one.
    Convert(Layout),
}

/// Where a version's values are.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// Given for each run.
    Given,
    /// A buffer.
    Slot(usize),
}

/// A graph with its weights packed and its buffers allocated.
pub struct HostPlan {
    packs: Arc<Packs>,
    steps: Vec<Step>,
    places: HashMap<Version, Place>,
    specs: Vec<TensorSpec>,
    names: Vec<String>,
    inputs: Vec<TensorId>,
    /// Each buffer; integers lie in them as their bits.
    slots: Vec<Vec<f32>>,
    /// What is given back, each in the layout in which it is computed.
    wanted: Vec<Version>,
    stages: Vec<String>,
}

impl std::fmt::Debug for HostPlan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "HostPlan({} steps, {} buffers)", self.steps.len(), self.slots.len())
    }
}

impl HostPlan {
    /// Packs the weights of `graph`. A run gives back its outputs and the tensors in `keep`. Weights that
    /// `like` has packed, a plan of the same weights, are shared.
    ///
    /// # Errors
    /// What the kernels refuse.
    pub fn new(graph: &Graph, keep: &[TensorId], like: Option<&Self>) -> Result<Self> {
        let packs = like.map_or_else(Arc::default, |plan| plan.packs.clone());
        let mut builder = Builder { graph, packs: &packs, made: HashMap::new(), steps: Vec::new() };
        let mut constants = Vec::new();
        for node in graph.nodes() {
            builder.add(node, &mut constants)?;
        }
        let Builder { made, steps, .. } = builder;
        let wanted: Vec<Version> = graph
            .outputs()
            .iter()
            .chain(keep)
            .filter_map(|id| made.get(id).map(|layout| Version { tensor: *id, layout: *layout }))
            .collect();
        let specs: Vec<TensorSpec> = graph.tensors().iter().map(|t| t.spec.clone()).collect();
        let given = |id: TensorId| matches!(graph.tensors()[id.0].source, Source::Input(_));
        let (places, mut slots) = place(&steps, &wanted, &specs, given);
        for (version, value) in constants {
            let Some(Place::Slot(slot)) = places.get(&version) else { continue };
            let words: &[f32] = match value.as_ref() {
                Value::F32(t) => t.data(),
                Value::U32(t) => bytemuck::cast_slice(t.data()),
            };
            let to = &mut slots[*slot][..words.len()];
            match version.layout {
                Layout::Planar => to.copy_from_slice(words),
                Layout::ChannelsLast => convert(&value.spec(), Layout::Planar, words, to),
            }
        }
        let inputs = (0..specs.len()).map(TensorId).filter(|id| given(*id)).collect();
        let names = graph.tensors().iter().map(|t| t.name.clone()).collect();
        Ok(Self {
            packs,
            steps,
            places,
            specs,
            names,
            inputs,
            slots,
            wanted,
            stages: graph.stages().to_vec(),
        })
    }

    /// Runs every kernel. Returns the outputs and the kept tensors, and the time by stage.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a missing or misshapen input, or what the kernels return.
    pub fn run(
        &mut self,
        graph: &Graph,
        inputs: &[(TensorId, &Value)],
    ) -> Result<(HashMap<TensorId, Value>, Vec<StageTime>)> {
        for id in &self.inputs {
            let Source::Input(extent) = graph.tensors()[id.0].source else { continue };
            let given = inputs.iter().find(|(i, _)| i == id).map(|(_, v)| v.spec());
            extent.check("cpu", &self.names[id.0], &self.specs[id.0], given)?;
        }
        let mut times: Vec<StageTime> = self
            .stages
            .iter()
            .map(|s| StageTime { stage: s.clone(), time: Duration::ZERO })
            .collect();
        let Self { steps, places, specs, slots, names, .. } = self;
        for step in steps.iter() {
            let start = Instant::now();
            // Outputs leave the table while they are written: no input shares a buffer with them.
            let mut written = Vec::with_capacity(step.outputs.len());
            for version in &step.outputs {
                if let Some(Place::Slot(slot)) = places.get(version) {
                    written.push((*slot, std::mem::take(&mut slots[*slot])));
                }
            }
            let read: Result<Vec<Data>> = step
                .inputs
                .iter()
                .map(|version| {
                    let Some(version) = version else { return Ok(Data::F32(&[])) };
                    let id = version.tensor;
                    let spec = &specs[id.0];
                    let missing = || Error::tensor("cpu", &names[id.0], spec, "nothing");
                    match places.get(version).ok_or_else(missing)? {
                        Place::Given => {
                            let value =
                                inputs.iter().find(|(i, _)| *i == id).ok_or_else(missing)?;
                            Ok(match value.1 {
                                Value::F32(t) => Data::F32(t.data()),
                                Value::U32(t) => Data::U32(t.data()),
                            })
                        }
                        Place::Slot(slot) => {
                            let words = &slots[*slot][..spec.shape.elements()];
                            Ok(match spec.dtype {
                                DType::F32 => Data::F32(words),
                                DType::U32 => Data::U32(bytemuck::cast_slice(words)),
                            })
                        }
                    }
                })
                .collect();
            let result = read.and_then(|read| {
                let mut to: Vec<&mut [f32]> = written
                    .iter_mut()
                    .zip(&step.outputs)
                    .map(|((_, words), v)| &mut words[..specs[v.tensor.0].shape.elements()])
                    .collect();
                match &step.work {
                    Work::Kernel(kernel) => kernel.run(&read, &mut to),
                    Work::Convert(from) => {
                        let spec = &specs[step.outputs[0].tensor.0];
                        convert(spec, *from, read[0].f32()?, to[0]);
                        Ok(())
                    }
                }
            });
            for (slot, words) in written {
                slots[slot] = words;
            }
            result?;
            times[step.stage].time += start.elapsed();
        }
        let mut values = HashMap::new();
        for version in &self.wanted {
            values.insert(version.tensor, self.value(*version)?);
        }
        Ok((values, times))
    }

    /// The tolerance of a plan of one operation, by its kernel.
    pub(super) fn tolerance(&self, inputs: &[&Value]) -> Result<Option<Vec<f64>>> {
        let kernels = self.steps.iter().filter_map(|step| match &step.work {
            Work::Kernel(kernel) => Some(kernel),
            Work::Convert(_) => None,
        });
        for kernel in kernels {
            if let Some(bounds) = kernel.tolerance(inputs)? {
                return Ok(Some(bounds));
            }
        }
        Ok(None)
    }

    /// Fills every buffer that a step writes with NaN, which shows where a kernel leaves one out.
    pub(super) fn poison(&mut self) {
        for version in self.steps.iter().flat_map(|step| &step.outputs) {
            if let Some(Place::Slot(slot)) = self.places.get(version) {
                self.slots[*slot].fill(f32::NAN);
            }
        }
    }

    /// A computed tensor as its shape says.
    fn value(&self, version: Version) -> Result<Value> {
        let spec = &self.specs[version.tensor.0];
        let Some(Place::Slot(slot)) = self.places.get(&version) else {
            let name = &self.names[version.tensor.0];
            return Err(Error::tensor("cpu", name, "a computed tensor", "an input"));
        };
        let words = &self.slots[*slot][..spec.shape.elements()];
        Ok(match (spec.dtype, version.layout) {
            (DType::U32, _) => {
                let words: &[u32] = bytemuck::cast_slice(words);
                Tensor::new(spec.shape.clone(), words.to_vec())?.into()
            }
            (DType::F32, Layout::Planar) => Tensor::new(spec.shape.clone(), words.to_vec())?.into(),
            (DType::F32, Layout::ChannelsLast) => {
                let mut planar = vec![0.0; words.len()];
                convert(spec, Layout::ChannelsLast, words, &mut planar);
                Tensor::new(spec.shape.clone(), planar)?.into()
            }
        })
    }
}

/// Collects the steps of a plan.
struct Builder<'a> {
    graph: &'a Graph,
    packs: &'a Packs,
    /// The layout in which each tensor is made.
    made: HashMap<TensorId, Layout>,
    steps: Vec<Step>,
}

/// Constants that no kernel packs, in the layout in which they are read.
type Constants = Vec<(Version, Arc<Value>)>;

impl Builder<'_> {
    fn add(&mut self, node: &crate::graph::Node, constants: &mut Constants) -> Result<()> {
        let spec = |id: &TensorId| self.graph.spec(*id).clone();
        let input_specs: Vec<_> = node.inputs.iter().map(spec).collect();
        let output_specs: Vec<_> = node.outputs.iter().map(spec).collect();
        let constant = |id: &TensorId| match &self.graph.tensors()[id.0].source {
            Source::Constant { constant, .. } => Some(constant),
            _ => None,
        };
        let known: Vec<Option<&Constant>> = node.inputs.iter().map(constant).collect();
        let (op, outputs) = (node.op.as_ref(), &output_specs);
        let name = node.inputs.get(1).map_or("", |id| self.graph.name(*id));
        let kernel = match super::kernel(op, &input_specs, outputs, &known, self.packs, name)? {
            Some(kernel) => kernel,
            None => Box::new(Reference::new(node.op.clone(), input_specs.clone())),
        };
        let mut inputs = Vec::new();
        for (index, id) in node.inputs.iter().enumerate() {
            let spec = &input_specs[index];
            let layout = match is_map(spec) {
                true => kernel.input_layout(index),
                false => Layout::Planar,
            };
            let version = Version { tensor: *id, layout };
            if kernel.packed().contains(&index) {
                inputs.push(None);
                continue;
            }
            match known[index] {
                Some(constant) => constants.push((version, constant.get()?)),
                None => self.convert(version, node.stage),
            }
            inputs.push(Some(version));
        }
        let outputs = node.outputs.iter().zip(&output_specs).map(|(id, spec)| {
            let layout = if is_map(spec) { kernel.output_layout() } else { Layout::Planar };
            Version { tensor: *id, layout }
        });
        let outputs: Vec<_> = outputs.collect();
        self.made.extend(outputs.iter().map(|v| (v.tensor, v.layout)));
        self.steps.push(Step { work: Work::Kernel(kernel), inputs, outputs, stage: node.stage });
        Ok(())
    }

    /// Puts a conversion if nothing made this version yet.
    fn convert(&mut self, to: Version, stage: usize) {
        // What the host gives is as its shape says.
        let made = self.made.get(&to.tensor).copied().unwrap_or(Layout::Planar);
        let there = made == to.layout || self.steps.iter().any(|s| s.outputs.contains(&to));
        if !there {
            let from = Version { tensor: to.tensor, layout: made };
            self.steps.push(Step {
                work: Work::Convert(from.layout),
                inputs: vec![Some(from)],
                outputs: vec![to],
                stage,
            });
        }
    }
}

/// Whether a tensor has channels and pixels.
fn is_map(spec: &TensorSpec) -> bool {
    spec.dtype == DType::F32 && super::kernel::map_sizes(spec).is_some()
}

/// Gives each version a place: what is dead leaves its buffer to the next that fits.
fn place(
    steps: &[Step],
    wanted: &[Version],
    specs: &[TensorSpec],
    given: impl Fn(TensorId) -> bool,
) -> (HashMap<Version, Place>, Vec<Vec<f32>>) {
    let mut last_use: HashMap<Version, usize> = HashMap::new();
    let mut made: HashMap<Version, usize> = HashMap::new();
    for (at, step) in steps.iter().enumerate() {
        last_use.extend(step.inputs.iter().flatten().map(|v| (*v, at)));
        made.extend(step.outputs.iter().map(|v| (*v, at)));
    }
    let mut places = HashMap::new();
    let mut sizes: Vec<usize> = Vec::new();
    let mut free: Vec<usize> = Vec::new();
    let mut take = |places: &mut HashMap<Version, Place>, free: &mut Vec<usize>, v: Version| {
        let need = specs[v.tensor.0].shape.elements();
        let best =
            (0..free.len()).filter(|i| sizes[free[*i]] >= need).min_by_key(|i| sizes[free[*i]]);
        let slot = match best {
            Some(at) => free.swap_remove(at),
            None => {
                sizes.push(need);
                sizes.len() - 1
            }
        };
        places.insert(v, Place::Slot(slot));
    };
    // Constants keep buffers of their own.
    for version in steps.iter().flat_map(|s| s.inputs.iter().flatten()) {
        if !made.contains_key(version) && !places.contains_key(version) {
            match given(version.tensor) {
                true => {
                    places.insert(*version, Place::Given);
                }
                false => take(&mut places, &mut Vec::new(), *version),
            }
        }
    }
    for (at, step) in steps.iter().enumerate() {
        for version in &step.outputs {
            take(&mut places, &mut free, *version);
        }
        let ended = step.inputs.iter().flatten().chain(&step.outputs);
        let mut dead: Vec<usize> = ended
            .filter(|v| made.contains_key(v) && !wanted.contains(v))
            .filter(|v| last_use.get(v).is_none_or(|last| *last == at))
            .filter_map(|v| match places.get(v) {
                Some(Place::Slot(slot)) => Some(*slot),
                _ => None,
            })
            .collect();
        dead.sort_unstable();
        dead.dedup();
        free.extend(dead);
    }
    (places, sizes.into_iter().map(|size| vec![0.0; size]).collect())
}
