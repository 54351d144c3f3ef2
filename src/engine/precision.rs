//! How numbers are stored on a GPU, or multiplied on cores; sums are in f32 always.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::engine::tensor::Tensor;
use crate::error::{Error, Result};

/// How a GPU stores maps, and the weights of convolutions and layers, or how cores multiply them. Sums are in
/// f32, and so is all that scores and boxes are made of.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32 bits.
    #[default]
    F32,
    /// IEEE 754's binary16: 11 bits of significand, at most 65504, which is half the memory. For GPUs.
    F16,
    /// The upper half of an f32: 8 bits of significand. For cores that multiply it, by AVX-512 BF16 or
    /// NEON BF16; maps stay in f32.
    Bf16,
    /// Integers of 8 bits, by scales: of each output's weights, each row of a layer's input, each map that a
    /// convolution reads. For cores that multiply them, by AVX-512 VNNI, AVX-VNNI or NEON's dot products; maps stay in
    /// f32.
    Int8,
}

/// Largest relative error of rounding to f16: half the distance from 1 to the next one.
pub(crate) const HALF_EPS: f64 = 1.0 / 2048.0;
/// Smallest f16 that is not subnormal; what is smaller a driver may take for zero.
pub(crate) const HALF_MIN: f64 = 1.0 / 16384.0;
/// From here on numbers round to infinity in f16.
pub(crate) const HALF_OVERFLOW: f64 = 65520.0;

impl Precision {
    /// Bytes of four numbers.
    pub(crate) fn texel_bytes(self) -> u32 {
        match self {
            Self::F32 | Self::Bf16 | Self::Int8 => 16,
            Self::F16 => 8,
        }
    }

    /// Whether numbers take 16 bits.
    pub(crate) fn is_half(self) -> bool {
        self == Self::F16
    }

    /// The bytes in which the numbers are stored.
    pub(crate) fn encode(self, numbers: &[f32]) -> Vec<u8> {
        match self {
            Self::F32 | Self::Bf16 | Self::Int8 => bytemuck::cast_slice(numbers).to_vec(),
            Self::F16 => {
                let halves: Vec<u16> =
                    numbers.iter().map(|x| half::f16::from_f32(*x).to_bits()).collect();
                bytemuck::cast_slice(&halves).to_vec()
            }
        }
    }

    /// The numbers that are stored so.
    pub(crate) fn decode(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::F32 | Self::Bf16 | Self::Int8 => bytemuck::pod_collect_to_vec(bytes),
            Self::F16 => {
                let halves: Vec<u16> = bytemuck::pod_collect_to_vec(bytes);
                halves.into_iter().map(|x| half::f16::from_bits(x).to_f32()).collect()
            }
        }
    }

    /// The nearest numbers that every driver stores as they are: none is subnormal.
    pub(crate) fn rounded(self, tensor: &Tensor) -> Tensor {
        let round = |x: f32| match self {
            // What a number of 8 bits stands for depends on the others: the cores' own module rounds to them.
            Self::F32 | Self::Int8 => x,
            Self::F16 if f64::from(x.abs()) < HALF_MIN => 0.0f32.copysign(x),
            Self::F16 => half::f16::from_f32(x).to_f32(),
            // Instructions take what is subnormal for zero.
            Self::Bf16 if x.is_subnormal() => 0.0f32.copysign(x),
            Self::Bf16 => half::bf16::from_f32(x).to_f32(),
        };
        let data = tensor.data();
        Tensor::from_fn(tensor.shape().clone(), |i| round(data[i]))
    }

    /// How far a number may be from `value` once it is stored, if it was at most `error` off before.
    /// Infinite where it may overflow.
    pub(crate) fn stored_error(self, value: f64, error: f64) -> f64 {
        let most = value.abs() + error;
        match self {
            Self::F32 | Self::Bf16 | Self::Int8 => error,
            // Not `most < HALF_OVERFLOW`: of a NaN nothing is known.
            Self::F16 if most >= HALF_OVERFLOW || most.is_nan() => f64::INFINITY,
            Self::F16 if value.abs() - error >= HALF_MIN => error + HALF_EPS * most,
            // Maybe subnormal, and then taken for zero.
            Self::F16 => error + (HALF_EPS * most).max(most.min(HALF_MIN)),
        }
    }
}

/// The power of two in which the largest weight of an output is stored: sums stay far from f32's end,
/// and small weights from what is subnormal.
const WEIGHT_EXPONENT: i32 = 8;

/// By output, the first dimension, the power of two that its weights are multiplied with before they are
/// stored in f16: the largest is then about 2⁸, so that the range of f16 is no matter.
pub(crate) fn weight_powers(weight: &Tensor) -> Vec<f32> {
    let inner = weight.dims().iter().skip(1).product::<usize>().max(1);
    let outputs = weight.data().chunks(inner);
    outputs
        .map(|of_output| {
            let largest = of_output.iter().fold(0.0f32, |a, b| a.max(b.abs()));
            // What has no such power is stored as it is.
            let exponent = if largest.is_normal() {
                WEIGHT_EXPONENT - f64::from(largest).log2().floor() as i32
            } else {
                0
            };
            2f32.powi(exponent.clamp(-126, 126))
        })
        .collect()
}

