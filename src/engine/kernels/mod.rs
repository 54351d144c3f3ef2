//! Kernels: what runs an operation on a device. An operation may have several.
//!
//! A [`Kernel`] says whether it fits an adapter and the shapes, in which [`Layout`]s it reads and
//! writes, and writes its [`Dispatch`]es into a [`Recording`]. It knows no device, and a picture at a
//! time: `crate::engine::lower` brings layouts and pictures together.

mod convert;
mod count;
mod layout;
mod over_space;
mod plain;
mod products;
mod recording;
mod weights;

mod apply_gates;
mod box_voting;
mod channel_gate;
mod channel_pool;
mod contact_map;
mod conv2d;
mod crop_resize;
mod decode_detections;
mod decode_pose;
mod decode_proposals;
mod gather_rows;
mod global_avg_pool;
pub(crate) mod indirect_grid;
mod linear;
mod max_pool2d;
mod nms;
mod not_finite;
mod roi_align;
pub(crate) mod roof;
mod softmax;
mod spatial_pool;
mod top_k;
mod upsample_bilinear;
mod weighted_sum;

use std::any::Any;
use std::fmt::Debug;

use crate::engine::graph::TensorId;
use crate::engine::ops::{Op, Tolerance};
use crate::engine::precision::Precision;
pub use crate::engine::reference::MAX_WORKGROUPS;
use crate::engine::shader::{Shader, Variant};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

pub(crate) use convert::Convert;
pub use layout::{Layout, Quads};
use plain::Plain;
pub use recording::{Command, Dispatch, Grid, Recording, Role, Stage, Storage, TensorInfo};
use recording::{all_texels, of_maps, repeated, texels};

/// What kernels ask of an adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caps {
    /// Fewest invocations of a subgroup; 0 where shaders have no subgroups.
    pub subgroup_min: u32,
    /// Most invocations of a subgroup. A driver may give each shader a size of its own.
    pub subgroup_max: u32,
    /// Kind of device.
    pub kind: Kind,
    /// Longest side of a two-dimensional texture.
    pub texture_side: u32,
    /// Most bytes of a storage buffer that a shader binds.
    pub buffer_bytes: u64,
}

impl Default for Caps {
    /// What WebGPU promises.
    fn default() -> Self {
        Self {
            subgroup_min: 0,
            subgroup_max: 0,
            kind: Kind::Other,
            texture_side: 8192,
            buffer_bytes: 128 << 20,
        }
    }
}

impl Caps {
    /// Least and largest subgroups of the adapters that there are, each once; first of those without.
    pub const SUBGROUPS: [[u32; 2]; 11] = [
        [0, 0],
        // Of one size: SwiftShader, lavapipe, Mali and V3D, NVIDIA, AMD's GCN.
        [4, 4],
        [8, 8],
        [16, 16],
        [32, 32],
        [64, 64],
        // Of several: what wgpu knows of Metal, Intel, AMD's RDNA, Adreno, drivers that tell none.
        [4, 64],
        [8, 32],
        [32, 64],
        [64, 128],
        [4, 128],
    ];

    /// The same with subgroups from `min` to `max` invocations.
    pub fn with_subgroups(self, [min, max]: [u32; 2]) -> Self {
        Self { subgroup_min: min, subgroup_max: max, ..self }
    }

    /// Whether it has so many cores that few workgroups leave it idle.
    pub fn has_many_cores(&self) -> bool {
        self.kind != Kind::Software
    }

    /// Whether what all invocations read from one address comes to scalar registers, and a broadcast from a lane
    /// takes an instruction in each of them: AMD's GPUs, which alone have subgroups of these sizes.
    pub fn has_scalar_registers(&self) -> bool {
        self.subgroup_min >= 32 && self.subgroup_max == 64
    }

    /// How maps lie that a kernel reads over and over: software adapters read textures twice as fast as buffers,
    /// and copy to them. See `wgsl/shared/input.wgsl`.
    fn input_layout(&self) -> Layout {
        if self.kind == Kind::Software { Layout::Texture } else { Layout::Quads }
    }

    /// The variant of a shader with `wgsl/shared/input.wgsl`.
    fn input_variant(&self) -> Variant {
        Variant::default().with("TEXTURE", self.input_layout() == Layout::Texture)
    }
}

