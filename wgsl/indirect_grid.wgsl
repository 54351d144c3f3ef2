// Turns a count on the device into the arguments of an indirect dispatch.

struct Params {
    capacity: u32,
    items_per_count: u32,
    workgroup_size: u32,
    layers: u32,
}

const MAX_WORKGROUPS: u32 = 65535u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read_write> grid: array<u32>;

// Not (a + b - 1) / b, which could wrap.
fn divide_up(a: u32, b: u32) -> u32 {
    return a / b + select(0u, 1u, a % b != 0u);
}

@compute @workgroup_size(1)
fn main() {
    // `record` made sure that capacity * items_per_count fits in a u32.
    let items = min(count[0], params.capacity) * params.items_per_count;
    let groups = divide_up(items, params.workgroup_size);
    let x = min(groups, MAX_WORKGROUPS);
    grid[0] = x;
    grid[1] = divide_up(groups, max(x, 1u));
    grid[2] = params.layers;
}
