//! Error bounds that several operations share, in terms of f32's unit roundoff [`EPS`].
//!
//! A sum in floating point is a tree: its leaves are the terms, each node an addition that rounds.
//! A term that meets at most h roundings on its way to the root carries a factor between (1 − ε)ʰ
//! and (1 + ε)ʰ, so the sum is off by at most γₕ·Σ|terms|, γₕ = hε/(1 − hε) (Higham, Accuracy and
//! Stability of Numerical Algorithms, 2nd edition, §3.1 and §4.2). So what counts is not how many
//! terms there are but how deep the tree is, which is the kernel's choice: [`SumOrder`] says it.
//!
//! Held to its own tree a kernel cannot hide a shorter number format. Rounding 1 + 2⁻¹² to f16
//! changes it by 4096ε, the same way each time; the deepest tree of the network has about 800
//! levels. A bound of n·ε for sums of n terms, or Higham and Mary's λ√n·ε (SIAM J. Sci. Comput. 41,
//! 2019), which holds but for a chance of about 2n·exp(−λ²/2), would serve too up to n = 4096 and
//! n = 160 000 with λ = 10; the tree's needs no chance.

use crate::engine::ops::op::EPS;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

/// Magnitudes from which on some order of a sum may overflow f32: its end, less what roundings add.
const OVERFLOW: f64 = 0.99 * f32::MAX as f64;

/// The order in which a kernel adds up products.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SumOrder {
    /// Products that are added one after the other to make a part.
    pub terms: usize,
    /// Parts.
    pub parts: usize,
    /// How the parts come together.
    pub joined: Joined,
    /// Further values that are added one after the other: a bias, a residual.
    pub more: usize,
}

/// How the parts of a sum come together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Joined {
    /// One after the other.
    InOrder,
    /// Two and two, and so on.
    ByTree,
    /// So many one after the other, so many of those sums one after the other, and so on.
    Nested([usize; 3]),
}

impl SumOrder {
    /// `terms` products one after the other.
    pub fn serial(terms: usize) -> Self {
        Self { terms, parts: 1, joined: Joined::InOrder, more: 0 }
    }

    /// `count` products dealt out to `parts` invocations, whose sums a tree adds up.
    pub fn dealt(count: usize, parts: usize) -> Self {
        Self { terms: count.div_ceil(parts), parts, joined: Joined::ByTree, more: 0 }
    }

    /// Sums of `terms` products, brought together by so many at each of three levels.
    pub fn nested(terms: usize, levels: [usize; 3]) -> Self {
        let parts = levels.iter().product();
        Self { terms, parts, joined: Joined::Nested(levels), more: 0 }
    }

    /// The same with `more` values added to it.
    pub fn and(self, more: usize) -> Self {
        Self { more, ..self }
    }

    /// Roundings that a product meets at most: its own and those of the additions behind it. (The
    /// first of a sum is added to zero, which is exact; a fused multiply-add only spares some.)
    pub fn roundings(&self) -> usize {
        let joins = match self.joined {
            Joined::InOrder => self.parts.saturating_sub(1),
            Joined::ByTree => self.parts.next_power_of_two().ilog2() as usize,
            Joined::Nested(levels) => levels.iter().map(|n| n.saturating_sub(1)).sum(),
        };
        self.terms + joins + self.more
    }

    /// Bound for the sum, where `magnitude` is the sum of the absolute values of all terms. One
    /// rounding is the reference's own, one that of `magnitude`. The rest is for drivers that flush
    /// subnormal numbers to zero, at any operation. Infinite where a part of the sum may overflow f32.
    pub fn error(&self, magnitude: f64) -> f64 {
        if magnitude > OVERFLOW {
            return f64::INFINITY;
        }
        let operations = 2 * self.terms * self.parts + self.more + 1;
        gamma(self.roundings() + 2) * magnitude + operations as f64 * f64::from(f32::MIN_POSITIVE)
    }
}

/// γₙ = nε/(1 − nε): the largest relative error of n roundings in a row.
pub fn gamma(n: usize) -> f64 {
    let error = n as f64 * EPS;
    error / (1.0 - error)
}

