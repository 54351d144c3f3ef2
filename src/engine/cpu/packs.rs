//! Weights as kernels want them, shared by plans of the same weights.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use super::words::Numbers;
use crate::engine::graph::{Graph, Node};
use crate::engine::lock::lock;
use crate::engine::ops::winograd::POINTS;
use crate::engine::tensor::{Constant, Tensor};
use crate::error::Result;

/// A tensor's name, how it is packed, and in which numbers.
type Key = (String, &'static str, Numbers);

/// Most bytes that the transformed weights of a network may take. Those of the large network take 430 MB where
/// its input is so large that all are; with as many weights as a file may hold it would be 2 GiB.
const MOST_TRANSFORMED: u64 = 512 << 20;

/// Fewest outputs for which inputs are rounded to narrow numbers.
const LEAST_OUTPUTS: usize = 32;
/// Most inputs of a sum of 8 bits, with those that fill up words: 32 bits hold 2¹⁶ products of 255 and 127.
const MOST_INPUTS: usize = 1 << 16;

/// Packed weights.
#[derive(Debug, Default)]
pub(super) struct Packs {
    all: Mutex<HashMap<Key, Arc<Vec<f32>>>>,
    /// Whether there is no memory for Winograd's weights, four times as many.
    pub lean: bool,
}

impl Packs {
    /// For the weights of `graph`.
    pub fn new(graph: &Graph) -> Self {
        let transformed = |node: &Node| match graph.spec(*node.inputs.get(1)?).shape.0[..] {
            [out_c, in_c, 3, 3] => Some((4 * POINTS * out_c * in_c) as u64),
            _ => None,
        };
        let bytes: u64 = graph.nodes().iter().filter_map(transformed).sum();
        Self { all: Mutex::default(), lean: bytes > MOST_TRANSFORMED }
    }
}

/// One tensor's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pack<'a> {
    pub all: &'a Packs,
    pub name: &'a str,
    pub weight: &'a Constant,
    /// What is multiplied where that pays.
    pub numbers: Numbers,
}

impl Pack<'_> {
    /// What is multiplied for so many outputs of so many inputs. Narrow numbers are where they pay: not where an input
    /// is rounded for few products, as with few outputs, or if it is not `reused` at other places, and not where a
    /// sum of 8 bits might not fit.
    pub fn numbers_of(&self, outputs: usize, inputs: usize, reused: bool) -> Numbers {
        let pays = outputs >= LEAST_OUTPUTS && reused && inputs <= MOST_INPUTS;
        if pays { self.numbers } else { Numbers::F32 }
    }

    /// The weight's sizes.
    pub fn dims(&self) -> &[usize] {
        &self.weight.spec().shape.0
    }

    /// What `make` packs in this `manner`, in these numbers. Where a plan has it already, the weight is not even unpacked.
    ///
    /// # Errors
    /// What making the weight returns.
    pub fn get(
        &self,
        manner: &'static str,
        numbers: Numbers,
        make: impl FnOnce(&Tensor) -> Vec<f32>,
    ) -> Result<Arc<Vec<f32>>> {
        let mut all = lock(&self.all.all);
        let key = (self.name.to_owned(), manner, numbers);
        if let Some(packed) = all.get(&key) {
            return Ok(packed.clone());
        }
        let packed = Arc::new(make(self.weight.get()?.f32()?));
        all.insert(key, packed.clone());
        Ok(packed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use crate::engine::ops::Conv2d;
    use crate::engine::shape::{Extent, TensorSpec};

    /// 1024 × 1024 × 36 numbers are 144 MiB.
    #[test]
    fn transformed_weights_have_bounded_memory() {
        for (layers, lean) in [(3, false), (4, true)] {
            let mut graph = Graph::default();
            let mut map = graph.input("input", TensorSpec::f32([1024, 16, 16]), Extent::Exact);
            for layer in 0..layers {
                let made = || unreachable!("nobody looks at its values");
                let weight = Constant::made(TensorSpec::f32([1024, 1024, 3, 3]), made);
                let weight = graph.constant(format!("weight{layer}"), weight);
                let conv = Conv2d { padding: 1, bias: false, ..Conv2d::default() };
                map = graph.apply1("conv", conv, &[map, weight]).expect("a layer");
            }
            assert_eq!(Packs::new(&graph).lean, lean, "{layers}");
        }
    }

    #[test]
    fn a_weight_that_is_packed_is_not_made_again() {
        let made = Arc::new(AtomicUsize::new(0));
        let counted = made.clone();
        let weight = Constant::made(TensorSpec::f32([2]), move || {
            counted.fetch_add(1, Ordering::Relaxed);
            Ok(Tensor::new([2], vec![1.0f32, 2.0])?.into())
        });
        let all = Packs::default();
        let pack = Pack { all: &all, name: "w", weight: &weight, numbers: Numbers::F32 };
        let get = |manner| pack.get(manner, Numbers::F32, |w| w.data().to_vec()).expect("a weight");
        assert_eq!([get("one"), get("one")].map(|packed| packed.to_vec()), [[1.0, 2.0]; 2]);
        assert_eq!(made.load(Ordering::Relaxed), 1);
        get("another");
        assert_eq!(made.load(Ordering::Relaxed), 2);
        // What cannot be made leaves nothing behind.
        let broken = Constant::made(TensorSpec::f32([2]), || {
            Tensor::<f32>::new([2], vec![]).map(Into::into)
        });
        let pack = Pack { all: &all, name: "broken", weight: &broken, numbers: Numbers::F32 };
        assert!(pack.get("one", Numbers::F32, |w| w.data().to_vec()).is_err());
        assert!(pack.get("one", Numbers::F32, |w| w.data().to_vec()).is_err());
    }
}
