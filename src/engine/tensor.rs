//! Dense tensors in host memory.

use std::fmt;
use std::sync::Arc;

use crate::engine::shape::{DType, Shape, TensorSpec};
use crate::error::{Error, Result};

/// A dense row-major tensor; pictures and feature maps are `[C, H, W]`.
#[derive(Clone, PartialEq)]
pub struct Tensor<T = f32> {
    shape: Shape,
    data: Vec<T>,
}

impl<T: Copy + Default> Tensor<T> {
    /// A tensor of `data`, row-major.
    ///
    /// # Errors
    /// [`Error::Tensor`] if `data` is not as long as `shape` says.
    pub fn new(shape: impl Into<Shape>, data: Vec<T>) -> Result<Self> {
        let shape = shape.into();
        if shape.elements() != data.len() {
            let expected = format!("{} values for shape {shape}", shape.elements());
            return Err(Error::tensor("tensor", "data", expected, data.len()));
        }
        Ok(Self { shape, data })
    }

    /// A tensor whose values are computed from their linear index.
    pub fn from_fn(shape: impl Into<Shape>, value: impl FnMut(usize) -> T) -> Self {
        let shape = shape.into();
        let data = (0..shape.elements()).map(value).collect();
        Self { shape, data }
    }

    /// A tensor of zeros.
    pub fn zeros(shape: impl Into<Shape>) -> Self {
        Self::from_fn(shape, |_| T::default())
    }

    /// Dimensions, outermost first.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Dimensions as a slice.
    pub fn dims(&self) -> &[usize] {
        &self.shape.0
    }

    /// Values, row-major.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// Values, row-major, to be changed.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Cuts the tensor to its first `rows` rows, if it has more.
    pub fn truncate(&mut self, rows: usize) {
        let Some((all, row)) = self.shape.0.split_first_mut() else { return };
        *all = rows.min(*all);
        self.data.truncate(*all * row.iter().product::<usize>());
    }

    /// The values alone.
    pub fn into_data(self) -> Vec<T> {
        self.data
    }
}

/// Values that `{:?}` of a tensor shows.
const SHOWN: usize = 8;

impl<T: fmt::Debug> fmt::Debug for Tensor<T> {
    /// A line: shape, and the first values.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}(", std::any::type_name::<T>(), self.shape)?;
        for (i, value) in self.data.iter().take(SHOWN).enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            write!(f, "{comma}{value:?}")?;
        }
        match self.data.len().saturating_sub(SHOWN) {
            0 => f.write_str(")"),
            more => write!(f, ", and {more} more)"),
        }
    }
}

/// A tensor of either element type.
#[derive(Clone, PartialEq)]
pub enum Value {
    /// Floats.
    F32(Tensor<f32>),
    /// Indices, counts, packed pixels.
    U32(Tensor<u32>),
}

impl Value {
    /// How many elements it has.
    pub fn elements(&self) -> usize {
        match self {
            Self::F32(tensor) => tensor.data().len(),
            Self::U32(tensor) => tensor.data().len(),
        }
    }

    /// Shape and element type.
    pub fn spec(&self) -> TensorSpec {
        match self {
            Self::F32(t) => TensorSpec { shape: t.shape.clone(), dtype: DType::F32 },
            Self::U32(t) => TensorSpec { shape: t.shape.clone(), dtype: DType::U32 },
        }
    }

    /// As [`Tensor::truncate`].
    pub fn truncate(&mut self, rows: usize) {
        match self {
            Self::F32(t) => t.truncate(rows),
            Self::U32(t) => t.truncate(rows),
        }
    }

    /// Element `i`, for people.
    pub fn show(&self, i: usize) -> String {
        match self {
            Self::F32(t) => t.data[i].to_string(),
            Self::U32(t) => t.data[i].to_string(),
        }
    }

