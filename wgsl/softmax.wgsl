// Softmax of each row in use; one workgroup a row.

struct Params {
    rows: u32,
    columns: u32,
}

const LANES: u32 = 64u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read> count: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

var<workgroup> lanes: array<f32, 64>;

// include: index

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = linear_index(workgroup, workgroups, 0u, 1u);
    if row >= min(count[0], params.rows) {
        return;
    }
    let first = row * params.columns;

    // A lane without a column repeats the first.
    var highest = input[first + select(0u, lane, lane < params.columns)];
    for (var i = lane + LANES; i < params.columns; i += LANES) {
        highest = max(highest, input[first + i]);
    }
    lanes[lane] = highest;
    for (var step = LANES / 2u; step > 0u; step /= 2u) {
        workgroupBarrier();
        if lane < step {
            lanes[lane] = max(lanes[lane], lanes[lane + step]);
        }
    }
    workgroupBarrier();
    highest = lanes[0];
    workgroupBarrier();

    var sum = 0.0;
    for (var i = lane; i < params.columns; i += LANES) {
        sum += exp(input[first + i] - highest);
    }
    lanes[lane] = sum;
    for (var step = LANES / 2u; step > 0u; step /= 2u) {
        workgroupBarrier();
        if lane < step {
            lanes[lane] += lanes[lane + step];
        }
    }
    workgroupBarrier();
    sum = lanes[0];
    for (var i = lane; i < params.columns; i += LANES) {
        output[first + i] = exp(input[first + i] - highest) / sum;
    }
}
