// Turns a count on the device into the arguments of indirect dispatches, those of one an invocation.

const MAX_WORKGROUPS: u32 = 65535u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read_write> grids: array<u32>;

// Not (a + b - 1) / b, which could wrap.
fn divide_up(a: u32, b: u32) -> u32 {
    return a / b + select(0u, 1u, a % b != 0u);
}

@compute @workgroup_size(16)
fn main(@builtin(local_invocation_index) index: u32) {
    if index >= params.used {
        return;
    }
    let rule = params.rules[index];
    // `IndirectGrid::shapes` made sure that capacity * items_per_count fits in a u32.
    let items = min(count[0], rule.capacity) * rule.items_per_count;
    let groups = divide_up(items, rule.workgroup_size);
    let x = min(groups, MAX_WORKGROUPS);
    grids[3u * index] = x;
    grids[3u * index + 1u] = divide_up(groups, max(x, 1u));
    grids[3u * index + 2u] = rule.layers;
}
