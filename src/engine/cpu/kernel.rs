//! What runs one operation on the CPU, and how its tensors lie in memory.

use std::fmt::Debug;

use crate::engine::precision::Precision;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

/// How a map's elements follow each other in memory. Tensors that are no maps know one order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Layout {
    /// As the shape says: `[C, H, W]`, `[R, C, H, W]`.
    Planar,
    /// A pixel's channels side by side: `[H, W, C]`, `[R, H, W, C]`.
    ChannelsLast,
}

/// A tensor's values as a kernel reads them.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Data<'a> {
    /// Floats.
    F32(&'a [f32]),
    /// Indices, counts, packed pixels.
    U32(&'a [u32]),
    /// A picture's bytes where somebody else keeps them.
    Bytes(&'a [u8]),
}

impl<'a> Data<'a> {
    /// The values of a float tensor.
    ///
    /// # Errors
    /// [`Error::Tensor`] for an integer tensor.
    pub fn f32(self) -> Result<&'a [f32]> {
        match self {
            Self::F32(data) => Ok(data),
            _ => Err(Error::tensor("cpu", "input", "f32", "u32")),
        }
    }

    /// The values of an integer tensor.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a float tensor.
    pub fn u32(self) -> Result<&'a [u32]> {
        match self {
            Self::U32(data) => Ok(data),
            Self::F32(_) => Err(Error::tensor("cpu", "input", "u32", "f32")),
            Self::Bytes(_) => Err(Error::tensor("cpu", "input", "u32", "bytes")),
        }
    }

    /// The bytes of packed pixels.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a float tensor.
    pub fn bytes(self) -> Result<&'a [u8]> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            _ => self.u32().map(bytemuck::cast_slice),
        }
    }
}

/// One operation, ready to run: weights are packed, sizes are known.
pub(crate) trait Kernel: Debug + Send + Sync {
    /// The layout that input `index` must have.
    fn input_layout(&self, _index: usize) -> Layout {
        Layout::ChannelsLast
    }

    /// The layout in which outputs are written.
    fn output_layout(&self) -> Layout {
        Layout::ChannelsLast
    }

    /// Inputs whose values the kernel keeps in a form of its own: `run` does not read them.
    fn packed(&self) -> &'static [usize] {
        &[]
    }

    /// How far its outputs may be from the reference's, element by element, where it orders its sums
    /// otherwise than the shader to which [`crate::engine::ops::Op::tolerance`] belongs.
    ///
    /// # Errors
    /// As the operation's reference.
    fn tolerance(&self, _inputs: &[&Value]) -> Result<Option<Vec<f64>>> {
        Ok(None)
    }

    /// What it multiplies: f32 or bf16.
    fn precision(&self) -> Precision {
        Precision::F32
    }

    /// Computes the outputs. Those of integers hold their bits; what a count leaves undefined may
    /// keep any value.
    ///
    /// # Errors
    /// [`Error::Tensor`] for values that the operation refuses.
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> Result<()>;
}

/// Channels and pixels of a map: `[C, H, W]`, or `[R, C, H, W]` as R maps. `None` for other tensors.
pub(crate) fn map_sizes(spec: &TensorSpec) -> Option<(usize, usize, usize)> {
    match spec.shape.0[..] {
        [c, h, w] => Some((1, c, h * w)),
        [r, c, h, w] => Some((r, c, h * w)),
        _ => None,
    }
}

/// Copies a map of one layout to the other.
pub(crate) fn convert(spec: &TensorSpec, from: Layout, input: &[f32], output: &mut [f32]) {
    let Some((_, channels, pixels)) = map_sizes(spec) else {
        output.copy_from_slice(input);
        return;
    };
    let (rows, columns) = match from {
        Layout::Planar => (channels, pixels),
        Layout::ChannelsLast => (pixels, channels),
    };
    let map = rows * columns;
    if map == 0 {
        return;
    }
    for (input, output) in input.chunks_exact(map).zip(output.chunks_exact_mut(map)) {
        for (c, output) in output.chunks_exact_mut(rows).enumerate() {
            for (r, value) in output.iter_mut().enumerate() {
                *value = input[r * columns + c];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two maps of five channels of 2 × 3 pixels; channel c of pixel p of map r is 100 r + 10 c + p.
    #[test]
    fn each_channel_has_its_place_in_the_other_layout() {
        let value = |r: usize, c: usize, p: usize| (100 * r + 10 * c + p) as f32;
        let (mut planar, mut last) = (Vec::new(), Vec::new());
        for r in 0..2 {
            (0..5).for_each(|c| planar.extend((0..6).map(|p| value(r, c, p))));
            (0..6).for_each(|p| last.extend((0..5).map(|c| value(r, c, p))));
        }
        let spec = TensorSpec::f32([2, 5, 2, 3]);
        let mut got = vec![f32::NAN; 60];
        convert(&spec, Layout::ChannelsLast, &last, &mut got);
        assert_eq!(got, planar);
        convert(&spec, Layout::Planar, &planar, &mut got);
        assert_eq!(got, last);
    }
}
