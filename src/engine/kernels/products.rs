//! What a shader with `wgsl/shared/products.wgsl` has to know of an adapter's subgroups.
//!
//! Such a shader reads by lane and spreads by broadcast from a subgroup's first 4, 8 or 16 lanes. What is spread
//! is the same for the whole workgroup, or for a slice of it, which is whole subgroups (`wgsl/shared/slices.wgsl`):
//! so subgroups may be of any size from the variant's lanes on, and which invocation has which lane does not
//! matter. It counts on one thing that WGSL does not promise: those first lanes run.
//! They do where a workgroup whose size is a multiple of the subgroups' is cut into whole ones. Vulkan has a
//! flag for that, which wgpu 30 does not set.

use crate::engine::kernels::Caps;
use crate::engine::shader::Variant;

/// Fewest lanes of a subgroup with which the shaders can do something.
const FEWEST: u32 = 4;
/// Most invocations of a workgroup that any adapter need have.
const MOST: u32 = 256;
/// Most slices of a workgroup that share its sums.
const MOST_SLICES: u32 = 8;

/// Slices of so many invocations that a workgroup has room for.
pub(super) fn most_slices(invocations: u32) -> u32 {
    MOST_SLICES.min(MOST / invocations)
}

/// Subgroups that an adapter has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Lanes {
    /// What each has at least.
    least: u32,
    /// Invocations of a workgroup, which are whole subgroups of any of its sizes.
    pub workgroup: u32,
}

impl Lanes {
    /// `None` where there are none, or of too few lanes.
    pub fn of(caps: &Caps) -> Option<Self> {
        let (least, workgroup) = (caps.subgroup_min, caps.subgroup_max);
        // Of two powers the greater is a multiple of all between.
        let whole = least.is_power_of_two() && workgroup.is_power_of_two();
        let fit = whole && FEWEST <= least && least <= workgroup && workgroup <= MOST;
        fit.then_some(Self { least, workgroup })
    }

    /// The variant of a shader for such subgroups, or for none.
    pub fn variant(lanes: Option<Self>, variant: Variant) -> Variant {
        let least = lanes.map_or(0, |lanes| lanes.least);
        variant
            .with("SUBGROUPS", lanes.is_some())
            .with("FOUR_LANES", (FEWEST..8).contains(&least))
            .with("EIGHT_LANES", (8..16).contains(&least))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the least size; workgroups by the largest.
    #[test]
    fn variants_follow_from_the_least_size() {
        let of = |[subgroup_min, subgroup_max]: [u32; 2]| {
            let caps = Caps { subgroup_min, subgroup_max, ..Caps::default() };
            let lanes = Lanes::of(&caps)?;
            let flags = Lanes::variant(Some(lanes), Variant::default()).flags;
            Some((*flags.last()?, lanes.workgroup))
        };
        let (four, eight, more) = ("FOUR_LANES", "EIGHT_LANES", "SUBGROUPS");
        assert_eq!(of([4, 4]), Some((four, 4)));
        assert_eq!(of([4, 64]), Some((four, 64)));
        assert_eq!(of([8, 8]), Some((eight, 8)));
        assert_eq!(of([8, 32]), Some((eight, 32)));
        assert_eq!(of([16, 16]), Some((more, 16)));
        assert_eq!(of([32, 64]), Some((more, 64)));
        assert_eq!(of([64, 128]), Some((more, 128)));
        // None; too few lanes; no workgroup of whole ones; larger than any workgroup; the wrong way round.
        for none in [[0, 0], [1, 64], [2, 2], [6, 12], [8, 24], [8, 512], [64, 32]] {
            assert_eq!(of(none), None, "{none:?}");
        }
        assert_eq!(Lanes::variant(None, Variant::default()), Variant::default());
    }
}
