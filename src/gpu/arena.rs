//! Which tensors may share a buffer: greedy reuse by lifetime.
//!
//! wgpu tracks usage by whole buffer, so two tensors of one dispatch may never share one, even at
//! disjoint offsets: reuse is of whole buffers.

use crate::gpu::recording::{Grid, Recording, Role, TensorId};

/// Assignment of tensors to buffers.
#[derive(Debug, Default)]
pub struct Assignment {
    /// Buffer of each tensor.
    pub slot: Vec<usize>,
    /// Size of each buffer in bytes.
    pub bytes: Vec<u64>,
}

/// Assigns a buffer to each tensor of `recording`. With `reuse`, a transient takes over the
/// smallest buffer that is large enough and whose last reader has run; else each has its own.
pub fn assign(recording: &Recording, reuse: bool) -> Assignment {
    let count = recording.tensors().len();
    let mut last_use = vec![0usize; count];
    for (step, dispatch) in recording.dispatches().iter().enumerate() {
        for TensorId(id) in tensors_of(dispatch) {
            last_use[id] = step;
        }
    }
    let transient = |id: usize| matches!(recording.tensors()[id].role, Role::Transient);
    let mut slots = Assignment { slot: vec![usize::MAX; count], bytes: Vec::new() };
    let mut free: Vec<usize> = Vec::new();
    let take = |slots: &mut Assignment, free: &mut Vec<usize>, id: usize| {
        let need = recording.tensors()[id].spec.bytes().max(4);
        let reusable = free
            .iter()
            .enumerate()
            .filter(|(_, slot)| slots.bytes[**slot] >= need)
            .min_by_key(|(_, slot)| slots.bytes[**slot])
            .map(|(at, _)| at)
            .filter(|_| reuse && transient(id));
        slots.slot[id] = match reusable {
            Some(at) => free.swap_remove(at),
            None => {
                slots.bytes.push(need);
                slots.bytes.len() - 1
            }
        };
    };
    for (step, dispatch) in recording.dispatches().iter().enumerate() {
        let used: Vec<usize> = tensors_of(dispatch).map(|t| t.0).collect();
        for &id in &used {
            if slots.slot[id] == usize::MAX {
                take(&mut slots, &mut free, id);
            }
        }
        for &id in &used {
            let slot = slots.slot[id];
            if reuse && transient(id) && last_use[id] == step && !free.contains(&slot) {
                free.push(slot);
            }
        }
    }
    // Tensors that no dispatch touches still need a buffer: they may be read back.
    for id in 0..count {
        if slots.slot[id] == usize::MAX {
            take(&mut slots, &mut Vec::new(), id);
        }
    }
    slots
}

fn tensors_of(dispatch: &crate::gpu::Dispatch) -> impl Iterator<Item = TensorId> + '_ {
    let indirect = match dispatch.grid {
        Grid::Indirect(id) => Some(id),
        Grid::Workgroups(_) => None,
    };
    dispatch.bindings.iter().map(|(_, id)| *id).chain(indirect)
}