    /// The values' bytes in host order, as a storage buffer holds them.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Self::F32(t) => bytemuck::cast_slice(&t.data),
            Self::U32(t) => bytemuck::cast_slice(&t.data),
        }
    }

    /// A value read back from a buffer's bytes.
    ///
    /// # Errors
    /// [`Error::Tensor`] if `bytes` is not as long as `spec` says.
    pub fn from_bytes(spec: &TensorSpec, bytes: &[u8]) -> Result<Self> {
        Ok(match spec.dtype {
            DType::F32 => {
                Self::F32(Tensor::new(spec.shape.clone(), bytemuck::pod_collect_to_vec(bytes))?)
            }
            DType::U32 => {
                Self::U32(Tensor::new(spec.shape.clone(), bytemuck::pod_collect_to_vec(bytes))?)
            }
        })
    }

    /// The float tensor.
    ///
    /// # Errors
    /// [`Error::Tensor`] if the elements are integers.
    pub fn f32(&self) -> Result<&Tensor<f32>> {
        match self {
            Self::F32(t) => Ok(t),
            Self::U32(_) => Err(Error::tensor("tensor", "value", DType::F32, self.spec())),
        }
    }

    /// The integer tensor.
    ///
    /// # Errors
    /// [`Error::Tensor`] if the elements are floats.
    pub fn u32(&self) -> Result<&Tensor<u32>> {
        match self {
            Self::U32(t) => Ok(t),
            Self::F32(_) => Err(Error::tensor("tensor", "value", DType::U32, self.spec())),
        }
    }
}

impl fmt::Debug for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::F32(t) => t.fmt(f),
            Self::U32(t) => t.fmt(f),
        }
    }
}

impl From<Tensor<f32>> for Value {
    fn from(t: Tensor<f32>) -> Self {
        Self::F32(t)
    }
}

impl From<Tensor<u32>> for Value {
    fn from(t: Tensor<u32>) -> Self {
        Self::U32(t)
    }
}

/// Values that are known, or that can be made whenever they are needed: weights.
#[derive(Clone)]
pub struct Constant {
    spec: TensorSpec,
    make: Arc<dyn Fn() -> Result<Arc<Value>> + Send + Sync>,
}

impl fmt::Debug for Constant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Constant({})", self.spec)
    }
}

impl Constant {
    /// Values that are made each time that they are asked for, and kept by nobody.
    pub fn made(
        spec: TensorSpec,
        make: impl Fn() -> Result<Value> + Send + Sync + 'static,
    ) -> Self {
        Self { spec, make: Arc::new(move || make().map(Arc::new)) }
    }

    /// The same with its floats put into another order.
    pub(crate) fn packed(
        &self,
        spec: TensorSpec,
        pack: impl Fn(&Tensor) -> Tensor + Send + Sync + 'static,
    ) -> Self {
        let from = self.clone();
        Self::made(spec, move || Ok(pack(from.get()?.f32()?).into()))
    }

    /// Shape and element type.
    pub fn spec(&self) -> &TensorSpec {
        &self.spec
    }

    /// The values.
    ///
    /// # Errors
    /// What making them returns.
    pub fn get(&self) -> Result<Arc<Value>> {
        (self.make)()
    }
}

impl<T: Into<Value>> From<T> for Constant {
    fn from(value: T) -> Self {
        let value = Arc::new(value.into());
        Self { spec: value.spec(), make: Arc::new(move || Ok(value.clone())) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_for_people() {
        let small: Value = Tensor::from_fn([2, 2], |i| i as f32 / 2.0).into();
        assert_eq!(format!("{small:?}"), "f32[2, 2](0.0, 0.5, 1.0, 1.5)");
        let large: Value = Tensor::from_fn([512, 512, 3, 3], |i| i as u32).into();
        let want = "u32[512, 512, 3, 3](0, 1, 2, 3, 4, 5, 6, 7, and 2359288 more)";
        assert_eq!(format!("{large:?}"), want);
        // Nor does the form with line breaks list them.
        assert_eq!(format!("{large:#?}"), want);
    }
}
