//! A device-free list of dispatches and copies over named tensors.

use crate::engine::graph::TensorId;
use crate::engine::kernels::{Caps, Layout, Quads};
use crate::engine::ops::IndirectGrid;
use crate::engine::precision::Precision;
use crate::engine::reference::MAX_WORKGROUPS;
use crate::engine::shader::{Shader, Variant};
use crate::engine::shape::{Extent, TensorSpec};
use crate::engine::tensor::Constant;
use crate::error::{Error, Result};

/// Buffers are bound from multiples of this on every adapter; so the pictures of a batch lie.
const ALIGNMENT: u64 = 256;

/// Where a tensor's values come from and how long they live.
#[derive(Clone, Debug)]
pub enum Role {
    /// Uploaded once, when the program is built: weights.
    Constant(Constant),
    /// Written by the host before each run.
    Input(Extent),
    /// Written and read by dispatches; what holds it is reused when it is dead.
    Transient,
    /// Like a transient, but read back after each run.
    Output,
}

/// What holds a tensor on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Storage {
    /// A buffer.
    Buffer {
        /// Its size.
        bytes: u64,
    },
    /// A texture of four channels.
    Texture {
        /// Texels of a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Its format: rgba32float or rgba16float.
        precision: Precision,
    },
}

impl Storage {
    /// Its size in bytes.
    pub fn bytes(&self) -> u64 {
        match *self {
            Self::Buffer { bytes } => bytes,
            Self::Texture { width, height, precision } => {
                u64::from(width) * u64::from(height) * u64::from(precision.texel_bytes())
            }
        }
    }
}

/// A tensor of a recording.
#[derive(Clone, Debug)]
pub struct TensorInfo {
    /// Name for messages and dumps.
    pub name: String,
    /// Shape and element type, of one picture.
    pub spec: TensorSpec,
    /// Where its values come from.
    pub role: Role,
    /// How they lie.
    pub layout: Layout,
    /// How each is stored; [`Layout::Planar`] knows f32 alone.
    pub precision: Precision,
    /// What holds all pictures.
    pub storage: Storage,
    /// Bytes from one picture to the next in a buffer.
    pub stride: u64,
}

/// How many workgroups a dispatch starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grid {
    /// Known when recording.
    Workgroups([u32; 3]),
    /// By a count on the device: what `crate::engine::lower` makes [`Grid::Indirect`] of.
    Counted(TensorId, IndirectGrid),
    /// Three u32, from this byte on, of a tensor that an earlier dispatch wrote.
    Indirect(TensorId, u64),
}

impl Grid {
    /// One-dimensional work of `threads` invocations in workgroups of `size`, folded to two
    /// dimensions past 65 535 workgroups. The shader recovers its index with
    /// `linear_index` from `wgsl/shared/index.wgsl`.
    pub fn linear(threads: usize, size: u32) -> Self {
        let groups = threads.div_ceil(size as usize).max(1) as u64;
        let x = groups.min(u64::from(MAX_WORKGROUPS));
        Self::Workgroups([x as u32, groups.div_ceil(x) as u32, 1])
    }

    /// The same for each of so many pictures, one behind the other in z.
    pub fn pictures(self, batch: u32) -> Self {
        match self {
            Self::Workgroups([x, y, z]) => Self::Workgroups([x, y, z * batch]),
            by_count @ (Self::Counted(..) | Self::Indirect(..)) => by_count,
        }
    }
}

/// One run of a compute shader.
#[derive(Clone, Debug)]
pub struct Dispatch {
    /// The shader file.
    pub shader: &'static Shader,
    /// How to read it.
    pub variant: Variant,
    /// Entry point in that file.
    pub entry: &'static str,
    /// Bytes of the uniform `params`; empty if the entry point has none.
    pub params: Vec<u8>,
    /// Tensor of each binding, by the variable's name in the shader.
    pub bindings: Vec<(&'static str, TensorId)>,
    /// Number of workgroups.
    pub grid: Grid,
    /// The picture of the batch that it sees; `None` for one that computes all.
    pub picture: Option<u32>,
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
            variant: Variant::default(),
            entry,
            params: bytemuck::bytes_of(params).to_vec(),
            bindings: bindings.to_vec(),
            grid,
            picture: None,
        }
    }

    /// The same of a variant of the shader.
    pub fn variant(mut self, variant: Variant) -> Self {
        self.variant = variant;
        self
    }
}

/// What a device is told to do.
#[derive(Clone, Debug)]
pub enum Command {
    /// Run a shader.
    Dispatch(Dispatch),
    /// Copy [`Layout::Quads`] to [`Layout::Texture`].
    Copy {
        /// The buffer.
        from: TensorId,
        /// The texture.
        to: TensorId,
    },
}