/// Bound for a value that went through at most `roundings` sums and products in a row, where
/// `magnitude` is the sum of the terms' absolute values. The rest is for drivers that flush
/// subnormal numbers to zero.
pub fn sum_error(roundings: usize, magnitude: f64) -> f64 {
    gamma(roundings) * magnitude + roundings as f64 * f64::from(f32::MIN_POSITIVE)
}

/// Bound for the logistic function of a logit that is `logit_error` off: its slope is at most 1/4.
/// WGSL lets exp(x) be 3 + 2|x| ULP off, which the slope turns into at most 2.5 EPS, and the
/// division 2.5 ULP, which is 5 EPS; the sum in the denominator and the rounding add 2.
pub fn sigmoid_error(logit_error: f64) -> f64 {
    logit_error / 4.0 + 10.0 * EPS
}

/// What weights that are off by their bounds make of a sum, which come to `moved`.
pub fn moved_sum(moved: f64) -> f64 {
    // With room for the roundings of the sum itself, which are a thousand times smaller.
    1.001 * moved
}

/// The absolute values of a tensor, to compute magnitudes with the operation's own reference.
///
/// # Errors
/// As [`Value::f32`].
pub fn magnitude(value: &Value) -> Result<Tensor> {
    let tensor = value.f32()?;
    Ok(Tensor::from_fn(tensor.shape().clone(), |i| tensor.data()[i].abs()))
}

/// Bound for a mean whose sum is ordered so, of values whose mean absolute value is `magnitude`; the
/// division is 2.5 ULP off, which is 5 roundings. (The values are no products, so one is spare.)
pub fn mean_error(order: SumOrder, magnitude: f64) -> f64 {
    order.and(order.more + 5).error(magnitude)
}

/// Invocations that share the sum of a map over space, and so its parts.
pub const PARTIAL_SUMS: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative to a sum of positive terms, what f16 makes of 1 + 2⁻¹².
    const HALF: f64 = 1.0 - 1.0 / (1.0 + 1.0 / 4096.0);

    #[test]
    fn roundings_are_the_depth_of_the_tree() {
        assert_eq!(SumOrder::serial(7).roundings(), 7);
        // 100 products in 64 parts of at most 2, six levels of a tree, a bias.
        assert_eq!(SumOrder::dealt(100, 64).and(1).roundings(), 2 + 6 + 1);
        let taps = SumOrder { terms: 512, parts: 9, joined: Joined::InOrder, more: 2 };
        assert_eq!(taps.roundings(), 512 + 8 + 2);
        // Rows of 20 values, ten of them, eight such parts, four chunks.
        assert_eq!(SumOrder::nested(20, [10, 8, 4]).roundings(), 20 + 9 + 7 + 3);
    }

    /// The deepest sum of the network, fc6: 16 slices of 784 products and a bias.
    #[test]
    fn half_precision_is_past_the_deepest_sum() {
        let fc6 = SumOrder { terms: 784, parts: 16, joined: Joined::InOrder, more: 1 };
        assert!(4.0 * fc6.error(1.0) < HALF, "{:e} {HALF:e}", fc6.error(1.0));
    }

    /// Sums in f32 of the worst kind, all terms equal and not representable, stay within the bound.
    #[test]
    fn sums_stay_within_their_bound() {
        let term = 0.1f32;
        for order in [
            SumOrder::serial(4096),
            SumOrder::dealt(25_600, 64),
            SumOrder { terms: 512, parts: 9, joined: Joined::InOrder, more: 0 },
            SumOrder::nested(20, [20, 8, 8]),
        ] {
            let part: f32 = (0..order.terms).map(|_| term * term).sum();
            let mut parts = vec![part; order.parts];
            let total: f32 = match order.joined {
                Joined::InOrder => parts.iter().sum(),
                Joined::ByTree => {
                    while parts.len() > 1 {
                        parts = parts.chunks(2).map(|pair| pair.iter().sum()).collect();
                    }
                    parts[0]
                }
                Joined::Nested(levels) => {
                    for level in levels {
                        parts = parts.chunks(level).map(|sums| sums.iter().sum()).collect();
                    }
                    parts[0]
                }
            };
            let exact = (order.terms * order.parts) as f64 * f64::from(term).powi(2);
            let error = (f64::from(total) - exact).abs();
            assert!(error <= order.error(exact), "{order:?}: {error:e}");
            assert!(error > 0.0);
        }
    }
}