/// Weights times the powers of their outputs.
pub(crate) fn powered(weight: &Tensor, powers: &[f32]) -> Tensor {
    let inner = weight.dims().iter().skip(1).product::<usize>().max(1);
    let data = weight.data();
    Tensor::from_fn(weight.shape().clone(), |i| data[i] * powers[i / inner])
}

/// How far weights that are stored so may be from themselves: rounded, or taken for zero below
/// [`HALF_MIN`], which is 2⁻²² of the largest.
pub(crate) fn weight_errors(weight: &Tensor) -> Tensor {
    let inner = weight.dims().iter().skip(1).product::<usize>().max(1);
    let (data, powers) = (weight.data(), weight_powers(weight));
    Tensor::from_fn(weight.shape().clone(), |i| weight_error(data[i], powers[i / inner]))
}

/// The same of one weight with its power. (What it is on f32's own subnormal numbers is the second.)
pub(crate) fn weight_error(weight: f32, power: f32) -> f32 {
    let tiny = (HALF_MIN as f32 / power).max(f32::MIN_POSITIVE);
    if weight.abs() < tiny { weight.abs() } else { HALF_EPS as f32 * weight.abs() }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
            Self::Int8 => "int8",
        })
    }
}

impl FromStr for Precision {
    type Err = Error;

    /// `f32`, `f16`, `bf16` or `int8`.
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "f32" => Ok(Self::F32),
            "f16" => Ok(Self::F16),
            "bf16" => Ok(Self::Bf16),
            "int8" => Ok(Self::Int8),
            other => {
                let expected = "`f32`, `f16`, `bf16` or `int8`";
                Err(Error::param("detect", "precision", expected, format!("`{other}`")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_rounded() {
        let numbers = [0.0, -1.5, 0.1, 65504.0, 65519.0, 65520.0, -1e9, 3e-5, f32::NAN];
        assert_eq!(Precision::F32.decode(&Precision::F32.encode(&numbers))[..8], numbers[..8]);
        let back = Precision::F16.decode(&Precision::F16.encode(&numbers));
        let inf = f32::INFINITY;
        // 0.1 is 1638.4 · 2⁻¹⁴; 3e-5, 503.3 · 2⁻²⁴.
        let tenth = 1638.0 / 16384.0;
        let tiny = 503.0 / 16_777_216.0;
        assert_eq!(back[..8], [0.0, -1.5, tenth, 65504.0, 65504.0, inf, -inf, tiny]);
        assert!(back[8].is_nan());
        let tensor = Tensor::from_fn([4], |i| [0.1, 3e-5, -3e-5, 65520.0][i]);
        let rounded = Precision::F16.rounded(&tensor);
        assert_eq!(rounded.data(), [tenth, 0.0, 0.0, inf]);
        assert!(rounded.data()[2].is_sign_negative());
        assert_eq!(Precision::F32.rounded(&tensor), tensor);
    }

    /// Over 12 decades each output's weights keep their digits, and their bound.
    #[test]
    fn weights_are_stored_near_the_middle_of_the_range() {
        let size = |o: usize| 10f32.powi(o as i32 - 6);
        let weight =
            Tensor::from_fn([13, 50], |i| size(i / 50) * (0.83f32.powi(i as i32 % 50) * -1.7));
        let powers = weight_powers(&weight);
        let stored = powered(&weight, &powers);
        let stored = Precision::F16.decode(&Precision::F16.encode(stored.data()));
        let errors = weight_errors(&weight);
        for (i, x) in weight.data().iter().enumerate() {
            let got = stored[i] / powers[i / 50];
            assert!((got - x).abs() <= errors.data()[i], "{x}: {got}");
            assert!(errors.data()[i] <= x.abs() / 2048.0 * 1.0001, "{x}");
        }
        let odd = Tensor::from_fn([4, 1], |i| [0.0, f32::INFINITY, 1e-40, f32::MAX][i]);
        assert_eq!(weight_powers(&odd)[..3], [1.0; 3]);
        assert_eq!(f32::MAX * weight_powers(&odd)[3], 511.99997);
    }

    #[test]
    fn bounds_hold_for_every_number() {
        let half = Precision::F16;
        for i in 0..4000 {
            let x = 1.37f32.powi(i % 80 - 40) * (1.0 + i as f32 / 4001.0);
            let error = (f64::from(half.decode(&half.encode(&[x]))[0]) - f64::from(x)).abs();
            let bound = half.stored_error(f64::from(x), 0.0);
            assert!(
                error <= bound && (bound.is_infinite() == (x >= 65520.0)),
                "{x}: {error} {bound}"
            );
            assert!(f64::from(x) > HALF_OVERFLOW || bound <= f64::from(x), "{x}");
        }
        assert_eq!(half.stored_error(65000.0, 600.0), f64::INFINITY);
        assert_eq!(half.stored_error(f64::NAN, 0.0), f64::INFINITY);
        assert_eq!(Precision::F32.stored_error(1e9, 0.5), 0.5);
        // A zero that may as well be subnormal.
        assert_eq!(half.stored_error(0.0, 1e-6), 2e-6);
    }
}