impl Command {
    /// The tensors that it reads or writes.
    pub fn tensors(&self) -> Vec<TensorId> {
        match self {
            Self::Copy { from, to } => vec![*from, *to],
            Self::Dispatch(dispatch) => {
                let by_count = match dispatch.grid {
                    Grid::Counted(id, _) | Grid::Indirect(id, _) => Some(id),
                    Grid::Workgroups(_) => None,
                };
                dispatch.bindings.iter().map(|(_, id)| *id).chain(by_count).collect()
            }
        }
    }
}

/// A named run of consecutive commands: the unit of timing.
#[derive(Clone, Debug)]
pub struct Stage {
    /// Stage name.
    pub name: String,
    /// Index of its first command.
    pub first: usize,
}

/// Tensors, and the commands over them in order.
#[derive(Clone, Debug)]
pub struct Recording {
    batch: u32,
    precision: Precision,
    caps: Caps,
    tensors: Vec<TensorInfo>,
    commands: Vec<Command>,
    stages: Vec<Stage>,
}

impl Recording {
    /// An empty one, for so many pictures at a time and maps that may be stored in `precision`.
    pub fn new(batch: u32, precision: Precision, caps: Caps) -> Self {
        let (tensors, commands, stages) = (Vec::new(), Vec::new(), Vec::new());
        Self { batch, precision, caps, tensors, commands, stages }
    }

    /// Pictures at a time.
    pub fn batch(&self) -> u32 {
        self.batch
    }

    /// The adapter.
    pub fn caps(&self) -> &Caps {
        &self.caps
    }

    /// Adds a tensor.
    pub fn tensor(&mut self, name: impl Into<String>, spec: TensorSpec, role: Role) -> TensorId {
        let stride = spec.bytes().max(4).next_multiple_of(ALIGNMENT);
        let pictures = match role {
            Role::Constant(_) => 1,
            _ => u64::from(self.batch),
        };
        let bytes = (pictures - 1) * stride + spec.bytes().max(4);
        let storage = Storage::Buffer { bytes };
        self.push(TensorInfo {
            name: name.into(),
            spec,
            role,
            layout: Layout::Planar,
            precision: Precision::F32,
            storage,
            stride,
        })
    }

    fn push(&mut self, info: TensorInfo) -> TensorId {
        self.tensors.push(info);
        TensorId(self.tensors.len() - 1)
    }

    /// Adds a computed map in a layout; `precision` counts where that is not planar.
    ///
    /// # Errors
    /// [`Error::Tensor`] if what has this shape cannot lie so on the adapter.
    pub fn map(
        &mut self,
        name: impl Into<String>,
        spec: TensorSpec,
        layout: Layout,
        precision: Precision,
    ) -> Result<TensorId> {
        let name = name.into();
        if layout == Layout::Planar {
            return Ok(self.tensor(name, spec, Role::Transient));
        }
        let quads = Quads::of(&spec, self.precision, self.batch, &self.caps);
        let quads =
            quads.ok_or_else(|| Error::tensor("layout", &name, "a map [C, H, W]", &spec))?;
        let stride = quads.texels() * u64::from(precision.texel_bytes());
        let storage = match layout {
            Layout::Texture => {
                let (width, height) = (quads.texture_width(), quads.rows * self.batch);
                Storage::Texture { width, height, precision }
            }
            _ => Storage::Buffer { bytes: stride * u64::from(self.batch) },
        };
        let role = Role::Transient;
        Ok(self.push(TensorInfo { name, spec, role, layout, precision, storage, stride }))
    }

    /// Where the channels of a map lie.
    ///
    /// # Errors
    /// As [`Recording::map`].
    pub fn quads(&self, id: TensorId) -> Result<Quads> {
        let info = self.info(id);
        let quads = Quads::of(&info.spec, self.precision, self.batch, &self.caps);
        quads.ok_or_else(|| Error::tensor("layout", &info.name, "a map [C, H, W]", &info.spec))
    }

    /// Elements from one picture to the next in a planar tensor; 0 for a constant, which all share.
    pub fn stride(&self, id: TensorId) -> u32 {
        match self.info(id).role {
            Role::Constant(_) => 0,
            _ => (self.info(id).stride / 4) as u32,
        }
    }

    /// Adds a buffer that lives between two dispatches of one operation.
    pub fn scratch(&mut self, name: &str, spec: TensorSpec) -> TensorId {
        self.tensor(name, spec, Role::Transient)
    }

