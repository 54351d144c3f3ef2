//! An [`Arena`]: what holds the tensors of one run at a time, of whichever program.

use std::sync::{Mutex, MutexGuard};

use crate::engine::gpu::context::Gpu;
use crate::engine::gpu::memory::Resource;
use crate::engine::kernels::Storage;
use crate::engine::lifetimes::Holds;
use crate::engine::lock::lock;

/// Memory that the slots of several programs share, those of pictures and their parts, as long as no two of
/// them run at once. It grows to what the largest needs; a slot keeps what it had until it runs again.
#[derive(Default)]
pub(crate) struct Arena(Mutex<Held>);

#[derive(Default)]
struct Held {
    /// Of each kind the largest first.
    storage: Vec<(Storage, Resource)>,
    /// What the host writes of a size of its own for each picture: by the number of the input among such, and
    /// the picture.
    given: Vec<((usize, u32), wgpu::Buffer)>,
}

impl std::fmt::Debug for Arena {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let held = self.held();
        write!(f, "Arena({} buffers and textures)", held.storage.len() + held.given.len())
    }
}

impl Arena {
    fn held(&self) -> MutexGuard<'_, Held> {
        lock(&self.0)
    }

    /// What holds each of `wanted`, all at once: each in the first of its kind that is left, which grows if it
    /// must. So the largest come first on both sides. Behind each of them there are `guard` bytes. A run that is
    /// under way keeps what it has.
    pub(super) fn storage(&self, gpu: &Gpu, wanted: &[Storage], guard: u64) -> Vec<Resource> {
        let held = &mut self.held().storage;
        let mut taken = vec![false; held.len()];
        let take = |wanted: &Storage| {
            let fits = |place: &usize| held[*place].0.union(*wanted).is_some();
            let found = (0..held.len()).filter(|place| !taken[*place]).find(fits);
            let place = found.unwrap_or_else(|| {
                held.push((*wanted, gpu.device.create(*wanted, guard)));
                taken.push(false);
                held.len() - 1
            });
            taken[place] = true;
            let (storage, resource) = &mut held[place];
            if let Some(both) = storage.union(*wanted).filter(|both| both != storage) {
                (*storage, *resource) = (both, gpu.device.create(both, guard));
            }
            resource.clone()
        };
        wanted.iter().map(take).collect()
    }

    /// A buffer of at least so many bytes for an input of a picture.
    pub(super) fn given(&self, gpu: &Gpu, at: (usize, u32), bytes: u64) -> Option<wgpu::Buffer> {
        let given = &mut self.held().given;
        if let Some((_, buffer)) = given.iter().find(|(of, _)| *of == at)
            && buffer.size() >= bytes
        {
            return Some(buffer.clone());
        }
        let Resource::Buffer(buffer) = gpu.device.create(Storage::Buffer { bytes }, 0) else {
            return None;
        };
        given.retain(|(of, _)| *of != at);
        given.push((at, buffer.clone()));
        Some(buffer)
    }

    /// Forgets everything: the driver may have objected to it.
    pub(super) fn clear(&self) {
        *self.held() = Held::default();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::engine::gpu::{GpuOptions, Program, ProgramOptions, Slot};
    use crate::engine::graph::{Graph, TensorId};
    use crate::engine::lower::{KernelChoice, Request, lower};
    use crate::engine::ops::MaxPool2d;
    use crate::engine::precision::Precision;
    use crate::engine::shape::{Extent, TensorSpec};
    use crate::engine::tensor::{Tensor, Value};

    /// Three maxima in a row over maps of so many pixels, and what runs them.
    fn maxima(gpu: &Arc<Gpu>, side: usize) -> (Arc<Program>, TensorId, TensorId) {
        let mut graph = Graph::default();
        let input = graph.input("input", TensorSpec::f32([4, side, side]), Extent::Exact);
        let pool = MaxPool2d { kernel: 3, stride: 1, padding: 1 };
        let names = ["first", "second", "third"];
        let output =
            names.iter().fold(input, |map, name| graph.apply1(name, pool, &[map]).expect("a map"));
        graph.mark_output(output);
        let (caps, kernels) = (gpu.caps(), &KernelChoice::default());
        let request = Request { keep: &[], batch: 1, precision: Precision::F32, caps, kernels };
        let lowered = lower(&graph, &request).expect("kernels");
        let program = Program::new(gpu, &lowered, None, ProgramOptions::default());
        (Arc::new(pollster::block_on(program).expect("a program")), input, output)
    }

    /// A run finds its memory whoever ran there before, and however that made it grow.
    #[test]
    fn programs_of_several_sizes_take_turns() {
        let gpu = pollster::block_on(Gpu::open(GpuOptions::default())).expect("an adapter");
        let arena = Arc::new(Arena::default());
        let sizes = [8, 32, 5];
        let mut runs = sizes.map(|side| {
            let (program, input, output) = maxima(&gpu, side);
            let slot = |arena| pollster::block_on(Slot::sharing(&program, arena)).expect("a slot");
            (side, input, output, slot(&Arc::default()), slot(&arena))
        });
        let resources = arena.held().storage.len();
        for round in 0..3 {
            for (side, input, output, alone, sharing) in &mut runs {
                let value = |i: usize| ((i * 31 + round * 17) % 101) as f32;
                let picture = Value::from(Tensor::from_fn([4, *side, *side], value));
                let run = |slot: &mut Slot| {
                    slot.run(&[(*input, &picture)]).expect("a run").first()[&*output].clone()
                };
                assert_eq!(run(sharing), run(alone), "{side} in round {round}");
            }
        }
        assert_eq!(arena.held().storage.len(), resources, "nothing more is held");
        let most = runs.map(|(.., slot)| slot.program().storage.len()).into_iter().max();
        assert_eq!(Some(resources), most, "what the programs need at once");
    }
}
