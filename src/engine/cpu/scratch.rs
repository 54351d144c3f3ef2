//! Memory that stays for the next kernel. New memory costs a page fault for each 4 KiB, and to fill it with
//! zeros, which nobody reads, takes as long as a pass over a map.

use std::ops::{Deref, DerefMut};
use std::sync::Mutex;

use crate::engine::cores::threads;
use crate::engine::lock::lock;

/// What no kernel uses.
static IDLE: Mutex<Vec<Vec<f32>>> = Mutex::new(Vec::new());

/// Numbers of any values, given back when dropped.
pub(super) struct Scratch {
    buffer: Vec<f32>,
    length: usize,
}

impl Scratch {
    /// So many numbers, in the smallest idle buffer that has them, or the largest, which grows.
    pub fn new(length: usize) -> Self {
        let mut idle = lock(&IDLE);
        let fits = |buffer: &Vec<f32>| (buffer.len() < length, buffer.len().abs_diff(length));
        let best = (0..idle.len()).min_by_key(|i| fits(&idle[*i]));
        let mut buffer = best.map(|i| idle.swap_remove(i)).unwrap_or_default();
        drop(idle);
        if buffer.len() < length {
            buffer.resize(length, 0.0);
        }
        Self { buffer, length }
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let mut idle = lock(&IDLE);
        // As many as are in use at a time: two for each thread, and two that all share.
        if idle.len() < 2 * (threads() + 1) {
            idle.push(std::mem::take(&mut self.buffer));
        }
    }
}

impl Deref for Scratch {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.buffer[..self.length]
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.buffer[..self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_have_the_length_that_was_asked_for_and_are_nobody_elses() {
        for length in [0, 5, 3, 1000, 7] {
            let (mut a, mut b) = (Scratch::new(length), Scratch::new(length));
            a.fill(1.0);
            b.fill(2.0);
            assert_eq!((a.len(), b.len()), (length, length));
            assert!(a.iter().all(|x| *x == 1.0) && b.iter().all(|x| *x == 2.0));
        }
    }
}
