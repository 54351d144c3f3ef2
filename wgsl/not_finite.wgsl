// How many values of each chunk of a tensor are infinite or NaN. By their bits: WGSL lets a compiler
// assume that there are none. A workgroup is a chunk of CHUNK elements.

// include: index

struct Params {
    // Rows, of which a count says how many are in use, and elements of a row.
    rows: u32,
    row_elements: u32,
    chunks: u32,
    // Elements of a picture of each buffer.
    input_stride: u32,
    count_stride: u32,
    output_stride: u32,
}

const LANES: u32 = 256u;
const EXPONENT: u32 = 0x7f800000u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<u32>;
@group(0) @binding(2) var<storage, read> count: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<u32>;

var<workgroup> total: atomic<u32>;

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let chunk = linear_index(workgroup, 0u, 1u);
    if chunk >= params.chunks {
        return;
    }
    if lane == 0u {
        atomicStore(&total, 0u);
    }
    workgroupBarrier();
    let live = min(count[workgroup.z * params.count_stride], params.rows) * params.row_elements;
    let first = chunk * CHUNK;
    let length = min(max(live, first) - first, CHUNK);
    let start = workgroup.z * params.input_stride + first;
    var found = 0u;
    for (var i = lane; i < length; i += LANES) {
        found += select(0u, 1u, (input[start + i] & EXPONENT) == EXPONENT);
    }
    atomicAdd(&total, found);
    workgroupBarrier();
    if lane == 0u {
        output[workgroup.z * params.output_stride + chunk] = atomicLoad(&total);
    }
}