    /// Adds values known when recording, such as repacked weights.
    pub fn constant(&mut self, name: impl Into<String>, value: impl Into<Constant>) -> TensorId {
        let value = value.into();
        self.tensor(name, value.spec().clone(), Role::Constant(value))
    }

    /// Adds texels `[height, width, 4]` known when recording.
    pub fn constant_texture(
        &mut self,
        name: impl Into<String>,
        texels: Constant,
        precision: Precision,
    ) -> TensorId {
        let spec = texels.spec().clone();
        let side = |i: usize| spec.shape.0.get(i).map_or(1, |d| *d as u32);
        let storage = Storage::Texture { width: side(1), height: side(0), precision };
        let role = Role::Constant(texels);
        self.push(TensorInfo {
            name: name.into(),
            spec,
            role,
            layout: Layout::Texture,
            precision,
            storage,
            stride: 0,
        })
    }

    /// Appends a dispatch to the current stage.
    pub fn dispatch(&mut self, dispatch: Dispatch) {
        self.commands.push(Command::Dispatch(dispatch));
    }

    /// Appends a dispatch of a shader with `wgsl/shared/texels.wgsl`, in the variant that reads `read` and
    /// writes `written` as they are stored.
    pub fn dispatch_maps(&mut self, dispatch: Dispatch, read: TensorId, written: TensorId) {
        let [read, written] = [read, written].map(|id| self.info(id).precision);
        let variant = texels(dispatch.variant.clone(), read, written);
        self.dispatch(dispatch.variant(variant));
    }

    /// Appends a copy of [`Layout::Quads`] to [`Layout::Texture`].
    pub fn copy(&mut self, from: TensorId, to: TensorId) {
        self.commands.push(Command::Copy { from, to });
    }

    /// Repeats the dispatches behind the first `from` commands for each picture of the batch.
    pub(crate) fn for_each_picture(&mut self, from: usize) {
        let once = self.commands.split_off(from);
        for picture in 0..self.batch {
            self.commands.extend(once.iter().cloned().map(|mut command| {
                if let Command::Dispatch(dispatch) = &mut command {
                    dispatch.picture = Some(picture);
                }
                command
            }));
        }
    }

    /// Gives the dispatch that is command `at` another grid.
    pub(crate) fn set_grid(&mut self, at: usize, grid: Grid) {
        if let Command::Dispatch(dispatch) = &mut self.commands[at] {
            dispatch.grid = grid;
        }
    }

    /// Puts a dispatch before command `at`, in the same stage.
    pub(crate) fn insert(&mut self, at: usize, dispatch: Dispatch) {
        self.commands.insert(at, Command::Dispatch(dispatch));
        self.stages.iter_mut().filter(|stage| stage.first > at).for_each(|stage| stage.first += 1);
    }

    /// Starts a stage; a call with the current stage's name continues it.
    pub fn begin_stage(&mut self, name: &str) {
        if self.stages.last().is_none_or(|s| s.name != name) {
            self.stages.push(Stage { name: name.into(), first: self.commands.len() });
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

    /// A constant tensor, for kernels that repack their weights.
    ///
    /// # Errors
    /// [`Error::Tensor`] if the tensor's values are not known when recording.
    pub fn weights(&self, op: &str, id: TensorId) -> Result<Constant> {
        match &self.info(id).role {
            Role::Constant(constant) => Ok(constant.clone()),
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

    /// All commands, in order.
    pub fn commands(&self) -> &[Command] {
        &self.commands
    }

    /// All stages, in order.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
}

/// The variant of a shader with `wgsl/shared/texels.wgsl` for maps that are stored so.
pub(super) fn texels(variant: Variant, read: Precision, written: Precision) -> Variant {
    variant.with("HALF", read.is_half()).with("HALF_OUTPUT", written.is_half())
}

/// Tensors under the names of as many bindings or more; where there are fewer, the first is bound again.
pub(super) fn repeated<const N: usize>(
    names: [&'static str; N],
    ids: &[TensorId],
) -> impl Iterator<Item = (&'static str, TensorId)> {
    let ids = ids.iter().chain(std::iter::repeat(&ids[0])).copied();
    names.into_iter().zip(ids)
}

/// All of those.
pub(super) fn all_texels(variant: &Variant) -> [Variant; 4] {
    use Precision::{F16, F32};
    [(F32, F32), (F32, F16), (F16, F32), (F16, F16)]
        .map(|(read, written)| texels(variant.clone(), read, written))
}

/// A shader with `wgsl/shared/texels.wgsl` in all of those.
pub(super) fn of_maps(shader: &'static Shader) -> Vec<(&'static Shader, Variant)> {
    all_texels(&Variant::default()).map(|variant| (shader, variant)).into()
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
