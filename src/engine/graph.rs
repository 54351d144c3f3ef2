//! The network as data: operations over named tensors, run by either executor.
//!
//! The same graph is recorded for the GPU and walked on the CPU with the references, so the two
//! cannot drift apart.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use web_time::Instant;

use crate::engine::ops::Op;
use crate::engine::shape::{Extent, TensorSpec};
use crate::engine::tensor::{Constant, Value};
use crate::error::{Error, Result};

/// Index of a tensor in a [`Graph`], or in what a graph was lowered to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TensorId(pub usize);

/// The values of a run, with the graph's shapes.
pub type Values = HashMap<TensorId, Value>;

/// Time that one stage took.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StageTime {
    /// Stage name.
    pub stage: String,
    /// Time on the device; serialised as `ms`.
    #[cfg_attr(feature = "serde", serde(rename = "ms", with = "crate::engine::milliseconds"))]
    pub time: Duration,
}

/// One operation with what it reads and writes.
#[derive(Debug)]
pub(crate) struct Node {
    pub op: Arc<dyn Op>,
    pub inputs: Vec<TensorId>,
    pub outputs: Vec<TensorId>,
    /// Its stage's place in [`Graph::stages`].
    pub stage: usize,
}

#[derive(Debug)]
pub(crate) struct GraphTensor {
    pub name: String,
    pub spec: TensorSpec,
    pub source: Source,
}

/// Where a tensor's values come from.
#[derive(Debug)]
pub(crate) enum Source {
    /// The host, for each run.
    Input(Extent),
    /// Known now. The values stay once the references have asked for them.
    Constant { constant: Constant, kept: OnceLock<Arc<Value>> },
    /// A node.
    Computed,
}

/// What one operation read and wrote in a run.
#[derive(Debug)]
pub struct Step<'a> {
    /// The operation.
    pub op: &'a dyn Op,
    /// The place of its stage in [`Graph::stages`].
    pub stage: usize,
    /// The tensors that it read.
    pub inputs: &'a [TensorId],
    /// Their values.
    pub read: Vec<&'a Value>,
    /// The tensors that it wrote.
    pub outputs: &'a [TensorId],
    /// Their values.
    pub wrote: Vec<&'a Value>,
}

/// Operations over tensors, in an order in which each reads only what came before.
#[derive(Default)]
pub struct Graph {
    tensors: Vec<GraphTensor>,
    nodes: Vec<Node>,
    stages: Vec<String>,
    outputs: Vec<TensorId>,
}

impl fmt::Debug for Graph {
    /// A line: how much there is.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tensors, nodes, stages, .. } = self;
        let (nodes, stages, tensors) = (nodes.len(), stages.len(), tensors.len());
        write!(f, "Graph({nodes} operations in {stages} stages, {tensors} tensors)")
    }
}

impl Graph {
    fn push(&mut self, name: impl Into<String>, spec: TensorSpec, source: Source) -> TensorId {
        self.tensors.push(GraphTensor { name: name.into(), spec, source });
        TensorId(self.tensors.len() - 1)
    }

    /// A tensor that the host gives for each run, as much of it as `extent` says.
    pub fn input(&mut self, name: &str, spec: TensorSpec, extent: Extent) -> TensorId {
        self.push(name, spec, Source::Input(extent))
    }

    /// A tensor that is known now, such as weights. What is made of it is shared by its name, which is to be its
    /// own.
    pub fn constant(&mut self, name: impl Into<String>, value: impl Into<Constant>) -> TensorId {
        let constant = value.into();
        let spec = constant.spec().clone();
        self.push(name, spec, Source::Constant { constant, kept: OnceLock::new() })
    }

    /// Starts a stage: the unit of timing.
    pub fn begin_stage(&mut self, name: &str) {
        self.stages.push(name.into());
    }