/// What an adapter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A GPU with memory of its own.
    Discrete,
    /// A GPU that shares the host's memory.
    Integrated,
    /// The host's cores.
    Software,
    /// A GPU of which no more is known: a browser's, or a virtual machine's.
    Other,
}

/// An operation on inputs of known shapes, for which a kernel is sought.
#[derive(Clone, Copy, Debug)]
pub struct Work<'a> {
    /// Its place in the graph.
    pub node: usize,
    /// The operation.
    pub op: &'a dyn Op,
    /// Shapes of its inputs.
    pub inputs: &'a [TensorSpec],
    /// Whether the values of each input are known when recording.
    pub known: &'a [bool],
    /// Shapes of its outputs.
    pub outputs: &'a [TensorSpec],
    /// Pictures at a time.
    pub batch: u32,
    /// How maps that are not planar, and weights in textures, are stored.
    pub precision: Precision,
    /// The adapter.
    pub caps: &'a Caps,
}

impl<'a> Work<'a> {
    /// The operation as what it is.
    ///
    /// # Errors
    /// [`Error::Tensor`] for another: a kernel was put down for an operation that it does not compute.
    pub fn op<T: Op>(&self) -> Result<&'a T> {
        let any: &dyn Any = self.op;
        let wrong =
            || Error::tensor(self.op.name(), "kernel", std::any::type_name::<T>(), "another");
        any.downcast_ref().ok_or_else(wrong)
    }

    /// Each input and output under the operation's name for it.
    pub fn bindings(&self, (inputs, outputs): Io) -> Vec<(&'static str, TensorId)> {
        let inputs = self.op.inputs().into_iter().zip(inputs);
        let outputs = self.op.outputs().into_iter().zip(outputs);
        inputs.chain(outputs).map(|(name, id)| (name, *id)).collect()
    }

    /// Where the channels of a map of this shape lie as [`Layout::Quads`] and [`Layout::Texture`], if they can.
    pub fn quads(&self, spec: &TensorSpec) -> Option<Quads> {
        Quads::of(spec, self.precision, self.batch, self.caps)
    }

    /// Whether a map of this shape can lie so.
    pub fn has_quads(&self, spec: &TensorSpec) -> bool {
        self.quads(spec).is_some()
    }
}

/// The tensors that a kernel reads, and those that it writes.
pub type Io<'a> = (&'a [TensorId], &'a [TensorId]);

/// One way to run an operation on a device.
pub trait Kernel: Debug + Sync {
    /// Its name: the operation's and its own, `conv2d/direct`.
    fn id(&self) -> &'static str;

    /// Its shaders in all variants that an adapter like `caps` may need.
    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)>;

    /// Whether it runs `work`.
    fn fits(&self, _work: &Work) -> bool {
        true
    }

    /// Whether it is the one to run `work` where nothing was measured: asked of kernels that fit.
    fn preferred(&self, _work: &Work) -> bool {
        true
    }

    /// The layout in which it reads input `index`.
    fn reads(&self, _work: &Work, _index: usize) -> Layout {
        Layout::Planar
    }

    /// The layout in which it writes its outputs.
    fn writes(&self, _work: &Work) -> Layout {
        Layout::Planar
    }

    /// Whether one of its dispatches computes all pictures of a batch. Those of other kernels are
    /// repeated for each picture.
    fn batched(&self) -> bool {
        false
    }

    /// Appends the dispatches that compute its outputs from its inputs, which lie as the kernel said.
    ///
    /// # Errors
    /// [`Error::Capacity`] where a fixed capacity is too small.
    fn record(&self, work: &Work, recording: &mut Recording, io: Io) -> Result<()>;

    /// How far its outputs may be from the reference's before they are stored, where it orders its sums
    /// otherwise than [`Op::tolerance`] says, or stores weights in `precision`.
    ///
    /// # Errors
    /// As the operation's reference.
    fn tolerance(
        &self,
        _op: &dyn Op,
        _inputs: &[&Value],
        _reference: &[Value],
        _precision: Precision,
    ) -> Result<Option<Vec<Tolerance>>> {
        Ok(None)
    }
}

