// How many values of a tensor are infinite or NaN. By their bits: WGSL lets a compiler assume that
// there are none. One workgroup a picture.

struct Params {
    // Elements, in rows of so many where a count says how many rows are in use, else 0.
    elements: u32,
    row_elements: u32,
    // Elements of a picture of each buffer.
    input_stride: u32,
    count_stride: u32,
    output_stride: u32,
    // Where in a picture of the output the number goes.
    witness: u32,
    pad0: u32,
    pad1: u32,
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
    if lane == 0u {
        atomicStore(&total, 0u);
    }
    workgroupBarrier();
    var live = params.elements;
    if params.row_elements != 0u {
        // As many rows as fit, whatever the count says; no product can wrap.
        let rows = params.elements / params.row_elements;
        live = min(count[workgroup.z * params.count_stride], rows) * params.row_elements;
    }
    let first = workgroup.z * params.input_stride;
    var found = 0u;
    for (var i = lane; i < live; i += LANES) {
        found += select(0u, 1u, (input[first + i] & EXPONENT) == EXPONENT);
    }
    atomicAdd(&total, found);
    workgroupBarrier();
    if lane == 0u {
        output[workgroup.z * params.output_stride + params.witness] = atomicLoad(&total);
    }
}
