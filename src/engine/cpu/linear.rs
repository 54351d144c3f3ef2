//! A fully connected layer on the rows that there are.

use std::sync::Arc;

use super::gemm::{Panels, Part, order, order_of_pairs, pairs};
use super::kernel::{Data, Kernel, Layout, map_sizes};
use super::packs::Pack;
use crate::engine::ops::Linear;
use crate::engine::ops::bounds::magnitude;
use crate::engine::ops::linear::rows;
use crate::engine::precision::Precision;
use crate::engine::reference;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// Weights in [`Panels`], whose inputs are in the order of channels-last maps.
#[derive(Debug)]
pub(super) struct FullyConnected {
    op: Linear,
    rows: usize,
    /// How a row lies.
    layout: Layout,
    /// Inputs of a row.
    inner: usize,
    /// Whether products are of pairs in bf16.
    pairs: bool,
    weight: Arc<Vec<f32>>,
    bias: Vec<f32>,
}

impl FullyConnected {
    /// Packs the weights of `op` for an input of this shape, where no plan has.
    ///
    /// # Errors
    /// As [`Pack::get`].
    pub fn new(op: Linear, input: &TensorSpec, bias: &Tensor, pack: Pack) -> Result<Self> {
        let [outputs, inner] = [0, 1].map(|i| pack.dims()[i]);
        // Where a row is a map [C, H, W], it comes as [H, W, C].
        let (layout, channels, pixels) = match map_sizes(input) {
            Some((_, channels, pixels)) if input.shape.rank() == 4 => {
                (Layout::ChannelsLast, channels, pixels)
            }
            _ => (Layout::Planar, inner, 1),
        };
        let pairs = pack.pairs && inner.is_multiple_of(2);
        let channels_last = |weight: &Tensor| {
            Panels::packed((outputs, inner), pairs, |o, k| {
                let (pixel, channel) = (k / channels, k % channels);
                weight.data()[o * inner + channel * pixels + pixel]
            })
        };
        let weight = pack.get(if pairs { "linear in bf16" } else { "linear" }, channels_last)?;
        let rows = rows(&input.shape);
        Ok(Self { op, rows, layout, inner, pairs, weight, bias: bias.data().to_vec() })
    }
}

impl Kernel for FullyConnected {
    fn input_layout(&self, _index: usize) -> Layout {
        self.layout
    }

    fn output_layout(&self) -> Layout {
        Layout::Planar
    }

    fn packed(&self) -> &'static [usize] {
        &[1, 2]
    }

    fn precision(&self) -> Precision {
        if self.pairs { Precision::Bf16 } else { Precision::F32 }
    }

    fn tolerance(&self, inputs: &[&Value]) -> crate::error::Result<Option<Vec<f64>>> {
        let (input, weight) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let sums = reference::linear(&input, &weight, &magnitude(inputs[2])?, self.rows, false);
        let order = if self.pairs { order_of_pairs(self.inner) } else { order(self.inner) }.and(1);
        Ok(Some(sums.data().iter().map(|sum| order.error(f64::from(*sum))).collect()))
    }

    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let input = inputs[0].f32()?;
        let rows = match self.op.count {
            true => self.rows.min(inputs[3].u32()?[0] as usize),
            false => self.rows,
        };
        let outputs_a_row = self.bias.len();
        let input = &input[..rows * self.inner];
        let parts = match self.pairs {
            false => Panels::of(&self.weight, outputs_a_row, self.inner).shared(input, rows),
            true => {
                let panels = Panels::of_pairs(&self.weight, outputs_a_row, self.inner / 2);
                panels.shared(&pairs(input), rows)
            }
        };
        for Part { first, outputs: count, rows, sums } in parts {
            let bias = &self.bias[first..][..count];
            for (row, sums) in rows.zip(sums.chunks_exact(count)) {
                let to = &mut outputs[0][row * outputs_a_row + first..][..count];
                for ((to, sum), bias) in to.iter_mut().zip(sums).zip(bias) {
                    let value = sum + bias;
                    *to = if self.op.relu && value < 0.0 { 0.0 } else { value };
                }
            }
        }
        Ok(())
    }
}
