//! Pooling over windows, over space and over channels, on channels-last maps.

use super::gemm::vectorised;
use super::kernel::{Data, Kernel, Layout};
use super::scratch::Scratch;
use crate::engine::cores::{each, each_with};
use crate::engine::ops::MaxPool2d;
use crate::engine::shape::TensorSpec;

/// Pixels whose sum is kept apart, so that the mean of a large map loses few digits.
const RUN: usize = 64;

/// The larger of two values; a NaN on either side stays.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b <= a || a.is_nan() { a } else { b }
}

/// Maximum in each window.
#[derive(Debug)]
pub(super) struct Windows {
    op: MaxPool2d,
    channels: usize,
    input: [usize; 2],
    output: [usize; 2],
}

impl Windows {
    pub fn new(op: MaxPool2d, input: &TensorSpec, output: &TensorSpec) -> Self {
        let size = |spec: &TensorSpec| [spec.shape.0[1], spec.shape.0[2]];
        Self { op, channels: input.shape.0[0], input: size(input), output: size(output) }
    }
}

impl Kernel for Windows {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let input = inputs[0].f32()?;
        let MaxPool2d { kernel, stride, padding } = self.op;
        let ([in_h, in_w], [_, out_w], channels) = (self.input, self.output, self.channels);
        let inside = |at: usize, length: usize| {
            let first = (at * stride).saturating_sub(padding);
            first..(at * stride + kernel).saturating_sub(padding).min(length)
        };
        let line = in_w * channels;
        each_with(
            outputs[0].chunks_mut(out_w * channels).enumerate(),
            || Scratch::new(line),
            |most, (oy, row)| {
                vectorised(
                    #[inline(always)]
                    || {
                        // Down the columns of whole lines first, which are long, then along.
                        most.fill(f32::NEG_INFINITY);
                        for y in inside(oy, in_h) {
                            for (most, x) in most.iter_mut().zip(&input[y * line..][..line]) {
                                *most = larger(*most, *x);
                            }
                        }
                        for (ox, out) in row.chunks_exact_mut(channels).enumerate() {
                            out.fill(f32::NEG_INFINITY);
                            for x in inside(ox, in_w) {
                                let from = &most[x * channels..][..channels];
                                for (out, value) in out.iter_mut().zip(from) {
                                    *out = larger(*out, *value);
                                }
                            }
                        }
                    },
                );
            },
        );
        Ok(())
    }
}

/// Mean, and maximum if wanted, of each channel over space, of one or several maps.
#[derive(Debug)]
pub(super) struct OverSpace {
    /// Channels of each map.
    channels: Vec<usize>,
    with_maximum: bool,
}

impl OverSpace {
    /// `with_maximum`: a second row of maxima behind the means.
    pub fn new(inputs: &[TensorSpec], with_maximum: bool) -> Self {
        Self { channels: inputs.iter().map(|map| map.shape.0[0]).collect(), with_maximum }
    }

    /// Of one map; `maxima` may be empty.
    fn reduce(input: &[f32], means: &mut [f32], maxima: &mut [f32]) {
        let channels = means.len();
        // Partial sums and maxima of runs of pixels, in parallel; then their sum in order.
        let runs = input.chunks(RUN * channels);
        let mut parts = vec![0.0f32; runs.len() * 2 * channels];
        each(parts.chunks_mut(2 * channels).zip(runs), |(part, run)| {
            let (sum, most) = part.split_at_mut(channels);
            most.fill(f32::NEG_INFINITY);
            vectorised(
                #[inline(always)]
                || {
                    for pixel in run.chunks_exact(channels) {
                        for ((sum, most), x) in sum.iter_mut().zip(most.iter_mut()).zip(pixel) {
                            *sum += x;
                            *most = largest_number(*most, *x);
                        }
                    }
                    for (c, most) in most.iter_mut().enumerate().filter(|(c, _)| sum[*c].is_nan()) {
                        let all = run.iter().skip(c).step_by(channels);
                        *most = all.fold(f32::NEG_INFINITY, |most, x| larger(most, *x));
                    }
                },
            );
        });
        let mut total = vec![0f64; channels];
        maxima.fill(f32::NEG_INFINITY);
        for part in parts.chunks(2 * channels) {
            let (sum, most) = part.split_at(channels);
            for (total, sum) in total.iter_mut().zip(sum) {
                *total += f64::from(*sum);
            }
            for (out, most) in maxima.iter_mut().zip(most) {
                *out = larger(*out, *most);
            }
        }
        let pixels = (input.len() / channels) as f64;
        for (mean, total) in means.iter_mut().zip(total) {
            *mean = (total / pixels) as f32;
        }
    }
}

