// Copies the rows that a list of indices names. The element type does not matter: bits are copied.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> indices: array<u32>;
@group(0) @binding(3) var<storage, read> count: array<u32>;
@group(0) @binding(4) var<storage, read_write> output: array<u32>;

// include: index

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, 64u);
    let row = at / params.columns;
    if row >= min(count[0], params.capacity) {
        return;
    }
    let source = min(indices[row], params.rows - 1u);
    output[at] = rows[source * params.columns + at % params.columns];
}
