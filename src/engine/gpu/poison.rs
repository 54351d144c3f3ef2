//! What tests fill buffers with before a run.

use crate::engine::graph::TensorId;

/// What guarded buffers hold before a run. Each word differs with its tensor and place, so that a
/// copied one shows too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Poison {
    /// Float NaNs: they show in whatever a sum or product makes of them, but arithmetic leaves them
    /// as they are, and a maximum passes over them.
    #[default]
    Nan,
    /// Floats of both signs, every other near 1 and huge: sums and products change the former, and
    /// the latter win any maximum or minimum.
    Finite,
}

impl Poison {
    /// Word `at` of `tensor`.
    pub fn word(self, tensor: TensorId, at: usize) -> u32 {
        // The finalizer of MurmurHash3, which spreads each bit over all.
        let mut hash = (tensor.0 as u32).wrapping_mul(0x9e37_79b9) ^ at as u32;
        hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
        hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
        hash ^= hash >> 16;
        match self {
            // Quiet: a driver may set that bit when it moves a signalling one.
            Self::Nan => 0x7fc0_0000 | hash & 0x003f_ffff,
            Self::Finite if at.is_multiple_of(2) => 0x3f80_0000 | hash & 0x807f_ffff,
            // About 1e30.
            Self::Finite => 0x7180_0000 | hash & 0x807f_ffff,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A word is no result of arithmetic on another: neither a copy nor a NaN that went through.
    #[test]
    fn poison_differs_from_word_to_word_and_between_its_kinds() {
        let words = |poison: Poison| -> Vec<u32> {
            let tensors = (0..4).map(TensorId);
            tensors.flat_map(|id| (0..1000).map(move |at| poison.word(id, at))).collect()
        };
        let (nan, finite) = (words(Poison::Nan), words(Poison::Finite));
        assert!(nan.iter().all(|w| f32::from_bits(*w).is_nan()));
        assert!(finite.iter().all(|w| f32::from_bits(*w).is_finite()));
        for kind in [nan, finite] {
            let distinct: std::collections::HashSet<_> = kind.iter().collect();
            assert!(distinct.len() > kind.len() - 20, "{} of {}", distinct.len(), kind.len());
        }
    }
}