    /// Applies `op`; its outputs are called `name` if there is one, else `name.output`.
    ///
    /// # Errors
    /// What [`Op::infer`] returns; [`Error::Tensor`] for a constant of another's name.
    pub fn apply(
        &mut self,
        name: &str,
        op: impl Op + 'static,
        inputs: &[TensorId],
    ) -> Result<Vec<TensorId>> {
        self.apply_shared(name, Arc::new(op), inputs)
    }

    /// [`Graph::apply`] for an operation that others hold too.
    ///
    /// # Errors
    /// As [`Graph::apply`].
    pub fn apply_shared(
        &mut self,
        name: &str,
        op: Arc<dyn Op>,
        inputs: &[TensorId],
    ) -> Result<Vec<TensorId>> {
        let specs: Vec<_> = inputs.iter().map(|id| self.spec(*id).clone()).collect();
        let out_specs = op.infer(&specs)?;
        inputs.iter().try_for_each(|id| self.check_name(op.name(), *id))?;
        let names = op.outputs();
        let single = names.len() == 1;
        let outputs: Vec<_> = out_specs
            .into_iter()
            .zip(names)
            .map(|(spec, n)| {
                let full = if single { name.to_owned() } else { format!("{name}.{n}") };
                self.push(full, spec, Source::Computed)
            })
            .collect();
        if self.stages.is_empty() {
            self.begin_stage("all");
        }
        self.nodes.push(Node {
            op,
            inputs: inputs.to_vec(),
            outputs: outputs.clone(),
            stage: self.stages.len() - 1,
        });
        Ok(outputs)
    }

    /// Checks that a constant has a name of its own.
    fn check_name(&self, op: &str, id: TensorId) -> Result<()> {
        let is_constant =
            |place: usize| matches!(self.tensors[place].source, Source::Constant { .. });
        let name = self.name(id);
        let another = |(place, tensor): (usize, &GraphTensor)| {
            place != id.0 && is_constant(place) && tensor.name == name
        };
        if is_constant(id.0) && self.tensors.iter().enumerate().any(another) {
            return Err(Error::tensor(op, name, "one constant of this name", "another"));
        }
        Ok(())
    }

    /// [`Graph::apply`] for an operation with one output.
    ///
    /// # Errors
    /// As [`Graph::apply`], and [`Error::Tensor`] if there is not exactly one output.
    pub fn apply1(
        &mut self,
        name: &str,
        op: impl Op + 'static,
        inputs: &[TensorId],
    ) -> Result<TensorId> {
        let outputs = self.apply(name, op, inputs)?;
        match outputs[..] {
            [only] => Ok(only),
            _ => Err(Error::tensor("graph", name, "one output", outputs.len())),
        }
    }

    /// Gives a tensor the name under which dumps list it.
    pub fn rename(&mut self, id: TensorId, name: &str) {
        self.tensors[id.0].name = name.into();
    }

    /// Marks a tensor to be read back after each run.
    pub fn mark_output(&mut self, id: TensorId) {
        self.outputs.push(id);
    }

    /// Shape and element type of a tensor.
    pub fn spec(&self, id: TensorId) -> &TensorSpec {
        &self.tensors[id.0].spec
    }

    /// Name of a tensor.
    pub fn name(&self, id: TensorId) -> &str {
        &self.tensors[id.0].name
    }

    /// Forgets how to make the values of the constants, where they are on a device for good: only what
    /// was lowered already can run.
    pub(crate) fn forget_constants(&mut self) {
        for tensor in &mut self.tensors {
            if let Source::Constant { constant, kept } = &mut tensor.source {
                let name = tensor.name.clone();
                *constant = Constant::made(constant.spec().clone(), move || {
                    Err(Error::tensor("graph", &name, "a constant", "one that was forgotten"))
                });
                *kept = OnceLock::new();
            }
        }
    }

    /// Makes the values of the constants and keeps them, as the references need them.
    ///
    /// # Errors
    /// What making them returns.
    pub fn keep_constants(&self) -> Result<()> {
        for tensor in &self.tensors {
            if let Source::Constant { constant, kept } = &tensor.source
                && kept.get().is_none()
            {
                kept.get_or_init({
                    let value = constant.get()?;
                    || value
                });
            }
        }
        Ok(())
    }

