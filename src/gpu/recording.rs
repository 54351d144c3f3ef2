//! A device-free list of dispatches over named tensors.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::gpu::shader::Shader;
use crate::shape::{Extent, TensorSpec};
use crate::tensor::Value;

/// Index of a tensor in a [`Recording`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TensorId(pub usize);

/// Where a tensor's values come from and how long they live.
#[derive(Clone, Debug)]
pub enum Role {
    /// Uploaded once, when the plan is built: weights.
    Constant(Arc<Value>),
    /// Written by the host before each run.
    Input(Extent),
    /// Written and read by dispatches; its buffer is reused when it is dead.
    Transient,
    /// Like a transient, but read back after each run.
    Output,
}

/// A tensor of a recording.
#[derive(Clone, Debug)]
pub struct TensorInfo {
    /// Name for messages and dumps.
    pub name: String,
    /// Shape and element type.
    pub spec: TensorSpec,
    /// Where its values come from.
    pub role: Role,
}

/// How many workgroups a dispatch starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grid {
    /// Known when recording.
    Workgroups([u32; 3]),
    /// Three u32 at the start of a tensor that an earlier dispatch wrote.
    Indirect(TensorId),
}

/// Largest number of workgroups a dimension may have under `wgpu::Limits::default()`.
pub const MAX_WORKGROUPS: u32 = 65_535;

impl Grid {
    /// One-dimensional work of `threads` invocations in workgroups of `size`, folded to two
    /// dimensions past 65 535 workgroups. The shader recovers its index with
    /// `linear_index` from `wgsl/shared/index.wgsl`.
    pub fn linear(threads: usize, size: u32) -> Self {
        let groups = threads.div_ceil(size as usize).max(1) as u64;
        let x = groups.min(u64::from(MAX_WORKGROUPS));
        Self::Workgroups([x as u32, groups.div_ceil(x) as u32, 1])
    }
}

/// One run of a compute shader.
#[derive(Clone, Debug)]
pub struct Dispatch {
    /// The shader file.
    pub shader: &'static Shader,
    /// Entry point in that file.
    pub entry: &'static str,
    /// Bytes of the uniform `params`; empty if the entry point has none.
    pub params: Vec<u8>,
    /// Tensor of each storage binding, by the variable's name in the shader.
    pub bindings: Vec<(&'static str, TensorId)>,
    /// Number of workgroups.
    pub grid: Grid,
}

impl Dispatch {
    /// A dispatch with `params` as its uniform.
    pub fn new(
        shader: &'static Shader,
        entry: &'static str,
        params: &impl bytemuck::NoUninit,
        bindings: &[(&'static str, TensorId)],
        grid: Grid,
    ) -> Self {
        Self {
            shader,
            entry,
            params: bytemuck::bytes_of(params).to_vec(),
            bindings: bindings.to_vec(),
            grid,
        }
    }
}

/// A named run of consecutive dispatches: the unit of timing.
#[derive(Clone, Debug)]
pub struct Stage {
    /// Stage name.
    pub name: String,
    /// Index of its first dispatch.
    pub first: usize,
}

/// Tensors, and the dispatches over them in order.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    tensors: Vec<TensorInfo>,
    dispatches: Vec<Dispatch>,
    stages: Vec<Stage>,
}

impl Recording {
    /// Adds a tensor.
    pub fn tensor(&mut self, name: impl Into<String>, spec: TensorSpec, role: Role) -> TensorId {
        self.tensors.push(TensorInfo { name: name.into(), spec, role });
        TensorId(self.tensors.len() - 1)
    }

    /// Adds a buffer that lives between two dispatches of one operation.
    pub fn scratch(&mut self, name: &str, spec: TensorSpec) -> TensorId {
        self.tensor(name, spec, Role::Transient)
    }

    /// Adds values known when recording, such as repacked weights.
    pub fn constant(&mut self, name: impl Into<String>, value: impl Into<Value>) -> TensorId {
        let value = value.into();
        self.tensor(name, value.spec(), Role::Constant(Arc::new(value)))
    }

    /// Appends a dispatch to the current stage.
    pub fn dispatch(&mut self, dispatch: Dispatch) {
        self.dispatches.push(dispatch);
    }

    /// Starts a stage; a call with the current stage's name continues it.
    pub fn begin_stage(&mut self, name: &str) {
        if self.stages.last().is_none_or(|s| s.name != name) {
            self.stages.push(Stage { name: name.into(), first: self.dispatches.len() });
        }
    }

    /// Marks a tensor to be read back after each run.
    pub fn mark_output(&mut self, id: TensorId) {
        let info = &mut self.tensors[id.0];
        if matches!(info.role, Role::Transient) {
            info.role = Role::Output;
        }
    }

    /// What is known of a tensor.
    pub fn info(&self, id: TensorId) -> &TensorInfo {
        &self.tensors[id.0]
    }

    /// Shape of a tensor as a slice.
    pub fn dims(&self, id: TensorId) -> &[usize] {
        &self.tensors[id.0].spec.shape.0
    }

    /// Values of a constant tensor, for operations that repack their weights.
    ///
    /// # Errors
    /// [`Error::Tensor`] if the tensor's values are not known when recording.
    pub fn constant_value(&self, op: &str, id: TensorId) -> Result<Arc<Value>> {
        match &self.info(id).role {
            Role::Constant(value) => Ok(value.clone()),
            other => {
                let got = match other {
                    Role::Input(_) => "an input",
                    _ => "a computed tensor",
                };
                Err(Error::tensor(op, &self.info(id).name, "weights known when recording", got))
            }
        }
    }

    /// All tensors, by [`TensorId`].
    pub fn tensors(&self) -> &[TensorInfo] {
        &self.tensors
    }

    /// All dispatches, in order.
    pub fn dispatches(&self) -> &[Dispatch] {
        &self.dispatches
    }

    /// All stages, in order.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_grid_folds_past_the_limit() {
        assert_eq!(Grid::linear(0, 64), Grid::Workgroups([1, 1, 1]));
        assert_eq!(Grid::linear(65, 64), Grid::Workgroups([2, 1, 1]));
        assert_eq!(Grid::linear(65_535 * 64, 64), Grid::Workgroups([65_535, 1, 1]));
        assert_eq!(Grid::linear(65_535 * 64 + 1, 64), Grid::Workgroups([65_535, 2, 1]));
    }
}
