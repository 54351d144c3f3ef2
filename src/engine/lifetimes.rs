//! Which tensors may share what holds them: greedy reuse by lifetime.
//!
//! Two tensors of one step never share: wgpu tracks usage by whole buffer, and cores read while they write.

/// What holds tensors on a device.
pub trait Holds: Copy {
    /// Its size in bytes.
    fn bytes(&self) -> u64;

    /// What holds either; `None` where they are of different kinds.
    fn union(self, other: Self) -> Option<Self>;
}

/// Assignment of tensors to slots.
#[derive(Debug)]
pub struct Assignment<S> {
    /// Slot of each tensor; none for one that no step names.
    pub slot: Vec<Option<usize>>,
    /// What each slot is.
    pub storage: Vec<S>,
}

impl<S: Holds> Assignment<S> {
    /// Gives a tensor the dead slot that need grow least for it, where that is less than a new one.
    fn reuse(&mut self, free: &mut Vec<usize>, tensor: usize, need: S) {
        let fitting = free.iter().enumerate().filter_map(|(at, slot)| {
            let held = self.storage[*slot];
            let both = held.union(need)?;
            Some((both.bytes() - held.bytes(), held.bytes(), at, both))
        });
        let least = fitting
            .filter(|(growth, ..)| *growth < need.bytes())
            .min_by_key(|(growth, bytes, ..)| (*growth, *bytes));
        match least {
            None => self.own(tensor, need),
            Some((_, _, at, both)) => {
                let slot = free.swap_remove(at);
                self.storage[slot] = both;
                self.slot[tensor] = Some(slot);
            }
        }
    }

    /// Gives a tensor a slot of its own.
    pub fn own(&mut self, tensor: usize, need: S) {
        self.slot[tensor] = Some(self.storage.len());
        self.storage.push(need);
    }
}

/// Assigns a slot to each tensor that a step names. Those that `shares` take over dead slots and leave theirs to
/// others, which have each their own.
pub fn assign<S: Holds>(
    needs: &[S],
    steps: &[Vec<usize>],
    shares: impl Fn(usize) -> bool,
) -> Assignment<S> {
    let mut last_use = vec![0; needs.len()];
    for (step, used) in steps.iter().enumerate() {
        used.iter().for_each(|tensor| last_use[*tensor] = step);
    }
    let mut found = Assignment { slot: vec![None; needs.len()], storage: Vec::new() };
    let mut free = Vec::new();
    for (step, used) in steps.iter().enumerate() {
        for &tensor in used {
            match found.slot[tensor] {
                Some(_) => {}
                None if shares(tensor) => found.reuse(&mut free, tensor, needs[tensor]),
                None => found.own(tensor, needs[tensor]),
            }
        }
        let dead = used.iter().filter(|tensor| shares(**tensor) && last_use[**tensor] == step);
        for slot in dead.filter_map(|tensor| found.slot[*tensor]) {
            if !free.contains(&slot) {
                free.push(slot);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// So many bytes, of one of two kinds.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Block(char, u64);

    impl Holds for Block {
        fn bytes(&self) -> u64 {
            self.1
        }

        fn union(self, other: Self) -> Option<Self> {
            (self.0 == other.0).then_some(Self(self.0, self.1.max(other.1)))
        }
    }

    /// A chain of five, of which the last is kept; a sixth is of another kind, a seventh is not named.
    #[test]
    fn a_chain_needs_two_slots_and_what_is_kept_a_third() {
        let sizes = [8, 8, 12, 4, 8].map(|bytes| Block('a', bytes));
        let needs = [&sizes[..], &[Block('b', 4), Block('a', 99)]].concat();
        let steps = [vec![0, 1], vec![1, 2], vec![2, 3, 5], vec![3, 4]];
        let found = assign(&needs, &steps, |tensor| tensor != 4);
        // The third grows the first's; the fourth finds the second's; the fifth is kept.
        let slots = [Some(0), Some(1), Some(0), Some(1), Some(3), Some(2), None];
        assert_eq!(found.slot, slots);
        let held = [Block('a', 12), Block('a', 8), Block('b', 4), Block('a', 8)];
        assert_eq!(found.storage, held);
        assert_eq!(assign(&needs, &steps, |_| false).storage.len(), 6);
    }

    /// Growing by all that a tensor needs is no gain.
    #[test]
    fn an_empty_slot_is_not_grown() {
        let needs = [0, 4].map(|bytes| Block('a', bytes));
        assert_eq!(assign(&needs, &[vec![0], vec![1]], |_| true).storage, needs);
    }
}
