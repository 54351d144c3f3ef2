//! Weights as kernels want them, shared by plans of the same weights.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use crate::error::Result;
use crate::lock::lock;
use crate::tensor::{Constant, Tensor};

/// A tensor's name, and how it is packed.
type Key = (String, &'static str);

/// Packed weights.
#[derive(Debug, Default)]
pub(super) struct Packs(Mutex<HashMap<Key, Arc<Vec<f32>>>>);

/// One tensor's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pack<'a> {
    pub all: &'a Packs,
    pub name: &'a str,
    pub weight: &'a Constant,
}

impl Pack<'_> {
    /// The weight's sizes.
    pub fn dims(&self) -> &[usize] {
        &self.weight.spec().shape.0
    }

    /// What `make` packs in this `manner`. Where a plan has it already, the weight is not even unpacked.
    ///
    /// # Errors
    /// What making the weight returns.
    pub fn get(
        &self,
        manner: &'static str,
        make: impl FnOnce(&Tensor) -> Vec<f32>,
    ) -> Result<Arc<Vec<f32>>> {
        let mut all = lock(&self.all.0);
        let key = (self.name.to_owned(), manner);
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

    use crate::shape::TensorSpec;

    #[test]
    fn a_weight_that_is_packed_is_not_made_again() {
        let made = Arc::new(AtomicUsize::new(0));
        let counted = made.clone();
        let weight = Constant::made(TensorSpec::f32([2]), move || {
            counted.fetch_add(1, Ordering::Relaxed);
            Ok(Tensor::new([2], vec![1.0f32, 2.0])?.into())
        });
        let all = Packs::default();
        let pack = Pack { all: &all, name: "w", weight: &weight };
        let get = |manner| pack.get(manner, |w| w.data().to_vec()).expect("a weight");
        assert_eq!([get("one"), get("one")].map(|packed| packed.to_vec()), [[1.0, 2.0]; 2]);
        assert_eq!(made.load(Ordering::Relaxed), 1);
        get("another");
        assert_eq!(made.load(Ordering::Relaxed), 2);
        // What cannot be made leaves nothing behind.
        let broken = Constant::made(TensorSpec::f32([2]), || {
            Tensor::<f32>::new([2], vec![]).map(Into::into)
        });
        let pack = Pack { all: &all, name: "broken", weight: &broken };
        assert!(pack.get("one", |w| w.data().to_vec()).is_err());
        assert!(pack.get("one", |w| w.data().to_vec()).is_err());
    }
}
