//! One tensor of a run: its own error, its bias, and how far the chain has drifted.

use crate::engine::ops::op::{Op, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shape::Shape;
use crate::engine::tensor::Value;

/// A bias of a tensor's errors counts from so many of its standard deviations. By Hoeffding's
/// inequality chance goes past it in fewer than one tensor in 10¹⁰ (2·exp(−7²/2) = 5·10⁻¹¹).
const DEVIATIONS: f64 = 7.0;

/// One tensor that the device computed, beside what the reference makes of the same inputs.
#[derive(Clone, Debug)]
pub struct TensorComparison {
    /// Name of the tensor.
    pub name: String,
    /// The largest error / bound of an element, which the operation gives: at most 1
    /// on a device that computes as it should. Where bits count, as of indices, counts and copies, it
    /// is 0, or infinite if one differs.
    pub share: f64,
    /// For sums of products: how far the tensor as a whole is scaled, as a share of what roundings
    /// that fall to either side leave of that. `None` for other operations.
    pub bias: Option<f64>,
    /// How far the device is from the reference that saw the picture alone: what the errors of all
    /// operations so far have become, relative in the L2 norm, in the rows that both chose. `None`
    /// for integers. A norm below 1, such as that of the scores of a picture without a snap, counts
    /// as 1, a score's scale. Yaws of classes without a direction count for nothing.
    pub drift: Option<f64>,
    /// What is wrong, in words.
    pub failure: Option<String>,
}

impl TensorComparison {
    /// Holds the first `defined` elements of an output of `op` to the reference's, on a device that
    /// stores weights in `precision`.
    pub(super) fn new(
        name: &str,
        op: &dyn Op,
        precision: Precision,
        got: &Value,
        want: &Value,
        tolerance: &Tolerance,
        defined: usize,
    ) -> Self {
        let mut share = 0f64;
        let mut wrong = 0;
        let mut first = None;
        for i in 0..defined {
            let (error, limit) = tolerance.judge(got, want, i);
            if error == 0.0 {
                continue;
            }
            let of_limit = error / limit;
            // Not `of_limit > 1`: a NaN must fail.
            if of_limit <= 1.0 {
                share = share.max(of_limit);
            } else {
                share = if of_limit.is_nan() { f64::INFINITY } else { share.max(of_limit) };
                wrong += 1;
                first.get_or_insert((i, limit));
            }
        }
        let bias = op.unbiased().then(|| bias(got, want, precision, tolerance, defined)).flatten();
        let failure = match (first, bias) {
            (Some((i, limit)), _) => {
                let (got, want) = (got.show(i), want.show(i));
                Some(format!(
                    "{name}: {wrong} of {defined} elements wrong: element {i}: expected {want} ± \
                     {limit:.1e}, got {got}"
                ))
            }
            // A NaN must fail.
            (None, None | Some(..=1.0)) => None,
            (None, Some(bias)) => {
                Some(format!("{name}: scaled by {bias:.1} times what roundings leave"))
            }
        };
        Self { name: name.into(), share, bias, drift: None, failure }
    }
}

/// With errors e, bounds b and the reference's values y: the common factor that fits the errors best
/// is Σey / Σy². If each error is a rounding of its own, of mean 0 and at most b, then |Σey| is above
/// d·√Σ(by)² with a probability of at most 2·exp(−d²/2) (Hoeffding 1963), while errors that all agree
/// may reach Σb|y|. Neighbours that are equal to the bit, as where a picture is flat, are the same sum
/// again and count as one. Weights in f16 were rounded once for all elements of a channel, and that is
/// most of their error: then a channel counts as one.
fn bias(
    got: &Value,
    want: &Value,
    precision: Precision,
    tolerance: &Tolerance,
    defined: usize,
) -> Option<f64> {
    let shape = &want.spec().shape;
    let (got, want) = (got.f32().ok()?.data(), want.f32().ok()?.data());
    // Of each rounding the sum of b|y| over the elements that share it.
    let (mut sum, mut bounds) = (0.0, Vec::<f64>::new());
    let (mut run, mut last) = (0, None);
    for (i, pair) in got.iter().zip(want).enumerate().take(defined) {
        let bits = (pair.0.to_bits(), pair.1.to_bits());
        run += usize::from(last.replace(bits).is_some_and(|last| last != bits));
        let rounding = match precision {
            Precision::F32 | Precision::Bf16 | Precision::Int8 => run,
            Precision::F16 => channel(shape, i),
        };
        if rounding >= bounds.len() {
            bounds.resize(rounding + 1, 0.0);
        }
        let (got, want, limit) = (f64::from(*pair.0), f64::from(*pair.1), tolerance.limit(i));
        // What is infinite, or has no bound, says nothing of a scale.
        if (got * limit).is_finite() && want.is_finite() {
            sum += (got - want) * want;
            bounds[rounding] += limit * want.abs();
        }
    }
    let squares: f64 = bounds.iter().map(|bound| bound * bound).sum();
    Some(if sum == 0.0 { 0.0 } else { sum.abs() / (DEVIATIONS * squares.sqrt()) })
}

/// The larger of two; not a number if one is not, which `f64::max` would drop.
pub(crate) fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a >= b { a } else { b }
}

