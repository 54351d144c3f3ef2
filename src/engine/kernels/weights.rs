//! Packed weights: in textures, in f32 or in f16, or in a buffer.

use std::sync::{Arc, OnceLock};

use crate::engine::graph::TensorId;
use crate::engine::kernels::Recording;
use crate::engine::precision::{Precision, powered, weight_powers};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Constant, Tensor};

/// Weights on the device.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stored {
    /// The texels, in a texture or in a buffer.
    pub texels: TensorId,
    /// In f16, what each output's sum is to be multiplied with.
    scale: Option<TensorId>,
}

impl Stored {
    /// The bindings of a dispatch that adds the products up: `others`, and `scale` where sums have one.
    pub fn scaled(&self, others: &[(&'static str, TensorId)]) -> Vec<(&'static str, TensorId)> {
        others.iter().copied().chain(self.scale.map(|id| ("scale", id))).collect()
    }
}

/// How weights `[O, …]` become texels.
pub(super) struct Packing<F> {
    /// `[height, width, 4]`.
    pub texels: TensorSpec,
    /// Outputs, with the padding.
    pub outputs: usize,
    /// Outputs that lie side by side.
    pub tile: usize,
    /// How often the outputs come one after the other.
    pub copies: usize,
    /// Makes the texels; what an output's weights are multiplied with, so are its texels.
    pub pack: F,
}

impl<F: Fn(&Tensor) -> Tensor + Send + Sync + 'static> Packing<F> {
    /// Adds packed weights to a recording.
    pub fn record(
        self,
        recording: &mut Recording,
        name: &str,
        weight: &Constant,
        precision: Precision,
    ) -> Stored {
        let Self { texels, outputs, tile, copies, pack } = self;
        let label = label(name, copies, tile);
        if precision == Precision::F32 {
            let packed = weight.packed(texels, pack);
            let texels = recording.constant_texture(label, packed, precision);
            return Stored { texels, scale: None };
        }
        // Found once, by whichever is made first.
        let found: Arc<OnceLock<Vec<f32>>> = Arc::default();
        let powers = found.clone();
        let packed = weight.packed(texels, move |weight| {
            pack(&powered(weight, powers.get_or_init(|| weight_powers(weight))))
        });
        let (from, spec) = (weight.clone(), TensorSpec::f32([outputs]));
        let scale = Constant::made(spec, move || {
            let made = match found.get() {
                Some(powers) => powers.clone(),
                None => weight_powers(from.get()?.f32()?),
            };
            let all = made.len() * copies;
            let scale = |i: usize| if i < all { 1.0 / made[i % made.len()] } else { 1.0 };
            Ok(Tensor::from_fn([outputs], scale).into())
        });
        let texels = recording.constant_texture(label, packed, precision);
        let scale = recording.constant(format!("{name} (scale)"), scale);
        Stored { texels, scale: Some(scale) }
    }

    /// The same in a buffer, in f32.
    pub fn record_buffer(self, recording: &mut Recording, name: &str, weight: &Constant) -> Stored {
        let Self { texels, tile, copies, pack, .. } = self;
        let packed = weight.packed(texels, pack);
        let texels = recording.constant(label(name, copies, tile), packed);
        Stored { texels, scale: None }
    }
}

/// What packed weights are called. Programs share constants by name and storage: what lies otherwise needs another
/// name.
fn label(name: &str, copies: usize, tile: usize) -> String {
    format!("{name} (packed {copies} x {tile})")
}
