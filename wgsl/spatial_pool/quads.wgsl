// Maximum and mean over the channels of input * channel gate: a map, four channels a texel, to
// [2, H, W].
//
// A workgroup is eight pixels of a row by eight slices of the channels, or, where the channels are
// few, by eight rows or something between. The channels are a multiple of four.

// include: quads

struct Params {
    map: Quads,
    // log2 of the slices of the channels, at most 3.
    slice_bits: u32,
    slice_quads: u32,
    gate_stride: u32,
    // Elements of a picture of the output.
    output_stride: u32,
}

const LOWEST: f32 = -0x1.fffffep+127f;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> channel_gate: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

// Sum and maximum.
var<workgroup> parts: array<vec2<f32>, 64>;

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let map = params.map;
    let slices = 1u << params.slice_bits;
    let slice = local.y & (slices - 1u);
    let x = workgroup.x * 8u + local.x;
    let y = ((workgroup.y * 8u) >> params.slice_bits) + (local.y >> params.slice_bits);
    let inside = x < map.width && y < map.height;

    let first = slice * params.slice_quads;
    let end = select(0u, min(first + params.slice_quads, map.quads), inside);
    var at = texel(map, workgroup.z, first, y, x);
    var gate_at = workgroup.z * params.gate_stride / 4u;
    var sum = vec4(0.0);
    var largest = vec4(LOWEST);
    for (var q = first; q < end; q++) {
        let gated = input[texel_index(map, at)] * channel_gate[gate_at + q];
        sum += gated;
        largest = max(largest, gated);
        at = next_quad(map, at);
    }
    let pair = max(largest.xy, largest.zw);
    var found = vec2(sum.x + sum.y + sum.z + sum.w, max(pair.x, pair.y));
    parts[lane] = found;
    workgroupBarrier();

    if slice != 0u || !inside {
        return;
    }
    for (var i = 1u; i < slices; i++) {
        let part = parts[lane + 8u * i];
        found = vec2(found.x + part.x, max(found.y, part.y));
    }
    let to = workgroup.z * params.output_stride + y * map.width + x;
    output[to] = found.y;
    output[to + map.height * map.width] = found.x / f32(map.channels);
}