    /// Runs the references. Returns the outputs and the tensors in `keep`, and the time by stage.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a missing or misshapen input, or what the operations return.
    pub fn reference(
        &self,
        inputs: &[(TensorId, &Value)],
        keep: &[TensorId],
    ) -> Result<(HashMap<TensorId, Value>, Vec<StageTime>)> {
        self.reference_with(inputs, keep, |_, _| ())
    }

    /// [`Graph::reference`], in which `alter` may change what was computed before it is read: so tests
    /// plant faults.
    pub(crate) fn reference_with(
        &self,
        inputs: &[(TensorId, &Value)],
        keep: &[TensorId],
        mut alter: impl FnMut(TensorId, &mut Value),
    ) -> Result<(HashMap<TensorId, Value>, Vec<StageTime>)> {
        self.keep_constants()?;
        for (index, tensor) in self.tensors.iter().enumerate() {
            let Source::Input(extent) = tensor.source else { continue };
            let given = inputs.iter().find(|(id, _)| id.0 == index).map(|(_, v)| v.spec());
            extent.check("reference", &tensor.name, &tensor.spec, given)?;
        }
        let mut values: HashMap<TensorId, Value> = HashMap::new();
        let mut last_use = vec![0; self.tensors.len()];
        for (step, node) in self.nodes.iter().enumerate() {
            for id in &node.inputs {
                last_use[id.0] = step;
            }
        }
        let wanted = |id: &TensorId| self.outputs.contains(id) || keep.contains(id);
        let mut times: Vec<StageTime> = self
            .stages
            .iter()
            .map(|s| StageTime { stage: s.clone(), time: Duration::ZERO })
            .collect();
        for (step, node) in self.nodes.iter().enumerate() {
            let start = Instant::now();
            let mut read = Vec::with_capacity(node.inputs.len());
            for id in &node.inputs {
                read.push(self.value(*id, inputs, &values).ok_or_else(|| {
                    Error::tensor(node.op.name(), self.name(*id), "a value", "nothing yet")
                })?);
            }
            let produced = node.op.reference(&read)?;
            for (id, mut value) in node.outputs.iter().zip(produced) {
                alter(*id, &mut value);
                values.insert(*id, value);
            }
            for id in &node.inputs {
                if last_use[id.0] == step && !wanted(id) {
                    values.remove(id);
                }
            }
            times[node.stage].time += start.elapsed();
        }
        values.retain(|id, _| wanted(id));
        Ok((values, times))
    }

    /// A tensor's value in a run: known now, given, or computed so far.
    fn value<'a>(
        &'a self,
        id: TensorId,
        inputs: &[(TensorId, &'a Value)],
        computed: &'a HashMap<TensorId, Value>,
    ) -> Option<&'a Value> {
        match &self.tensors[id.0].source {
            Source::Constant { kept, .. } => kept.get().map(Arc::as_ref),
            Source::Input(_) => inputs.iter().find(|(i, _)| *i == id).map(|(_, v)| *v),
            Source::Computed => computed.get(&id),
        }
    }

