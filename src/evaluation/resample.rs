//! Figures of pictures that are drawn anew from those at hand.

/// So often pictures are drawn anew: the ends of an interval of 95 % then lie on 25 figures each.
const DRAWS: usize = 1000;

/// How often each picture counts.
pub struct Counts(Vec<u32>);

impl Counts {
    /// Each once.
    pub fn once(pictures: usize) -> Self {
        Self(vec![1; pictures])
    }

    /// How often picture `i` counts.
    pub fn of(&self, i: usize) -> usize {
        self.0[i] as usize
    }

    /// Mean of values that belong to pictures.
    pub fn mean(&self, values: &[(usize, f64)]) -> Option<f64> {
        let counted = values.iter().map(|(i, value)| (self.of(*i), value));
        let (n, sum) = counted.fold((0, 0.0), |(n, sum), (k, v)| (n + k, sum + k as f64 * v));
        (n > 0).then(|| sum / n as f64)
    }
}

/// Values that belong to pictures, in their order.
pub struct Ordered(Vec<(usize, f64)>);

impl Ordered {
    /// Sorts them.
    pub fn new(mut values: Vec<(usize, f64)>) -> Self {
        values.sort_by(|a, b| a.1.total_cmp(&b.1));
        Self(values)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// [`quantile`](crate::evaluation::metrics::quantile) of the values, each as often as its picture counts.
    pub fn quantile(&self, counts: &Counts, q: f64) -> Option<f64> {
        let n: usize = self.0.iter().map(|(i, _)| counts.of(*i)).sum();
        let at = q.clamp(0.0, 1.0) * n.checked_sub(1)? as f64;
        let (mut before, mut low) = (0, None);
        for (i, value) in &self.0 {
            before += counts.of(*i);
            // Places `before − count` to `before − 1` hold this value.
            if low.is_none() && before > at.floor() as usize {
                low = Some(*value);
            }
            if before > at.ceil() as usize {
                return low.map(|low| low + (value - low) * at.fract());
            }
        }
        None
    }
}

/// Where 95 % of each figure lies when `pictures` pictures are drawn with repetition. `None` where no
/// draw has the figure.
pub fn intervals<const N: usize>(
    pictures: usize,
    figures: impl Fn(&Counts) -> [Option<f64>; N],
) -> [Option<[f64; 2]>; N] {
    if pictures == 0 {
        return [None; N];
    }
    let mut random = 0;
    let mut drawn: [Vec<f64>; N] = std::array::from_fn(|_| Vec::with_capacity(DRAWS));
    for _ in 0..DRAWS {
        let mut counts = Counts(vec![0; pictures]);
        for _ in 0..pictures {
            counts.0[(next(&mut random) % pictures as u64) as usize] += 1;
        }
        for (values, figure) in drawn.iter_mut().zip(figures(&counts)) {
            values.extend(figure);
        }
    }
    drawn.map(|values| {
        let ordered = Ordered::new(values.into_iter().map(|v| (0, v)).collect());
        let once = Counts::once(1);
        Some([ordered.quantile(&once, 0.025)?, ordered.quantile(&once, 0.975)?])
    })
}

/// SplitMix64 (Steele, Lea and Flood 2014): the modulo above prefers no picture by more than 2⁻⁴⁰.
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::metrics::quantile;

    #[test]
    fn quantiles_and_means_count_repetitions() {
        let values = vec![(2, 5.0), (0, 1.0), (1, 2.0), (0, 9.0)];
        let counts = Counts(vec![2, 0, 3]);
        let expanded = [1.0, 1.0, 5.0, 5.0, 5.0, 9.0, 9.0];
        assert_eq!(counts.mean(&values), Some(expanded.iter().sum::<f64>() / 7.0));
        let ordered = Ordered::new(values);
        for q in [0.0, 0.1, 0.25, 0.3, 0.5, 0.77, 0.95, 1.0] {
            assert_eq!(ordered.quantile(&counts, q), quantile(&expanded, q), "{q}");
        }
        assert_eq!(ordered.quantile(&Counts(vec![0; 3]), 0.5), None);
        assert_eq!(Ordered::new(vec![]).quantile(&counts, 0.5), None);
    }
}
