//! A convolution's sizes, and what happens to its sums.

use super::words::Numbers;

/// Sizes of a convolution's maps and kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct MapShape {
    pub in_c: usize,
    pub in_h: usize,
    pub in_w: usize,
    pub out_c: usize,
    pub out_h: usize,
    pub out_w: usize,
    pub kh: usize,
    pub kw: usize,
}

impl MapShape {
    /// Output pixels.
    pub fn pixels(&self) -> usize {
        self.out_h * self.out_w
    }

    /// Products in one output.
    pub fn terms(&self) -> usize {
        self.in_c * self.kh * self.kw
    }

    /// The same, with those that fill up a pixel's words.
    pub fn padded_terms(&self, numbers: Numbers) -> usize {
        self.in_c.next_multiple_of(numbers.a_word()) * self.kh * self.kw
    }
}

/// What happens to a finished sum.
#[derive(Debug)]
pub(super) struct Epilogue {
    pub bias: Vec<f32>,
    pub relu: bool,
}

impl Epilogue {
    /// `out[o] = relu(sums[o] + bias[o] (+ residual[o]))` for the channels from `first`; NaN stays.
    #[inline(always)]
    pub fn apply(&self, out: &mut [f32], sums: &[f32], first: usize, residual: Option<&[f32]>) {
        let bias = &self.bias[first..][..out.len()];
        let relu = |x: f32| if self.relu && x < 0.0 { 0.0 } else { x };
        match residual {
            Some(residual) => {
                for (((out, sum), bias), r) in out.iter_mut().zip(sums).zip(bias).zip(residual) {
                    *out = relu(sum + bias + r);
                }
            }
            None => {
                for ((out, sum), bias) in out.iter_mut().zip(sums).zip(bias) {
                    *out = relu(sum + bias);
                }
            }
        }
    }
}
