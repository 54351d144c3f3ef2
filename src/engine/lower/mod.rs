//! From a graph to what a device is told to do, in passes.
//!
//! | pass | what it does |
//! |---|---|
//! | `live` | leaves out operations on which nothing depends that is asked for |
//! | [`KernelChoice`] | a kernel for each operation, by adapter, shape and measurement |
//! | `layouts` | conversions between kernels that write and read differently |
//! | `grids` | workgroups of dispatches over as many rows as a count on the device says |
//! | [`storage`] | which tensors share what holds them |

mod grids;
pub mod kernel_choice;
pub mod storage;

use std::collections::{HashMap, HashSet};

use crate::engine::graph::{Graph, Node, Source, TensorId};
use crate::engine::kernels::{Caps, Convert, Kernel, Layout, Recording, Role, Work};
use crate::engine::precision::Precision;
use crate::engine::shape::TensorSpec;
use crate::error::Result;

pub use kernel_choice::KernelChoice;

/// A graph made ready for a device: the commands, and where the graph's tensors went.
#[derive(Debug)]
pub struct Lowered {
    /// Commands over tensors of its own.
    pub(crate) recording: Recording,
    /// The recording's tensor for each input of the graph and each tensor that is read back.
    pub(crate) places: HashMap<TensorId, TensorId>,
    /// What was asked for.
    pub(crate) precision: Precision,
    /// The kernel of each operation that runs, in order.
    pub(crate) kernels: Vec<&'static str>,
    /// For each command, which of the graph's operations it is for: conversions belong to the one that
    /// reads.
    pub(crate) owners: Vec<usize>,
}

impl Lowered {
    /// How a tensor of the graph is stored, if it is given or read back.
    pub(crate) fn stored(&self, id: TensorId) -> Precision {
        let place = self.places.get(&id);
        place.map_or(Precision::F32, |place| self.recording.info(*place).precision)
    }
}

/// What is asked of a lowering.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// Tensors to be read back beside the graph's outputs.
    pub keep: &'a [TensorId],
    /// Pictures at a time.
    pub batch: u32,
    /// How maps and weights are stored. A map that some kernel reads planar stays in f32: so do all from
    /// which scores and boxes are made.
    pub precision: Precision,
    /// The adapter.
    pub caps: &'a Caps,
    /// Which kernel runs what.
    pub kernels: &'a KernelChoice,
}

/// Lowers a graph.
///
/// # Errors
/// What the kernels return.
pub fn lower(graph: &Graph, request: &Request) -> Result<Lowered> {
    let wanted: Vec<TensorId> = graph.outputs().iter().chain(request.keep).copied().collect();
    let live = live(graph, &wanted);
    let mut layouts = Layouts {
        graph,
        recording: Recording::new(request.batch, request.precision, request.caps.clone()),
        versions: HashMap::new(),
        planar: HashSet::new(),
    };
    // Inputs are part of every run, whether or not something reads them.
    for (index, tensor) in graph.tensors().iter().enumerate() {
        if matches!(tensor.source, Source::Input(_)) {
            layouts.declare(TensorId(index));
        }
    }
    let (mut kernels, mut owners) = (Vec::new(), Vec::new());
    let Request { batch, precision, caps, .. } = *request;
    let mut chosen = HashMap::new();
    visit(graph, &live, (batch, precision, caps), |work| {
        let kernel = request.kernels.kernel(work)?;
        chosen.insert(work.node, kernel);
        let inputs = graph.nodes()[work.node].inputs.iter().enumerate();
        let planar = inputs.filter(|(index, _)| kernel.reads(work, *index) == Layout::Planar);
        layouts.planar.extend(planar.map(|(_, id)| *id));
        Ok(())
    })?;
    visit(graph, &live, (batch, precision, caps), |work| {
        let kernel = chosen[&work.node];
        let node = &graph.nodes()[work.node];
        layouts.recording.begin_stage(&graph.stages()[node.stage]);
        kernels.push(kernel.id());
        layouts.record(node, kernel, work)?;
        owners.resize(layouts.recording.commands().len(), work.node);
        Ok(())
    })?;
    let mut places = HashMap::new();
    for (index, tensor) in graph.tensors().iter().enumerate() {
        let id = TensorId(index);
        let asked = wanted.contains(&id);
        if !asked && !matches!(tensor.source, Source::Input(_)) {
            continue;
        }
        let Some(place) = layouts.readable(id) else { continue };
        if asked {
            layouts.recording.mark_output(place);
        }
        places.insert(id, place);
    }
    grids::tabulate(&mut layouts.recording, &mut owners);
    Ok(Lowered { recording: layouts.recording, places, precision, kernels, owners })
}

