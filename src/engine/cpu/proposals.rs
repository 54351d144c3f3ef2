//! The highest scores and their boxes, on channels-last maps, in which torchvision's order of the anchors is that
//! of the memory.

use super::kernel::{Data, Kernel};
use crate::engine::ops::{DecodeProposals, TopK};
use crate::engine::reference::{self, decode_box};
use crate::error::Result;

/// How many of `capacity` an optional count says there are.
fn live(count: Option<&Data>, capacity: usize) -> Result<usize> {
    count.map_or(Ok(capacity), |count| Ok(capacity.min(count.u32()?[0] as usize)))
}

/// The k highest scores.
#[derive(Debug)]
pub(super) struct Highest {
    pub op: TopK,
}

impl Kernel for Highest {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> Result<()> {
        let scores = inputs[0].f32()?;
        let scores = &scores[..live(inputs.get(1), scores.len())?];
        let best = reference::top_k(scores, self.op.k);
        for (value, best) in outputs[0].iter_mut().zip(&best) {
            *value = scores[*best as usize];
        }
        for (index, best) in outputs[1].iter_mut().zip(&best) {
            *index = f32::from_bits(*best);
        }
        outputs[2][0] = f32::from_bits(best.len() as u32);
        Ok(())
    }
}

/// The boxes of the chosen anchors, and their scores.
#[derive(Debug)]
pub(super) struct Decoded {
    pub op: DecodeProposals,
    /// Columns of the map.
    pub columns: usize,
}

impl Kernel for Decoded {
    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> Result<()> {
        let (deltas, logits, indices) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].u32()?);
        let count = live(inputs.get(3), logits.len())?;
        let extent = [self.op.width as f32, self.op.height as f32];
        let (grid, (deltas, _)) = (self.op.grid(self.columns), deltas.as_chunks::<4>());
        let boxes = outputs[0].as_chunks_mut::<4>().0.iter_mut();
        for (decoded, index) in boxes.zip(&indices[..count]) {
            let index = (*index as usize).min(deltas.len() - 1);
            *decoded = decode_box(grid.anchor(index).0, deltas[index].map(f64::from), extent);
        }
        for (score, logit) in outputs[1].iter_mut().zip(&logits[..count]) {
            *score = reference::sigmoid((*logit).into()) as f32;
        }
        Ok(())
    }
}
