//! Which tensors may share what holds them: greedy reuse by lifetime.
//!
//! wgpu tracks usage by whole buffer, so two tensors of one dispatch may never share one, even at
//! disjoint offsets: reuse is of whole buffers, and of whole textures.

use crate::engine::kernels::{Recording, Role, Storage};

/// Assignment of tensors to slots.
#[derive(Debug, Default)]
pub struct Assignment {
    /// Slot of each tensor; none for a constant or transient that no command names, such as
    /// weights of which only the repacked copy is used.
    pub slot: Vec<Option<usize>>,
    /// What each slot is.
    pub storage: Vec<Storage>,
}

/// How much a slot would have to grow to hold `need` beside what it holds; `None` where it is of
/// another kind.
fn growth(slot: Storage, need: Storage) -> Option<u64> {
    let grown = union(slot, need)?;
    Some(grown.bytes() - slot.bytes())
}

/// What holds either; `None` where they are of different kinds.
pub(crate) fn union(a: Storage, b: Storage) -> Option<Storage> {
    match (a, b) {
        (Storage::Buffer { bytes: a }, Storage::Buffer { bytes: b }) => {
            Some(Storage::Buffer { bytes: a.max(b) })
        }
        (
            Storage::Texture { width, height, precision },
            Storage::Texture { width: w, height: h, precision: p },
        ) if precision == p => {
            let (width, height) = (width.max(w), height.max(h));
            Some(Storage::Texture { width, height, precision })
        }
        _ => None,
    }
}

/// Assigns a slot to each tensor of `recording`. With `reuse`, a transient takes over the dead slot
/// that need grow least for it, where that is less than a new one; else each has its own.
pub fn assign(recording: &Recording, reuse: bool) -> Assignment {
    let count = recording.tensors().len();
    let mut last_use = vec![0usize; count];
    for (step, command) in recording.commands().iter().enumerate() {
        for id in command.tensors() {
            last_use[id.0] = step;
        }
    }
    let transient = |id: usize| matches!(recording.tensors()[id].role, Role::Transient);
    let mut slots = Assignment { slot: vec![None; count], storage: Vec::new() };
    let mut free: Vec<usize> = Vec::new();
    let take = |slots: &mut Assignment, free: &mut Vec<usize>, id: usize| {
        let need = recording.tensors()[id].storage;
        let reusable = free
            .iter()
            .enumerate()
            .filter_map(|(at, slot)| Some((at, growth(slots.storage[*slot], need)?, *slot)))
            .filter(|(_, growth, _)| *growth < need.bytes())
            .min_by_key(|(_, growth, slot)| (*growth, slots.storage[*slot].bytes()))
            .filter(|_| reuse && transient(id));
        slots.slot[id] = Some(match reusable {
            Some((at, _, slot)) => {
                free.swap_remove(at);
                if let Some(grown) = union(slots.storage[slot], need) {
                    slots.storage[slot] = grown;
                }
                slot
            }
            None => {
                slots.storage.push(need);
                slots.storage.len() - 1
            }
        });
    };
    for (step, command) in recording.commands().iter().enumerate() {
        let used: Vec<usize> = command.tensors().iter().map(|t| t.0).collect();
        for &id in &used {
            if slots.slot[id].is_none() {
                take(&mut slots, &mut free, id);
            }
        }
        for &id in &used {
            let Some(slot) = slots.slot[id] else { continue };
            if reuse && transient(id) && last_use[id] == step && !free.contains(&slot) {
                free.push(slot);
            }
        }
    }
    // The host writes and reads these even where no command names them.
    for id in 0..count {
        let by_host = matches!(recording.tensors()[id].role, Role::Input(_) | Role::Output);
        if slots.slot[id].is_none() && by_host {
            take(&mut slots, &mut Vec::new(), id);
        }
    }
    slots
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::graph::TensorId;
    use crate::engine::kernels::{Caps, Dispatch, Grid, Role};
    use crate::engine::precision::Precision;
    use crate::engine::shader::{ParamLayout, Shader};
    use crate::engine::shape::{Extent, TensorSpec};

    static SHADER: Shader =
        Shader { stem: "none", source: "", params: ParamLayout { size: 0, fields: &[] } };

    fn step(recording: &mut Recording, tensors: &[TensorId]) {
        let bindings: Vec<_> = tensors.iter().map(|t| ("x", *t)).collect();
        let grid = Grid::Workgroups([1, 1, 1]);
        recording.dispatch(Dispatch::new(&SHADER, "main", &[0u32; 0], &bindings, grid));
    }

    #[test]
    fn a_chain_needs_two_buffers_and_outputs_are_kept() {
        let mut r = Recording::new(1, Precision::F32, Caps::default());
        let input = r.tensor("input", TensorSpec::f32([8]), Role::Input(Extent::Exact));
        let t: Vec<_> = (0..4).map(|_| r.scratch("t", TensorSpec::f32([8]))).collect();
        let output = r.tensor("output", TensorSpec::f32([8]), Role::Output);
        let unused = r.constant("unused", crate::engine::tensor::Tensor::<f32>::zeros([64]));
        let chain = [input, t[0], t[1], t[2], t[3], output];
        for pair in chain.windows(2) {
            step(&mut r, pair);
        }
        let with = assign(&r, true);
        let buffer = Storage::Buffer { bytes: 32 };
        assert_eq!(with.storage, [buffer; 4], "input, two in turn, output");
        assert_eq!(with.slot[t[0].0], with.slot[t[2].0]);
        assert_ne!(with.slot[t[0].0], with.slot[t[1].0], "both are bound in one dispatch");
        assert_eq!(with.slot[unused.0], None);
        assert_eq!(assign(&r, false).storage.len(), 6);
    }
}
