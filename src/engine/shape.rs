//! Shapes and element types.

use std::fmt;

use crate::error::{Error, Result};

/// Bytes of the largest tensor: what every device can bind.
pub(crate) const MAX_BYTES: u64 = 128 << 20;
/// Pixels of the largest picture: as RGBA8 they fill the largest tensor, 128 MiB.
pub const MAX_PIXELS: usize = MAX_BYTES as usize / 4;

/// Dimensions of a dense row-major tensor, outermost first.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub struct Shape(pub Vec<usize>);

impl Shape {
    /// Number of elements; 1 for a scalar (no dimensions).
    pub fn elements(&self) -> usize {
        self.0.iter().fold(1, |product: usize, d| product.saturating_mul(*d))
    }

    /// Number of dimensions.
    pub fn rank(&self) -> usize {
        self.0.len()
    }
}

impl<const N: usize> From<[usize; N]> for Shape {
    fn from(dims: [usize; N]) -> Self {
        Self(dims.to_vec())
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.0)
    }
}

/// Element type of a tensor. Both are four bytes, as WGSL's scalars are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DType {
    /// 32-bit float.
    F32,
    /// 32-bit unsigned integer: indices, counts, packed pixels.
    U32,
}

impl fmt::Display for DType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::F32 => "f32",
            Self::U32 => "u32",
        })
    }
}

/// Shape and element type of a tensor, without its values.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct TensorSpec {
    /// Dimensions, outermost first.
    pub shape: Shape,
    /// Element type.
    pub dtype: DType,
}

impl TensorSpec {
    /// A float tensor's spec.
    pub fn f32(shape: impl Into<Shape>) -> Self {
        Self { shape: shape.into(), dtype: DType::F32 }
    }

    /// An integer tensor's spec.
    pub fn u32(shape: impl Into<Shape>) -> Self {
        Self { shape: shape.into(), dtype: DType::U32 }
    }

    /// Size in bytes.
    pub fn bytes(&self) -> u64 {
        (self.shape.elements() as u64).saturating_mul(4)
    }
}

/// How much of an input each run must give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All of it.
    Exact,
    /// At most its first dimension: a run may give fewer rows, and what lies behind them is
    /// undefined.
    UpTo,
}

impl Extent {
    /// Whether a tensor of `given` can be the input recorded as `spec`.
    pub fn admits(self, spec: &TensorSpec, given: &TensorSpec) -> bool {
        let fits = match (self, spec.shape.0.split_first(), given.shape.0.split_first()) {
            (Self::UpTo, Some((most, rest)), Some((rows, given))) => rows <= most && rest == given,
            _ => spec.shape == given.shape,
        };
        fits && spec.dtype == given.dtype
    }

    /// Checks what the run `stage` was given for its input `name`, recorded as `spec`.
    ///
    /// # Errors
    /// [`Error::Tensor`] if it is missing or does not fit.
    pub(crate) fn check(
        self,
        stage: &str,
        name: &str,
        spec: &TensorSpec,
        given: Option<TensorSpec>,
    ) -> Result<()> {
        match given {
            Some(given) if self.admits(spec, &given) => Ok(()),
            Some(given) => Err(Error::tensor(stage, name, spec, given)),
            None => Err(Error::tensor(stage, name, spec, "nothing")),
        }
    }
}

impl fmt::Display for TensorSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.dtype, self.shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_up_to_input_may_have_fewer_rows() {
        let spec = TensorSpec::u32([4, 3]);
        let cases = [
            (TensorSpec::u32([4, 3]), true, true),
            (TensorSpec::u32([2, 3]), false, true),
            (TensorSpec::u32([5, 3]), false, false),
            (TensorSpec::u32([4, 2]), false, false),
            (TensorSpec::u32([12]), false, false),
            (TensorSpec::f32([4, 3]), false, false),
        ];
        for (given, exact, up_to) in cases {
            assert_eq!(Extent::Exact.admits(&spec, &given), exact, "{given}");
            assert_eq!(Extent::UpTo.admits(&spec, &given), up_to, "{given}");
        }
    }
}
