//! Workgroups for a count.

/// Workgroups a dimension may have under WebGPU's default limits.
pub const MAX_WORKGROUPS: u32 = 65_535;

/// `[x, y, layers]` with `x · y ≥ ⌈count · items_per_count / workgroup_size⌉`: one row of
/// workgroups up to 65 535, full rows past it, and `[0, 0, layers]` where there is nothing to do.
pub fn indirect_grid(
    count: usize,
    items_per_count: u32,
    workgroup_size: u32,
    layers: u32,
) -> [u32; 3] {
    let groups = (count as u64 * u64::from(items_per_count)).div_ceil(u64::from(workgroup_size));
    let x = groups.min(MAX_WORKGROUPS.into());
    let y = if x == 0 { 0 } else { groups.div_ceil(x) };
    [x as u32, y as u32, layers]
}
