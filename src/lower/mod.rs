//! From a graph to what a device is told to do, in passes.
//!
//! | pass | what it does |
//! |---|---|
//! | `live` | leaves out operations on which nothing depends that is asked for |
//! | [`Choice`] | a kernel for each operation, by adapter, shape and measurement |
//! | `layouts` | conversions between kernels that write and read differently |
//! | [`lifetimes`] | which tensors share what holds them |

pub mod choice;
pub mod lifetimes;

use std::collections::HashMap;

use crate::error::Result;
use crate::graph::{Graph, Node, Source, TensorId};
use crate::kernels::{Caps, Convert, Kernel, Layout, Recording, Role, Work};
use crate::shape::TensorSpec;

pub use choice::Choice;

/// A graph made ready for a device: the commands, and where the graph's tensors went.
#[derive(Debug)]
pub struct Lowered {
    /// Commands over tensors of its own.
    pub(crate) recording: Recording,
    /// The recording's tensor for each input of the graph and each tensor that is read back.
    pub(crate) places: HashMap<TensorId, TensorId>,
    /// The kernel of each operation that runs, in order.
    pub(crate) kernels: Vec<&'static str>,
    /// For each command, which of the graph's operations it is for: conversions belong to the one that
    /// reads.
    pub(crate) owners: Vec<usize>,
}

/// What is asked of a lowering.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// Tensors to be read back beside the graph's outputs.
    pub keep: &'a [TensorId],
    /// Pictures at a time.
    pub batch: u32,
    /// The adapter.
    pub caps: &'a Caps,
    /// Which kernel runs what.
    pub choice: &'a Choice,
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
        recording: Recording::new(request.batch, request.caps.clone()),
        versions: HashMap::new(),
    };
    // Inputs are part of every run, whether or not something reads them.
    for (index, tensor) in graph.tensors().iter().enumerate() {
        if matches!(tensor.source, Source::Input(_)) {
            layouts.declare(TensorId(index));
        }
    }
    let (mut kernels, mut owners) = (Vec::new(), Vec::new());
    visit(graph, &live, request.batch, request.caps, |work| {
        let kernel = request.choice.kernel(work)?;
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
    Ok(Lowered { recording: layouts.recording, places, kernels, owners })
}

/// Calls `each` with every operation on which an output of `graph` depends, in order.
///
/// # Errors
/// What `each` returns.
pub fn works(
    graph: &Graph,
    batch: u32,
    caps: &Caps,
    each: impl FnMut(&Work) -> Result<()>,
) -> Result<()> {
    visit(graph, &live(graph, graph.outputs()), batch, caps, each)
}

fn visit(
    graph: &Graph,
    live: &[bool],
    batch: u32,
    caps: &Caps,
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
        each(&Work { node: index, op, inputs, known, outputs, batch, caps })?;
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
    versions: HashMap<(TensorId, Layout), TensorId>,
}

impl Layouts<'_> {
    /// The tensor of an input or a constant of the graph.
    fn declare(&mut self, id: TensorId) -> TensorId {
        if let Some(place) = self.versions.get(&(id, Layout::Planar)) {
            return *place;
        }
        let tensor = &self.graph.tensors()[id.0];
        let role = match &tensor.source {
            Source::Input(extent) => Role::Input(*extent),
            Source::Constant { constant, .. } => Role::Constant(constant.clone()),
            Source::Computed => Role::Transient,
        };
        let place = self.recording.tensor(&tensor.name, tensor.spec.clone(), role);
        self.versions.insert((id, Layout::Planar), place);
        place
    }

    /// A tensor of the graph in a layout; converts it where it does not lie so yet.
    fn version(&mut self, id: TensorId, layout: Layout) -> Result<TensorId> {
        if let Some(place) = self.versions.get(&(id, layout)) {
            return Ok(*place);
        }
        let computed = matches!(self.graph.tensors()[id.0].source, Source::Computed);
        if !computed && layout == Layout::Planar {
            return Ok(self.declare(id));
        }
        // One step before: a texture is copied from quads, the others come from each other.
        let before = match layout {
            Layout::Texture => self.version(id, Layout::Quads)?,
            Layout::Quads => self.version(id, Layout::Planar)?,
            Layout::Planar => self.version(id, Layout::Quads)?,
        };
        let (name, spec) = (self.graph.name(id).to_owned(), self.graph.spec(id).clone());
        let place = self.recording.map(name, spec, layout)?;
        Convert::record(&mut self.recording, before, place)?;
        self.versions.insert((id, layout), place);
        Ok(place)
    }

    fn record(&mut self, node: &Node, kernel: &dyn Kernel, work: &Work) -> Result<()> {
        let inputs = node.inputs.iter().enumerate();
        let inputs: Vec<TensorId> = inputs
            .map(|(index, id)| self.version(*id, kernel.reads(work, index)))
            .collect::<Result<_>>()?;
        let layout = kernel.writes(work);
        let mut outputs = Vec::with_capacity(node.outputs.len());
        for id in &node.outputs {
            let (name, spec) = (self.graph.name(*id).to_owned(), self.graph.spec(*id).clone());
            let place = self.recording.map(name, spec, layout)?;
            self.versions.insert((*id, layout), place);
            outputs.push(place);
        }
        let first = self.recording.commands().len();
        kernel.record(work, &mut self.recording, &inputs, &outputs)?;
        if !kernel.batched() {
            self.recording.for_each_picture(first);
        }
        Ok(())
    }

    /// A version of a tensor that the host can read.
    fn readable(&self, id: TensorId) -> Option<TensorId> {
        let found = [Layout::Planar, Layout::Quads].map(|l| self.versions.get(&(id, l)).copied());
        found[0].or(found[1])
    }
}