    /// Goes through a run that took `inputs` and computed `values`, operation by operation. The values
    /// have the graph's shapes: not cut by [`Graph::truncate`].
    ///
    /// # Errors
    /// [`Error::Tensor`] for a step of which a tensor is missing.
    pub fn steps<'a>(
        &'a self,
        inputs: &'a [(TensorId, &'a Value)],
        values: &'a HashMap<TensorId, Value>,
    ) -> impl Iterator<Item = Result<Step<'a>>> {
        self.nodes.iter().map(move |node| {
            let value = |id: &TensorId| {
                self.value(*id, inputs, values).ok_or_else(|| {
                    Error::tensor(node.op.name(), self.name(*id), "a value", "nothing")
                })
            };
            Ok(Step {
                op: node.op.as_ref(),
                stage: node.stage,
                inputs: &node.inputs,
                read: node.inputs.iter().map(value).collect::<Result<_>>()?,
                outputs: &node.outputs,
                wrote: node.outputs.iter().map(value).collect::<Result<_>>()?,
            })
        })
    }

    /// Cuts the `values` of a run to the rows that counts of that run made valid. A tensor stays whole
    /// where `values` does not hold all that its operation reads and writes.
    pub fn truncate(&self, inputs: &[(TensorId, &Value)], values: &mut HashMap<TensorId, Value>) {
        let mut valid = Vec::new();
        for node in &self.nodes {
            let value = |id: &TensorId| self.value(*id, inputs, values);
            let read: Option<Vec<&Value>> = node.inputs.iter().map(value).collect();
            let wrote: Option<Vec<&Value>> = node.outputs.iter().map(value).collect();
            let (Some(read), Some(wrote)) = (read, wrote) else { continue };
            for (id, elements) in node.outputs.iter().zip(node.op.defined(&wrote, &read)) {
                let row: usize = self.spec(*id).shape.0.iter().skip(1).product();
                valid.push((*id, elements / row.max(1)));
            }
        }
        for (id, rows) in valid {
            if let Some(value) = values.get_mut(&id) {
                value.truncate(rows);
            }
        }
    }

    /// The operations, in order.
    pub(crate) fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The tensors, by id.
    pub(crate) fn tensors(&self) -> &[GraphTensor] {
        &self.tensors
    }

    /// The tensors that a run gives back.
    pub(crate) fn outputs(&self) -> &[TensorId] {
        &self.outputs
    }

    /// Each operation with the specs of what it reads, in order.
    pub fn operations(&self) -> impl Iterator<Item = (&dyn Op, Vec<&TensorSpec>)> {
        let specs = |n: &Node| n.inputs.iter().map(|id| self.spec(*id)).collect();
        self.nodes.iter().map(move |n| (n.op.as_ref(), specs(n)))
    }

    /// Multiplications that the operations ask for, as [`Op::multiply_adds`] counts them.
    pub(crate) fn multiply_adds(&self) -> u64 {
        let specs =
            |ids: &[TensorId]| -> Vec<_> { ids.iter().map(|id| self.spec(*id).clone()).collect() };
        let of = |node: &Node| node.op.multiply_adds(&specs(&node.inputs), &specs(&node.outputs));
        self.nodes.iter().map(of).fold(0, u64::saturating_add)
    }

    /// The names of the stages, in order.
    pub fn stages(&self) -> &[String] {
        &self.stages
    }

    /// The tensors that a stage computes, by its place in [`Graph::stages`], in order.
    pub fn computed_in(&self, stage: usize) -> impl Iterator<Item = TensorId> {
        let nodes = self.nodes.iter().filter(move |n| n.stage == stage);
        nodes.flat_map(|n| n.outputs.iter().copied())
    }

    /// Every tensor that a node computes, in order.
    pub fn computed(&self) -> Vec<TensorId> {
        self.nodes.iter().flat_map(|n| n.outputs.iter().copied()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::ops::Conv2d;
    use crate::engine::tensor::Tensor;

    /// What the first's weights were packed to would serve for the second's.
    #[test]
    fn constants_of_one_name_are_refused() {
        let mut graph = Graph::default();
        let op = Conv2d { bias: false, ..Conv2d::default() };
        let input = graph.input("weight", TensorSpec::f32([1, 2, 2]), Extent::Exact);
        let weights =
            [1.0, 2.0].map(|x| graph.constant("weight", Tensor::from_fn([1, 1, 1, 1], |_| x)));
        for weight in weights {
            let message = graph.apply("conv", op, &[input, weight]).expect_err("one name");
            let message = message.to_string();
            assert!(message.contains("`weight`: expected one constant"), "{message}");
        }
        graph.rename(weights[1], "other");
        for weight in weights {
            graph.apply("conv", op, &[input, weight]).expect("names of their own");
        }
    }
}
