//! What holds the tensors of a recording, some in turn.

use crate::engine::kernels::{Recording, Role, Storage};
use crate::engine::lifetimes::{self, Assignment, Holds};

impl Holds for Storage {
    fn bytes(&self) -> u64 {
        Storage::bytes(self)
    }

    fn union(self, other: Self) -> Option<Self> {
        match (self, other) {
            (Self::Buffer { bytes: a }, Self::Buffer { bytes: b }) => {
                Some(Self::Buffer { bytes: a.max(b) })
            }
            (
                Self::Texture { width, height, precision },
                Self::Texture { width: w, height: h, precision: p },
            ) if precision == p => {
                let (width, height) = (width.max(w), height.max(h));
                Some(Self::Texture { width, height, precision })
            }
            _ => None,
        }
    }
}

/// Assigns a slot to each tensor of `recording` but to constants and transients that no command names, such as
/// weights of which only the repacked copy is used. With `reuse`, transients share slots; else each has its own.
pub fn assign(recording: &Recording, reuse: bool) -> Assignment<Storage> {
    let tensors = recording.tensors();
    let needs: Vec<Storage> = tensors.iter().map(|tensor| tensor.storage).collect();
    let commands = recording.commands().iter();
    let steps: Vec<Vec<usize>> =
        commands.map(|command| command.tensors().iter().map(|id| id.0).collect()).collect();
    let shares = |id: usize| reuse && matches!(tensors[id].role, Role::Transient);
    let mut found = lifetimes::assign(&needs, &steps, shares);
    // The host writes and reads these even where no command names them.
    for (id, tensor) in tensors.iter().enumerate() {
        let by_host = matches!(tensor.role, Role::Input(_) | Role::Output);
        if found.slot[id].is_none() && by_host {
            found.own(id, tensor.storage);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::graph::TensorId;
    use crate::engine::kernels::{Caps, Dispatch, Grid, Role};
    use crate::engine::precision::Precision;
    use crate::engine::shader::{ParamLayout, Shader};
    use crate::engine::shape::{Extent, TensorSpec};

    static SHADER: Shader = Shader { stem: "none", source: "", params: ParamLayout::NONE };

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
