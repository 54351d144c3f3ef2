// How many values of each chunk of some tensors are infinite or NaN. By their bits: WGSL lets a compiler
// assume that there are none. A workgroup is a chunk of CHUNK elements.

// include: index

const LANES: u32 = 256u;
const EXPONENT: u32 = 0x7f800000u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read_write> output: array<u32>;
@group(0) @binding(3) var<storage, read> input0: array<u32>;
@group(0) @binding(4) var<storage, read> input1: array<u32>;
@group(0) @binding(5) var<storage, read> input2: array<u32>;
@group(0) @binding(6) var<storage, read> input3: array<u32>;
@group(0) @binding(7) var<storage, read> input4: array<u32>;
@group(0) @binding(8) var<storage, read> input5: array<u32>;

var<workgroup> total: atomic<u32>;

fn bits(part: u32, at: u32) -> u32 {
    switch part {
        case 0u: { return input0[at]; }
        case 1u: { return input1[at]; }
        case 2u: { return input2[at]; }
        case 3u: { return input3[at]; }
        case 4u: { return input4[at]; }
        default: { return input5[at]; }
    }
}

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
    var at = 0u;
    var begin = 0u;
    while at + 1u < params.used && chunk >= params.parts[at].end {
        begin = params.parts[at].end;
        at += 1u;
    }
    let part = params.parts[at];
    let live = min(count[workgroup.z * params.count_stride], part.rows) * part.row_elements;
    let skipped = (chunk - begin) * CHUNK;
    let length = min(max(live, skipped) - skipped, CHUNK);
    let start = workgroup.z * part.stride + skipped;
    var found = 0u;
    for (var i = lane; i < length; i += LANES) {
        found += select(0u, 1u, (bits(at, start + i) & EXPONENT) == EXPONENT);
    }
    atomicAdd(&total, found);
    workgroupBarrier();
    if lane == 0u {
        output[workgroup.z * params.output_stride + params.first + chunk] = atomicLoad(&total);
    }
}