/// The channel of an element, of maps `[.., C, H, W]` or rows `[.., C]`.
fn channel(shape: &Shape, element: usize) -> usize {
    match shape.0[..] {
        [.., channels, height, width] => element / (height * width) % channels,
        [.., channels] => element % channels,
        [] => 0,
    }
}

/// ‖got − want‖ / ‖want‖; infinite if one is longer.
pub fn relative_l2(got: &[f32], want: &[f32]) -> f64 {
    let (difference, norm) = norms(got, want);
    if norm == 0.0 { difference } else { difference / norm }
}

/// As [`TensorComparison::drift`] says.
pub(super) fn drift(got: &[f32], want: &[f32]) -> f64 {
    let (difference, norm) = norms(got, want);
    difference / norm.max(1.0)
}

/// ‖got − want‖, infinite if one is longer, and ‖want‖.
fn norms(got: &[f32], want: &[f32]) -> (f64, f64) {
    if got.len() != want.len() {
        return (f64::INFINITY, 1.0);
    }
    let (mut difference, mut norm) = (0.0, 0.0);
    for (g, w) in got.iter().zip(want) {
        let (g, w) = (f64::from(*g), f64::from(*w));
        difference += (g - w).powi(2);
        norm += w * w;
    }
    (difference.sqrt(), norm.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::ops::{Conv2d, Softmax};
    use crate::engine::tensor::Tensor;

    #[test]
    fn relative_error_by_hand() {
        // ‖(0, 1)‖ / ‖(3, 4)‖.
        assert_eq!(relative_l2(&[3.0, 5.0], &[3.0, 4.0]), 0.2);
        assert_eq!(relative_l2(&[0.0, 2.0], &[0.0, 0.0]), 2.0);
        assert_eq!(relative_l2(&[1.0], &[1.0, 1.0]), f64::INFINITY);
        assert!(relative_l2(&[f32::NAN], &[1.0]).is_nan());
    }

    #[test]
    fn small_tensors_drift_absolutely() {
        assert_eq!(drift(&[3.0, 5.0], &[3.0, 4.0]), 0.2);
        // ‖(0, 0.25)‖, of a norm of 0.5.
        assert_eq!(drift(&[0.0, 0.75], &[0.0, 0.5]), 0.25);
        assert_eq!(drift(&[0.0, 2.0], &[0.0, 0.0]), 2.0);
    }

    fn compared(op: &dyn Op, got: &[f32], want: &[f32], tolerance: &Tolerance) -> TensorComparison {
        let value = |data: &[f32]| Tensor::from_fn([data.len()], |i| data[i]).into();
        TensorComparison::new(
            "t",
            op,
            Precision::F32,
            &value(got),
            &value(want),
            tolerance,
            got.len(),
        )
    }

    #[test]
    fn shares_by_hand() {
        let softmax = Softmax::default();
        let each = Tolerance::Each(vec![0.5, 0.25]);
        let within = compared(&softmax, &[1.125, 2.125], &[1.0, 2.0], &each);
        assert_eq!((within.share, within.failure), (0.5, None));
        let past = compared(&softmax, &[1.0, 2.5], &[1.0, 2.0], &each);
        assert_eq!(past.share, 2.0);
        assert!(past.failure.is_some_and(|f| f.contains("1 of 2") && f.contains("got 2.5")));
        let nan = compared(&softmax, &[f32::NAN, 2.0], &[1.0, 2.0], &each);
        assert!(nan.share == f64::INFINITY && nan.failure.is_some());
        // Where bits count, −0 is not 0.
        let exact = compared(&softmax, &[-0.0], &[0.0], &Tolerance::Exact);
        assert!(exact.share == f64::INFINITY && exact.failure.is_some());
    }

    /// Errors of a third of the bound: to either side they are roundings, to one side a scale.
    #[test]
    fn a_common_factor_is_no_rounding() {
        let want: Vec<f32> = (0..4096).map(|i| 1.0 + (i % 7) as f32).collect();
        let off = |sign: fn(usize) -> f32| -> Vec<f32> {
            want.iter().enumerate().map(|(i, w)| w * (1.0 + sign(i) / 1024.0)).collect()
        };
        let bounds = Tolerance::Each(want.iter().map(|w| f64::from(*w) * 3.0 / 1024.0).collect());
        let conv = Conv2d::default();
        let rounded = off(|i| if i / 7 % 2 == 0 { 1.0 } else { -1.0 });
        let healthy = compared(&conv, &rounded, &want, &bounds);
        assert!(healthy.failure.is_none() && healthy.bias.is_some_and(|b| b < 0.1), "{healthy:?}");
        // Σe|y| = Σy²/1024 of 7 · 3/1024 · √Σy⁴: with y from 1 to 7 in turn, 64·√7·20 / 21·√668.
        let scaled = compared(&conv, &off(|_| 1.0), &want, &bounds);
        let bias = scaled.bias.unwrap_or_default();
        assert!((bias - 64.0 * 20.0 / (21.0 * 668f64.sqrt())).abs() < 1e-3, "{bias}");
        assert!(scaled.share < 0.34 && scaled.failure.is_some_and(|f| f.contains("scaled")));
        // Other operations may be off to one side, as a driver's exponential is.
        let other = compared(&Softmax::default(), &off(|_| 1.0), &want, &bounds);
        assert!(other.bias.is_none() && other.failure.is_none());
        // The same value everywhere is one rounding.
        let flat = Tolerance::Each(vec![3.0 / 1024.0; 4096]);
        let one = compared(&conv, &[1.0 + 1.0 / 1024.0; 4096], &[1.0; 4096], &flat);
        assert!(one.failure.is_none() && one.bias.is_some_and(|b| b < 0.05), "{one:?}");
    }

    #[test]
    fn no_nan_passes() {
        assert_eq!([larger(1.0, 2.0), larger(2.0, 1.0)], [2.0; 2]);
        assert!([larger(f64::NAN, 1.0), larger(1.0, f64::NAN)].iter().all(|v| v.is_nan()));
    }

    /// What is infinite on both sides, or has no bound, hides no scale beside it.
    #[test]
    fn a_bias_is_of_what_is_finite() {
        let (limit, odd) = (1.0 / 1024.0, [f32::INFINITY, f32::NAN, 0.0]);
        let side = |scale: f32| {
            let finite = (0..4096).map(move |i| (1.0 + (i % 7) as f32) * scale);
            finite.chain(odd).collect::<Vec<f32>>()
        };
        let mut limits = vec![7.0 * limit; 4096];
        limits.extend([limit, limit, f64::INFINITY]);
        let (want, bounds) = (side(1.0), Tolerance::Each(limits));
        let sound = compared(&Conv2d::default(), &want, &want, &bounds);
        assert!(sound.bias == Some(0.0) && sound.failure.is_none(), "{sound:?}");
        let scaled = compared(&Conv2d::default(), &side(1.0 + 1.0 / 1024.0), &want, &bounds);
        assert!(scaled.bias.is_some_and(|bias| bias > 1.0), "{scaled:?}");
        assert!(scaled.failure.is_some_and(|failure| failure.contains("scaled")));
    }

    /// Half of the bound everywhere: of n channels that agree by chance n/2 of 7·√n.
    #[test]
    fn in_f16_a_channel_is_one_rounding() {
        let bounds = |n: usize| Tolerance::Each(vec![2.0 / 1024.0; n]);
        let off = |dims: &[usize]| {
            let full = |v: f32| Value::from(Tensor::from_fn(Shape(dims.to_vec()), |_| v));
            let (got, want) = (full(1.0 + 1.0 / 1024.0), full(1.0));
            let n = dims.iter().product();
            let conv = Conv2d::default();
            TensorComparison::new("t", &conv, Precision::F16, &got, &want, &bounds(n), n)
        };
        for dims in [&[4, 8, 8][..], &[2, 4, 8, 8], &[64, 4]] {
            let few = off(dims);
            assert!(few.failure.is_none());
            assert!(few.bias.is_some_and(|b| (b - 1.0 / 7.0).abs() < 1e-9), "{few:?}");
        }
        let many = off(&[400, 2, 2]);
        assert!(many.bias.is_some_and(|b| (b - 10.0 / 7.0).abs() < 1e-9), "{many:?}");
        assert!(many.failure.is_some_and(|f| f.contains("scaled")));
    }
}
