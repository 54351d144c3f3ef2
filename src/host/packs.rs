//! Weights as kernels want them, shared by plans of the same weights.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

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
}

impl Pack<'_> {
    /// What `make` packs in this `manner`, if no plan has it yet.
    pub fn get(&self, manner: &'static str, make: impl FnOnce() -> Vec<f32>) -> Arc<Vec<f32>> {
        let mut all = self.all.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.entry((self.name.to_owned(), manner)).or_insert_with(|| Arc::new(make())).clone()
    }
}
