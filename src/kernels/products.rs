//! What a shader with `wgsl/shared/products.wgsl` has to know of an adapter's subgroups.

use crate::kernels::Caps;
use crate::shader::Variant;

/// Fewest lanes of a subgroup with which the shaders can do something.
const FEWEST: u32 = 4;

/// The lanes of a subgroup, where an adapter has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Lanes(pub Option<u32>);

impl Lanes {
    pub fn of(caps: &Caps) -> Self {
        Self(caps.subgroup.filter(|lanes| *lanes >= FEWEST))
    }

    /// Whether the adapter is taken for one with many cores, which few workgroups leave idle.
    pub fn of_many_cores(self) -> bool {
        self.0.is_some_and(|lanes| lanes >= 16)
    }

    /// The variant of a shader for such subgroups.
    pub fn variant(self, variant: Variant) -> Variant {
        variant
            .with("SUBGROUPS", self.0.is_some())
            .with("FOUR_LANES", self.0.is_some_and(|lanes| lanes < 8))
            .with("EIGHT_LANES", self.0.is_some_and(|lanes| (8..16).contains(&lanes)))
    }
}
