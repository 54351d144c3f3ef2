//! Which tensors may share a buffer: greedy reuse by lifetime.
//!
//! wgpu tracks usage by whole buffer, so two tensors of one dispatch may never share one, even at
//! disjoint offsets: reuse is of whole buffers.

use crate::gpu::recording::{Grid, Recording, Role, TensorId};

/// Assignment of tensors to buffers.
#[derive(Debug, Default)]
pub struct Assignment {
    /// Buffer of each tensor; none for a constant or transient that no dispatch binds, such as
    /// weights of which only the repacked copy is used.
    pub slot: Vec<Option<usize>>,
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
    let mut slots = Assignment { slot: vec![None; count], bytes: Vec::new() };
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
        slots.slot[id] = Some(match reusable {
            Some(at) => free.swap_remove(at),
            None => {
                slots.bytes.push(need);
                slots.bytes.len() - 1
            }
        });
    };
    for (step, dispatch) in recording.dispatches().iter().enumerate() {
        let used: Vec<usize> = tensors_of(dispatch).map(|t| t.0).collect();
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
    // The host writes and reads these even where no dispatch touches them.
    for id in 0..count {
        let by_host = matches!(recording.tensors()[id].role, Role::Input(_) | Role::Output);
        if slots.slot[id].is_none() && by_host {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{Dispatch, ParamLayout, Shader};
    use crate::shape::{Extent, TensorSpec};

    static SHADER: Shader =
        Shader { stem: "none", source: "", params: ParamLayout { size: 0, fields: &[] } };

    fn step(recording: &mut Recording, tensors: &[TensorId]) {
        recording.dispatch(Dispatch {
            shader: &SHADER,
            entry: "main",
            params: vec![],
            bindings: tensors.iter().map(|t| ("x", *t)).collect(),
            grid: Grid::Workgroups([1, 1, 1]),
        });
    }

    #[test]
    fn a_chain_needs_two_buffers_and_outputs_are_kept() {
        let mut r = Recording::default();
        let input = r.tensor("input", TensorSpec::f32([8]), Role::Input(Extent::Exact));
        let t: Vec<_> = (0..4).map(|_| r.scratch("t", TensorSpec::f32([8]))).collect();
        let output = r.tensor("output", TensorSpec::f32([8]), Role::Output);
        let unused = r.constant("unused", crate::tensor::Tensor::<f32>::zeros([64]));
        let chain = [input, t[0], t[1], t[2], t[3], output];
        for pair in chain.windows(2) {
            step(&mut r, pair);
        }
        let with = assign(&r, true);
        assert_eq!(with.bytes, [32; 4], "input, two in turn, output");
        assert_eq!(with.slot[t[0].0], with.slot[t[2].0]);
        assert_ne!(with.slot[t[0].0], with.slot[t[1].0], "both are bound in one dispatch");
        assert_eq!(with.slot[unused.0], None);
        assert_eq!(assign(&r, false).bytes.len(), 6);
    }
}
