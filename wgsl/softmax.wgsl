// Softmax of each row in use; one workgroup a row.

const WORKGROUP: u32 = 64u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read> count: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

// include: bound
// include: index
// include: reduce

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = linear_index(workgroup, 0u, 1u);
    // Workgroups behind the count go through all barriers, but write nothing.
    let columns = select(0u, params.columns, row < min(count[0], params.rows));
    let first = min(row, params.rows - 1u) * params.columns;

    // A lane without a column repeats the first.
    var highest = input[first + select(0u, lane, lane < columns)];
    for (var i = lane + WORKGROUP; i < columns; i += WORKGROUP) {
        highest = max(highest, input[first + i]);
    }
    highest = tree_sum_max(lane, vec2<f32>(0.0, highest), 1u).y;

    var sum = 0.0;
    for (var i = lane; i < columns; i += WORKGROUP) {
        sum += exp((input[first + i] - highest) * params.scale);
    }
    sum = tree_sum(lane, vec2<f32>(sum, 0.0), 1u).x;
    for (var i = lane; i < columns; i += WORKGROUP) {
        output[first + i] = exp((input[first + i] - highest) * params.scale) / sum;
    }
}