/// Calls `each` with every operation on which an output of `graph` depends, in order: for so many
/// pictures at a time, in a precision, on an adapter.
///
/// # Errors
/// What `each` returns.
pub fn works(
    graph: &Graph,
    of: (u32, Precision, &Caps),
    each: impl FnMut(&Work) -> Result<()>,
) -> Result<()> {
    visit(graph, &live(graph, graph.outputs()), of, each)
}

fn visit(
    graph: &Graph,
    live: &[bool],
    (batch, precision, caps): (u32, Precision, &Caps),
    mut each: impl FnMut(&Work) -> Result<()>,
) -> Result<()> {
    let specs = |ids: &[TensorId]| -> Vec<TensorSpec> {
        ids.iter().map(|id| graph.spec(*id).clone()).collect()
    };
    let constant = |id: &TensorId| matches!(graph.tensors()[id.0].source, Source::Constant { .. });
    for (index, node) in graph.nodes().iter().enumerate().filter(|(index, _)| live[*index]) {
        let (inputs, outputs) = (specs(&node.inputs), specs(&node.outputs));
        let known: Vec<bool> = node.inputs.iter().map(constant).collect();
        let op = node.op.as_ref();
        let (inputs, known, outputs) = (&inputs[..], &known[..], &outputs[..]);
        each(&Work { node: index, op, inputs, known, outputs, batch, precision, caps })?;
    }
    Ok(())
}

/// For each operation, whether something that is wanted depends on it.
fn live(graph: &Graph, wanted: &[TensorId]) -> Vec<bool> {
    let mut needed = vec![false; graph.tensors().len()];
    wanted.iter().for_each(|id| needed[id.0] = true);
    let mut live = vec![false; graph.nodes().len()];
    for (index, node) in graph.nodes().iter().enumerate().rev() {
        if node.outputs.iter().any(|id| needed[id.0]) {
            live[index] = true;
            node.inputs.iter().for_each(|id| needed[id.0] = true);
        }
    }
    live
}

/// The pass that places conversions: each tensor of the graph in the layouts that were needed so far.
struct Layouts<'a> {
    graph: &'a Graph,
    recording: Recording,
    versions: HashMap<(TensorId, Layout, Precision), TensorId>,
    /// Tensors that some kernel reads planar.
    planar: HashSet<TensorId>,
}

