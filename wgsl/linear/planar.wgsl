// A fully connected layer with bias and optional ReLU, over the rows in use.
//
// `partial`: one invocation computes 4 outputs of 8 rows over a slice of the inputs and keeps its
// 32 sums in registers. All invocations of a workgroup read the same inputs, and neighbouring ones
// read neighbouring weights. Slices give the device enough to do at few rows, and shorter sums are
// more accurate. `finish` adds the slices and the bias. `pad` comes first where a row is no whole
// number of vec4.

const ROWS: u32 = 8u;
const LANES: u32 = 64u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> unpadded: array<f32>;
@group(0) @binding(3) var<storage, read_write> padded: array<f32>;
@group(0) @binding(4) var<storage, read> input: array<vec4<f32>>;
// [4 * inner_quads][outputs / 4], zero in the padding.
@group(0) @binding(5) var<storage, read> weight: array<vec4<f32>>;
// [slices][rows][outputs / 4]
@group(0) @binding(6) var<storage, read_write> partials: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> bias: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> output: array<f32>;

// include: relu
// include: index

@compute @workgroup_size(64)
fn pad(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, LANES);
    let row = at / (4u * params.inner_quads);
    let column = at % (4u * params.inner_quads);
    if row >= min(count[0], params.rows) {
        return;
    }
    var value = 0.0;
    if column < params.inner {
        value = unpadded[row * params.inner + column];
    }
    padded[at] = value;
}

// A row's sums, and where its next inputs are.
struct Row {
    sums: vec4<f32>,
    at: u32,
}

fn start(row: u32, rows: u32, quad: u32) -> Row {
    // A tile's rows past the last repeat it; nobody stores their sums.
    return Row(vec4<f32>(0.0), min(row, rows - 1u) * params.inner_quads + quad);
}

fn step(row: ptr<function, Row>, w0: vec4<f32>, w1: vec4<f32>, w2: vec4<f32>, w3: vec4<f32>) {
    let x = input[(*row).at];
    var sums = fma(vec4<f32>(x.x), w0, (*row).sums);
    sums = fma(vec4<f32>(x.y), w1, sums);
    sums = fma(vec4<f32>(x.z), w2, sums);
    (*row).sums = fma(vec4<f32>(x.w), w3, sums);
    (*row).at += 1u;
}

@compute @workgroup_size(64)
fn partial(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let rows = min(count[0], params.rows);
    let first = linear_index(workgroup, 0u, 1u) * ROWS;
    let quads = (params.outputs + 3u) / 4u;
    let quad = workgroup.z / params.slices * LANES + local;
    let slice = workgroup.z % params.slices;
    if first >= rows || quad >= quads {
        return;
    }
    let begin = slice * params.slice_quads;
    let end = min(begin + params.slice_quads, params.inner_quads);
    var r0 = start(first, rows, begin);
    var r1 = start(first + 1u, rows, begin);
    var r2 = start(first + 2u, rows, begin);
    var r3 = start(first + 3u, rows, begin);
    var r4 = start(first + 4u, rows, begin);
    var r5 = start(first + 5u, rows, begin);
    var r6 = start(first + 6u, rows, begin);
    var r7 = start(first + 7u, rows, begin);
    var at = begin * 4u * quads + quad;
    for (var i = begin; i < end; i++) {
        let w0 = weight[at];
        let w1 = weight[at + quads];
        let w2 = weight[at + 2u * quads];
        let w3 = weight[at + 3u * quads];
        at += 4u * quads;
        step(&r0, w0, w1, w2, w3);
        step(&r1, w0, w1, w2, w3);
        step(&r2, w0, w1, w2, w3);
        step(&r3, w0, w1, w2, w3);
        step(&r4, w0, w1, w2, w3);
        step(&r5, w0, w1, w2, w3);
        step(&r6, w0, w1, w2, w3);
        step(&r7, w0, w1, w2, w3);
    }
    let to = (slice * params.rows + first) * quads + quad;
    partials[to] = r0.sums;
    if first + 1u < rows { partials[to + quads] = r1.sums; }
    if first + 2u < rows { partials[to + 2u * quads] = r2.sums; }
    if first + 3u < rows { partials[to + 3u * quads] = r3.sums; }
    if first + 4u < rows { partials[to + 4u * quads] = r4.sums; }
    if first + 5u < rows { partials[to + 5u * quads] = r5.sums; }
    if first + 6u < rows { partials[to + 6u * quads] = r6.sums; }
    if first + 7u < rows { partials[to + 7u * quads] = r7.sums; }
}

@compute @workgroup_size(64)
fn finish(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, LANES);
    let quads = (params.outputs + 3u) / 4u;
    let row = at / quads;
    let quad = at % quads;
    if row >= min(count[0], params.rows) {
        return;
    }
    var sums = bias[quad];
    for (var slice = 0u; slice < params.slices; slice++) {
        sums += partials[slice * params.rows * quads + at];
    }
    if params.relu != 0u {
        sums = relu(sums);
    }
    for (var i = 0u; i < min(4u, params.outputs - 4u * quad); i++) {
        output[row * params.outputs + 4u * quad + i] = sums[i];
    }
}
