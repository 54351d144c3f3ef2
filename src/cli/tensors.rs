//! Tensors in safetensors files: what `op` reads and writes, and what `--dump-stages` writes.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use safetensors::{Dtype, SafeTensors, View};
use smr_gpu::engine::shape::{DType, Shape, TensorSpec};
use smr_gpu::engine::tensor::{Tensor, Value};
use smr_gpu::files::{self, Outputs};

use super::exit::{Exit, Failure};

/// Longest file that is read.
const MAX_BYTES: u64 = 256 << 20;

/// Reads every tensor of a file. F16 and F32 become f32; U32, I32 and I64 become u32.
///
/// # Errors
/// [`Exit::Inputs`] that names the file, and the tensor where one is to blame.
pub(super) fn read(path: &Path) -> Result<BTreeMap<String, Value>, Failure> {
    let failed =
        |message: String| Failure::new(Exit::Inputs, format!("{}: {message}", path.display()));
    let bytes = files::read(path, MAX_BYTES).map_err(|e| failed(e.to_string()))?;
    let file = SafeTensors::deserialize(&bytes)
        .map_err(|e| failed(format!("expected a whole safetensors file, got an error: {e}")))?;
    file.iter()
        .map(|(name, view)| {
            let value = value(view.dtype(), view.shape(), view.data());
            Ok((name.to_owned(), value.map_err(|e| failed(format!("tensor `{name}`: {e}")))?))
        })
        .collect()
}

fn value(dtype: Dtype, shape: &[usize], bytes: &[u8]) -> Result<Value, String> {
    let f32s = |data| Tensor::new(Shape(shape.to_vec()), data).map(Value::F32);
    let u32s = |data| Tensor::new(Shape(shape.to_vec()), data).map(Value::U32);
    match dtype {
        Dtype::F32 => f32s(bytemuck::pod_collect_to_vec(bytes)),
        Dtype::F16 => {
            let halves: Vec<half::f16> = bytemuck::pod_collect_to_vec(bytes);
            f32s(halves.into_iter().map(f32::from).collect())
        }
        Dtype::U32 => u32s(bytemuck::pod_collect_to_vec(bytes)),
        Dtype::I32 => u32s(indices(bytemuck::pod_collect_to_vec::<u8, i32>(bytes))?),
        Dtype::I64 => u32s(indices(bytemuck::pod_collect_to_vec::<u8, i64>(bytes))?),
        other => return Err(format!("expected F16, F32, U32, I32 or I64, got {other:?}")),
    }
    .map_err(|e| e.to_string())
}

fn indices<T: Copy + TryInto<u32> + std::fmt::Display>(values: Vec<T>) -> Result<Vec<u32>, String> {
    values
        .into_iter()
        .map(|v| v.try_into().map_err(|_| format!("expected 0 to {}, got {v}", u32::MAX)))
        .collect()
}

/// Writes tensors as F32 and U32.
///
/// # Errors
/// [`Exit::Usage`] for a file that `outputs` spares, else [`Exit::Output`].
pub(super) fn write<'a>(
    outputs: &mut Outputs,
    path: &Path,
    tensors: impl IntoIterator<Item = (&'a str, &'a Value)>,
    metadata: HashMap<String, String>,
) -> Result<(), Failure> {
    let tensors = tensors.into_iter().map(|(name, value)| (name, Stored::from(value)));
    let bytes = safetensors::serialize(tensors, Some(metadata))
        .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", path.display())))?;
    Ok(outputs.write(path, &bytes)?)
}

/// A value as the safetensors crate wants to see it.
struct Stored<'a> {
    spec: TensorSpec,
    bytes: &'a [u8],
}

impl<'a> From<&'a Value> for Stored<'a> {
    fn from(value: &'a Value) -> Self {
        Self { spec: value.spec(), bytes: value.bytes() }
    }
}

impl View for Stored<'_> {
    fn dtype(&self) -> Dtype {
        match self.spec.dtype {
            DType::F32 => Dtype::F32,
            DType::U32 => Dtype::U32,
        }
    }

    fn shape(&self) -> &[usize] {
        &self.spec.shape.0
    }

    fn data(&self) -> Cow<'_, [u8]> {
        self.bytes.into()
    }

    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}