impl Layouts<'_> {
    /// The tensor of an input or a constant of the graph.
    fn declare(&mut self, id: TensorId) -> TensorId {
        if let Some(place) = self.versions.get(&(id, Layout::Planar, Precision::F32)) {
            return *place;
        }
        let tensor = &self.graph.tensors()[id.0];
        let role = match &tensor.source {
            Source::Input(extent) => Role::Input(*extent),
            Source::Constant { constant, .. } => Role::Constant(constant.clone()),
            Source::Computed => Role::Transient,
        };
        let place = self.recording.tensor(&tensor.name, tensor.spec.clone(), role);
        self.versions.insert((id, Layout::Planar, Precision::F32), place);
        place
    }

    /// A tensor of the graph in a layout; converts it where it does not lie so yet.
    fn version(&mut self, id: TensorId, layout: Layout, precision: Precision) -> Result<TensorId> {
        let precision = if layout == Layout::Planar { Precision::F32 } else { precision };
        if let Some(place) = self.versions.get(&(id, layout, precision)) {
            return Ok(*place);
        }
        let computed = matches!(self.graph.tensors()[id.0].source, Source::Computed);
        if !computed && layout == Layout::Planar {
            return Ok(self.declare(id));
        }
        // One step before: a texture is copied from quads, the others come from each other. What is
        // read planar was not written in f16.
        let before = match layout {
            Layout::Texture => self.version(id, Layout::Quads, precision)?,
            Layout::Quads => self.version(id, Layout::Planar, Precision::F32)?,
            Layout::Planar => self.version(id, Layout::Quads, Precision::F32)?,
        };
        let (name, spec) = (self.graph.name(id).to_owned(), self.graph.spec(id).clone());
        let place = self.recording.map(name, spec, layout, precision)?;
        Convert::record(&mut self.recording, before, place)?;
        self.versions.insert((id, layout, precision), place);
        Ok(place)
    }

    fn record(&mut self, node: &Node, kernel: &dyn Kernel, work: &Work) -> Result<()> {
        let inputs = node.inputs.iter().enumerate();
        let inputs: Vec<TensorId> = inputs
            .map(|(index, id)| self.version(*id, kernel.reads(work, index), work.precision))
            .collect::<Result<_>>()?;
        let layout = kernel.writes(work);
        let mut outputs = Vec::with_capacity(node.outputs.len());
        for id in &node.outputs {
            let (name, spec) = (self.graph.name(*id).to_owned(), self.graph.spec(*id).clone());
            let precision = match layout {
                Layout::Planar => Precision::F32,
                _ if self.planar.contains(id) => Precision::F32,
                _ => work.precision,
            };
            let place = self.recording.map(name, spec, layout, precision)?;
            self.versions.insert((*id, layout, precision), place);
            outputs.push(place);
        }
        let first = self.recording.commands().len();
        kernel.record(work, &mut self.recording, (&inputs, &outputs))?;
        if !kernel.batched() {
            self.recording.for_each_picture(first);
        }
        Ok(())
    }

    /// A version of a tensor that the host can read.
    fn readable(&self, id: TensorId) -> Option<TensorId> {
        let places = [
            (Layout::Planar, Precision::F32),
            (Layout::Quads, Precision::F32),
            (Layout::Quads, Precision::F16),
        ];
        places.iter().find_map(|(l, p)| self.versions.get(&(id, *l, *p)).copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::ops::{MaxPool2d, NotFinite};
    use crate::engine::shape::Extent;

    /// Of two maps in a row, the second is looked at element by element.
    #[test]
    fn what_is_read_planar_is_written_in_f32() {
        let mut graph = Graph::default();
        let input = graph.input("input", TensorSpec::f32([4, 8, 8]), Extent::Exact);
        let pool = MaxPool2d { kernel: 3, stride: 1, padding: 1 };
        let first = graph.apply1("first", pool, &[input]).expect("a map");
        let second = graph.apply1("second", pool, &[first]).expect("a map");
        let counts = graph.apply1("counts", NotFinite::default(), &[second]).expect("counts");
        graph.mark_output(counts);
        let (caps, kernels, keep) = (Caps::default(), KernelChoice::default(), [first, second]);
        let stored = |precision| {
            let request =
                Request { keep: &keep, batch: 1, precision, caps: &caps, kernels: &kernels };
            let lowered = lower(&graph, &request).expect("kernels for both");
            keep.map(|id| lowered.stored(id))
        };
        assert_eq!(stored(Precision::F16), [Precision::F16, Precision::F32]);
        assert_eq!(stored(Precision::F32), [Precision::F32; 2]);
    }
}
