//! A [`CpuPlan`]: a graph made ready to run on the CPU.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::kernel::{Data, Kernel, Layout, convert};
#[cfg(doc)]
use super::multiplies;
use super::packs::Packs;
use super::reference::Reference;
use super::select;
use super::words::Numbers;
use web_time::Instant;

use crate::engine::cores::Caller;
use crate::engine::graph::{Graph, Source, StageTime, TensorId};
use crate::engine::lifetimes::{self, Holds};
use crate::engine::lock::lock;
use crate::engine::precision::Precision;
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Constant, Tensor, Value};
use crate::error::{Error, Result};

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
    /// A constant.
    Kept(usize),
    /// A buffer.
    Slot(usize),
}

/// A run's buffers; integers lie in them as their bits.
type Slots = Vec<Vec<f32>>;

/// What a run reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Given<'a> {
    /// Tensors by their place in the graph.
    pub tensors: &'a [(TensorId, &'a Value)],
    /// The bytes of a picture, in place of its tensor.
    pub picture: Option<(TensorId, &'a [u8])>,
}

/// A graph with its weights packed. Runs at a time have buffers of their own, which stay for later ones.
pub struct CpuPlan {
    packs: Arc<Packs>,
    steps: Vec<Step>,
    places: HashMap<Version, Place>,
    specs: Vec<TensorSpec>,
    names: Vec<String>,
    inputs: Vec<TensorId>,
    /// What no kernel packs.
    constants: Vec<Vec<f32>>,
    /// Elements of each buffer.
    sizes: Vec<usize>,
    /// Buffers that no run uses.
    idle: Mutex<Vec<Slots>>,
    /// What is given back, each in the layout in which it is computed.
    wanted: Vec<Version>,
    stages: Vec<String>,
}

impl std::fmt::Debug for CpuPlan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CpuPlan({} steps, {} buffers)", self.steps.len(), self.sizes.len())
    }
}

impl CpuPlan {
    /// Packs the weights of `graph`. A run gives back its outputs and the tensors in `keep`. Weights that
    /// `like` has packed, a plan of the same weights, are shared. Products are of numbers rounded to
    /// `precision` where this CPU [`multiplies`] them and the kernel knows how; else all are in f32.
    ///
    /// # Errors
    /// What the kernels refuse.
    pub fn new(
        graph: &Graph,
        keep: &[TensorId],
        like: Option<&Self>,
        precision: Precision,
    ) -> Result<Self> {
        let numbers = Numbers::of(precision).unwrap_or(Numbers::F32);
        let packs = like.map_or_else(|| Arc::new(Packs::new(graph)), |plan| plan.packs.clone());
        let mut builder =
            Builder { graph, packs: &packs, numbers, made: HashMap::new(), steps: Vec::new() };
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
        let (places, kept, sizes) = place(&steps, &wanted, &specs, given);
        let mut kept: Vec<Vec<f32>> = kept.into_iter().map(|size| vec![0.0; size]).collect();
        for (version, value) in constants {
            let Some(Place::Kept(at)) = places.get(&version) else { continue };
            let words: &[f32] = match value.as_ref() {
                Value::F32(t) => t.data(),
                Value::U32(t) => bytemuck::cast_slice(t.data()),
            };
            let to = &mut kept[*at][..words.len()];
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
            constants: kept,
            sizes,
            idle: Mutex::default(),
            wanted,
            stages: graph.stages().to_vec(),
        })
    }

    /// Runs every kernel. Returns the outputs and the kept tensors, and the time by stage.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a missing or misshapen input, or what the kernels return.
    pub fn run(
        &self,
        graph: &Graph,
        tensors: &[(TensorId, &Value)],
    ) -> Result<(HashMap<TensorId, Value>, Vec<StageTime>)> {
        self.run_while(graph, Given { tensors, picture: None }, &|_| Ok(()))
    }

    /// [`CpuPlan::run`], which asks `go_on` before each kernel, with its stage, whether to go on.
    pub(crate) fn run_while(
        &self,
        graph: &Graph,
        given: Given,
        go_on: &dyn Fn(&str) -> Result<()>,
    ) -> Result<(HashMap<TensorId, Value>, Vec<StageTime>)> {
        let idle = lock(&self.idle).pop();
        let mut slots = idle.unwrap_or_else(|| self.sizes.iter().map(|n| vec![0.0; *n]).collect());
        let done = self.run_in(&mut slots, graph, given, go_on);
        lock(&self.idle).push(slots);
        done
    }

    fn run_in(
        &self,
        slots: &mut Slots,
        graph: &Graph,
        given: Given,
        go_on: &dyn Fn(&str) -> Result<()>,
    ) -> Result<(HashMap<TensorId, Value>, Vec<StageTime>)> {
        let Given { tensors: inputs, picture } = given;
        let bytes = |id: TensorId| picture.filter(|(i, _)| *i == id).map(|(_, bytes)| bytes);
        for id in &self.inputs {
            let Source::Input(extent) = graph.tensors()[id.0].source else { continue };
            let given = match bytes(*id) {
                Some(bytes) => Some(TensorSpec::u32([bytes.len().div_ceil(4)])),
                None => inputs.iter().find(|(i, _)| i == id).map(|(_, v)| v.spec()),
            };
            extent.check("cpu", &self.names[id.0], &self.specs[id.0], given)?;
        }
        let _caller = Caller::new();
        let mut times: Vec<StageTime> = self
            .stages
            .iter()
            .map(|s| StageTime { stage: s.clone(), time: Duration::ZERO })
            .collect();
        let Self { steps, places, specs, names, .. } = self;
        for step in steps {
            go_on(&self.stages[step.stage])?;
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
                            if let Some(bytes) = bytes(id) {
                                return Ok(Data::Bytes(bytes));
                            }
                            let value =
                                inputs.iter().find(|(i, _)| *i == id).ok_or_else(missing)?;
                            Ok(match value.1 {
                                Value::F32(t) => Data::F32(t.data()),
                                Value::U32(t) => Data::U32(t.data()),
                            })
                        }
                        Place::Kept(at) => Ok(read(spec, &self.constants[*at])),
                        Place::Slot(slot) => Ok(read(spec, &slots[*slot])),
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
            values.insert(version.tensor, self.value(slots, *version)?);
        }
        Ok((values, times))
    }

    /// The kernel of an operation, by its place in the graph.
    fn kernel(&self, node: usize) -> Option<&dyn Kernel> {
        // Each operation has one.
        let mut kernels = self.steps.iter().filter_map(|step| match &step.work {
            Work::Kernel(kernel) => Some(kernel.as_ref()),
            Work::Convert(_) => None,
        });
        kernels.nth(node)
    }

    /// The tolerance of an operation by its kernel; `None` where it is the operation's own.
    ///
    /// # Errors
    /// As the operation's reference.
    pub(crate) fn tolerance(&self, node: usize, inputs: &[&Value]) -> Result<Option<Vec<f64>>> {
        self.kernel(node).map_or(Ok(None), |kernel| kernel.tolerance(inputs))
    }

    /// What an operation's kernel multiplies.
    pub(crate) fn precision(&self, node: usize) -> Precision {
        self.kernel(node).map_or(Precision::F32, Kernel::precision)
    }

    /// Gives the next run buffers full of NaN, which shows what a kernel leaves out.
    pub(crate) fn poison(&self) {
        lock(&self.idle).push(self.sizes.iter().map(|n| vec![f32::NAN; *n]).collect());
    }

    /// A computed tensor as its shape says.
    fn value(&self, slots: &Slots, version: Version) -> Result<Value> {
        let spec = &self.specs[version.tensor.0];
        let Some(Place::Slot(slot)) = self.places.get(&version) else {
            let name = &self.names[version.tensor.0];
            return Err(Error::tensor("cpu", name, "a computed tensor", "an input"));
        };
        let words = &slots[*slot][..spec.shape.elements()];
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
    numbers: Numbers,
    /// The layout in which each tensor is made.
    made: HashMap<TensorId, Layout>,
    steps: Vec<Step>,
}

