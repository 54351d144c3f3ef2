//! 2-D convolution with bias, optional residual and ReLU.

mod direct;
mod planar;
mod winograd;

pub(super) use direct::{Direct, Weights};
pub(super) use planar::Planar;
pub(super) use winograd::Winograd;

use crate::engine::graph::TensorId;
use crate::engine::kernels::{Recording, Work};
use crate::engine::ops::{Conv2d, Op};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Constant, Tensor};
use crate::error::Result;

/// The sizes of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sizes {
    in_c: usize,
    out_c: usize,
    kh: usize,
    kw: usize,
    out_h: usize,
    out_w: usize,
}

impl Sizes {
    fn of(op: &Conv2d, work: &Work) -> Self {
        let (_, weight, _, _) = op.split(work.inputs);
        let [out_c, in_c, kh, kw] = [0, 1, 2, 3].map(|i| weight.shape.0[i]);
        let [out_h, out_w] = [1, 2].map(|i| work.outputs[0].shape.0[i]);
        Self { in_c, out_c, kh, kw, out_h, out_w }
    }
}

/// Whether weights and bias are known when recording.
fn weights_known(op: &Conv2d, known: &[bool]) -> bool {
    let (_, weight, bias, _) = op.split(known);
    *weight && bias.is_none_or(|known| *known)
}

/// The bias, zero where there is none, up to a whole number of `tile` channels.
fn padded_bias(
    op: &Conv2d,
    recording: &Recording,
    bias: Option<&TensorId>,
    channels: usize,
    tile: usize,
) -> Result<Constant> {
    let padded = channels.next_multiple_of(tile);
    Ok(match bias {
        Some(id) => {
            recording.weights(op.name(), *id)?.packed(TensorSpec::f32([padded]), move |bias| {
                Tensor::from_fn([padded], |i| bias.data().get(i).copied().unwrap_or(0.0))
            })
        }
        None => Tensor::<f32>::zeros([padded]).into(),
    })
}