/// How far what `kernel` gives may be from the reference's, where maps and weights are stored in
/// `precision`, and each output in one of its own: the kernel's bound, or the operation's, and what
/// storing adds to it.
///
/// # Errors
/// As the operation's reference.
pub(crate) fn bounds(
    kernel: Option<&dyn Kernel>,
    op: &dyn Op,
    (inputs, reference): (&[&Value], &[Value]),
    precision: Precision,
    written: &[Precision],
) -> Result<Vec<Tolerance>> {
    let own = match kernel {
        Some(kernel) => kernel.tolerance(op, inputs, reference, precision)?,
        None => None,
    };
    let bounds = match own {
        Some(own) => own,
        None => op.tolerance(inputs, reference)?,
    };
    let outputs = bounds.into_iter().zip(reference).zip(written);
    Ok(outputs.map(|((bound, value), written)| bound.stored(value, *written)).collect())
}

/// The kernels of each operation, the preferred first. The last fits everything that its operation
/// takes.
static KERNELS: &[(&str, &[&'static dyn Kernel])] = &[
    ("apply_gates", &[&apply_gates::Quads, &apply_gates::PLANAR]),
    ("box_voting", &[&box_voting::PLANAR]),
    ("channel_gate", &[&channel_gate::PLANAR]),
    ("channel_pool", &[&channel_pool::Quads, &channel_pool::PLANAR]),
    ("contact_map", &[&contact_map::Planar]),
    (
        "conv2d",
        &[
            &conv2d::Direct { weights: conv2d::Weights::Spread, split: true },
            &conv2d::Direct { weights: conv2d::Weights::Scalar, split: true },
            &conv2d::Winograd,
            &conv2d::Direct { weights: conv2d::Weights::Spread, split: false },
            &conv2d::Direct { weights: conv2d::Weights::Scalar, split: false },
            &conv2d::Planar,
        ],
    ),
    ("crop_resize", &[&crop_resize::Quads, &crop_resize::PLANAR]),
    ("decode_detections", &[&decode_detections::Planar]),
    ("decode_pose", &[&decode_pose::PLANAR]),
    ("decode_proposals", &[&decode_proposals::PLANAR]),
    ("gather_rows", &[&gather_rows::PLANAR]),
    ("global_avg_pool", &[&global_avg_pool::Quads, &global_avg_pool::Planar]),
    ("indirect_grid", &[&indirect_grid::PLANAR]),
    ("linear", &[&linear::Gemm, &linear::Planar]),
    ("max_pool2d", &[&max_pool2d::Quads, &max_pool2d::PLANAR]),
    ("nms", &[&nms::Planar]),
    ("not_finite", &[&not_finite::Planar]),
    ("roi_align", &[&roi_align::Quads, &roi_align::PLANAR]),
    ("softmax", &[&softmax::PLANAR]),
    ("spatial_pool", &[&spatial_pool::Quads, &spatial_pool::PLANAR]),
    ("top_k", &[&top_k::PLANAR]),
    ("upsample_bilinear", &[&upsample_bilinear::Quads, &upsample_bilinear::PLANAR]),
    ("weighted_sum", &[&weighted_sum::Quads, &weighted_sum::PLANAR]),
];

/// The kernels of an operation, the preferred first.
///
/// # Errors
/// [`Error::Tensor`] for an operation without any.
pub fn of(op: &dyn Op) -> Result<&'static [&'static dyn Kernel]> {
    match named(op.name()) {
        [] => Err(Error::tensor(op.name(), "kernels", "at least one", "none")),
        found => Ok(found),
    }
}

/// The kernels of the operation called `name`; none if there is no such operation.
pub fn named(name: &str) -> &'static [&'static dyn Kernel] {
    KERNELS.iter().find(|(n, _)| *n == name).map_or(&[], |(_, kernels)| *kernels)
}

/// Every shader in all variants that an adapter like `caps` may need, once.
pub fn shaders(caps: &Caps) -> Vec<(&'static Shader, Variant)> {
    let mut found: Vec<(&'static Shader, Variant)> = Convert::shaders(caps);
    found.push((&roof::SHADER, Variant::default()));
    for shader in all().flat_map(|kernel| kernel.shaders(caps)) {
        if !found.iter().any(|(s, v)| s.stem == shader.0.stem && *v == shader.1) {
            found.push(shader);
        }
    }
    found
}

/// All kernels.
pub fn all() -> impl Iterator<Item = &'static dyn Kernel> {
    KERNELS.iter().flat_map(|(_, kernels)| kernels.iter().copied())
}

/// The kernel called `id`.
pub fn find(id: &str) -> Option<&'static dyn Kernel> {
    all().find(|kernel| kernel.id() == id)
}