impl Kernel for OverSpace {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let mut rest = &mut *outputs[0];
        for (map, channels) in inputs.iter().zip(&self.channels) {
            let (means, behind) = rest.split_at_mut(*channels);
            let maxima = if self.with_maximum { *channels } else { 0 };
            let (maxima, behind) = behind.split_at_mut(maxima);
            Self::reduce(map.f32()?, means, maxima);
            rest = behind;
        }
        Ok(())
    }
}

/// Pixels that one thread reduces over their channels at a time.
const PART: usize = 256;

/// Maximum and mean over the channels of a gated map.
#[derive(Debug)]
pub(super) struct OverChannels {
    channels: usize,
    pixels: usize,
}

impl OverChannels {
    pub fn new(input: &TensorSpec) -> Self {
        let [channels, height, width] = [0, 1, 2].map(|i| input.shape.0[i]);
        Self { channels, pixels: height * width }
    }
}

/// Channels that are reduced side by side, and pixels whose lanes are then reduced together.
const LANES: usize = 16;

/// The largest gated value of a pixel's channels, and their mean.
#[inline(always)]
fn over_channels(pixels: &[f32], gate: &[f32], largest: &mut [f32], means: &mut [f32]) {
    let channels = gate.len();
    let mut lanes = [([0.0f32; LANES], [f32::NEG_INFINITY; LANES]); LANES];
    let (gates, last_gates) = gate.as_chunks::<LANES>();
    for (pixel, (sum, most)) in pixels.chunks_exact(channels).zip(&mut lanes) {
        let (pixel, last) = pixel.as_chunks::<LANES>();
        for (pixel, gate) in pixel.iter().zip(gates) {
            for i in 0..LANES {
                let gated = pixel[i] * gate[i];
                sum[i] += gated;
                most[i] = largest_number(most[i], gated);
            }
        }
        for (i, (x, gate)) in last.iter().zip(last_gates).enumerate() {
            sum[i] += x * gate;
            most[i] = largest_number(most[i], x * gate);
        }
    }
    // Each pixel's lanes become one, all pixels side by side.
    let (mut sums, mut most) = ([0.0; LANES], [f32::NEG_INFINITY; LANES]);
    for lane in 0..LANES {
        for (i, (sum_of, most_of)) in lanes.iter().enumerate() {
            sums[i] += sum_of[lane];
            most[i] = largest_number(most[i], most_of[lane]);
        }
    }
    let results = largest.iter_mut().zip(means).zip(sums.iter().zip(most));
    for ((largest, mean), (sum, most)) in results {
        (*largest, *mean) = (most, sum / channels as f32);
    }
}

/// The larger of two numbers. A NaN is lost, but a sum of the same numbers shows that there is one.
#[inline(always)]
fn largest_number(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl Kernel for OverChannels {
    fn output_layout(&self) -> Layout {
        Layout::Planar
    }

    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> crate::error::Result<()> {
        let (input, gate) = (inputs[0].f32()?, inputs[1].f32()?);
        let (largest, means) = outputs[0].split_at_mut(self.pixels);
        let channels = self.channels;
        let pixels = input.chunks(PART * channels);
        each(
            largest.chunks_mut(PART).zip(means.chunks_mut(PART)).zip(pixels),
            |((largest, means), pixels)| {
                vectorised(
                    #[inline(always)]
                    || {
                        let blocks = largest.chunks_mut(LANES).zip(means.chunks_mut(LANES));
                        for ((largest, means), pixels) in
                            blocks.zip(pixels.chunks(LANES * channels))
                        {
                            over_channels(pixels, gate, largest, means);
                            if means.iter().any(|mean| mean.is_nan()) {
                                let gated = pixels.chunks_exact(channels).map(|pixel| {
                                    let gated = pixel.iter().zip(gate).map(|(x, gate)| x * gate);
                                    gated.fold(f32::NEG_INFINITY, larger)
                                });
                                largest.iter_mut().zip(gated).for_each(|(to, most)| *to = most);
                            }
                        }
                    },
                );
            },
        );
        Ok(())
    }
}
