//! A fully connected layer on the rows that there are.

use std::sync::Arc;

use super::gemm::{Inputs, Panels, Part, order};
use super::kernel::{Data, Kernel, Layout, map_sizes};
use super::packs::Pack;
use super::tiles::Rows;
use super::words::{self, Numbers};
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
    /// What is multiplied.
    numbers: Numbers,
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
        let numbers = pack.numbers_of(outputs, inner.next_multiple_of(4), true);
        let padded = inner.next_multiple_of(numbers.a_word());
        let channels_last = |weight: &Tensor| {
            Panels::packed((outputs, padded), numbers, |o, k| {
                let (pixel, channel) = (k / channels, k % channels);
                if k < inner { weight.data()[o * inner + channel * pixels + pixel] } else { 0.0 }
            })
        };
        let weight = pack.get("linear", numbers, channels_last)?;
        let rows = rows(&input.shape);
        Ok(Self { op, rows, layout, inner, numbers, weight, bias: bias.data().to_vec() })
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
        self.numbers.precision()
    }

    fn tolerance(&self, inputs: &[&Value]) -> crate::error::Result<Option<Vec<f64>>> {
        let (input, weight) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let sums = reference::linear(&input, &weight, &magnitude(inputs[2])?, self.rows, false);
        let order = order(self.numbers, self.inner, 1);
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
        let weight = Panels::of(&self.weight, (outputs_a_row, self.inner), self.numbers);
        let rounded = words::rows(self.numbers, input, self.inner);
        let words = self.inner.div_ceil(self.numbers.a_word());
        let lie = Rows::contiguous(&rounded.words, words);
        let inputs = Inputs { rows: lie, scales: &rounded.scales };
        for Part { first, outputs: count, stride, rows, sums } in weight.shared(&inputs, rows) {
            let bias = &self.bias[first..][..count];
            for (row, sums) in rows.zip(sums.chunks_exact(stride)) {
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