/// Constants that no kernel packs, in the layout in which they are read.
type Constants = Vec<(Version, Arc<Value>)>;

impl Builder<'_> {
    fn add(&mut self, node: &crate::engine::graph::Node, constants: &mut Constants) -> Result<()> {
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
        let packs = (self.packs, self.numbers);
        let kernel = match select::kernel(op, &input_specs, outputs, &known, packs, name)? {
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

/// A tensor of this shape, at the beginning of `words`.
fn read<'a>(spec: &TensorSpec, words: &'a [f32]) -> Data<'a> {
    let words = &words[..spec.shape.elements()];
    match spec.dtype {
        DType::F32 => Data::F32(words),
        DType::U32 => Data::U32(bytemuck::cast_slice(words)),
    }
}

/// Whether a tensor has channels and pixels.
fn is_map(spec: &TensorSpec) -> bool {
    spec.dtype == DType::F32 && super::kernel::map_sizes(spec).is_some()
}

/// A buffer of so many elements.
#[derive(Clone, Copy, Debug)]
struct Elements(usize);

impl Holds for Elements {
    fn bytes(&self) -> u64 {
        4 * self.0 as u64
    }

    fn union(self, other: Self) -> Option<Self> {
        Some(Self(self.0.max(other.0)))
    }
}

/// Gives each version a place, and says how many elements constants and buffers have.
fn place(
    steps: &[Step],
    wanted: &[Version],
    specs: &[TensorSpec],
    given: impl Fn(TensorId) -> bool,
) -> (HashMap<Version, Place>, Vec<usize>, Vec<usize>) {
    let elements = |version: &Version| specs[version.tensor.0].shape.elements();
    let made: Vec<Version> = steps.iter().flat_map(|step| &step.outputs).copied().collect();
    let ids: HashMap<Version, usize> = made.iter().enumerate().map(|(id, v)| (*v, id)).collect();
    let needs: Vec<Elements> = made.iter().map(|version| Elements(elements(version))).collect();
    let used = |step: &Step| -> Vec<usize> {
        let versions = step.outputs.iter().chain(step.inputs.iter().flatten());
        versions.filter_map(|version| ids.get(version).copied()).collect()
    };
    let used: Vec<Vec<usize>> = steps.iter().map(used).collect();
    let shared = lifetimes::assign(&needs, &used, |id| !wanted.contains(&made[id]));
    let slots = made.iter().zip(&shared.slot);
    let mut places: HashMap<Version, Place> =
        slots.filter_map(|(version, slot)| Some((*version, Place::Slot((*slot)?)))).collect();
    let mut kept = Vec::new();
    for version in steps.iter().flat_map(|step| step.inputs.iter().flatten()) {
        places.entry(*version).or_insert_with(|| match given(version.tensor) {
            true => Place::Given,
            false => {
                kept.push(elements(version));
                Place::Kept(kept.len() - 1)
            }
        });
    }
    (places, kept, shared.storage.iter().map(|slot| slot.0).collect())
}
