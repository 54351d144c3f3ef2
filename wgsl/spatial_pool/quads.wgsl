// Maximum and mean over the channels of input * channel gate: a map, four channels a texel, to
// [2, H, W].
//
// An invocation computes two pixels of a row, eight apart, which share the gates. A workgroup is
// sixteen pixels of a row by eight slices of the channels, or, where the channels are few, by eight
// rows or something between. The channels are a multiple of four.

// include: quads
// include: texels

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read> channel_gate: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

// The sums over a slice of the two pixels, and their maxima.
var<workgroup> parts: array<vec4<f32>, 64>;

fn sum_of(x: vec4<f32>) -> f32 {
    return x.x + x.y + x.z + x.w;
}

fn largest_of(x: vec4<f32>) -> f32 {
    let pair = max(x.xy, x.zw);
    return max(pair.x, pair.y);
}

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let map = params.map;
    let slices = 1u << params.slice_bits;
    let slice = local.y & (slices - 1u);
    let x = workgroup.x * 16u + local.x;
    let y = ((workgroup.y * 8u) >> params.slice_bits) + (local.y >> params.slice_bits);
    let inside = x < map.width && y < map.height;

    let first = slice * params.slice_quads;
    let end = select(0u, min(first + params.slice_quads, map.quads), inside);
    var at = texel(map, workgroup.z, first, y, x);
    let gates = workgroup.z * params.gate_stride / 4u;
    // Where there is no far pixel, it is the near one again; nobody stores it then.
    let apart = select(0u, 8u, x + 8u < map.width);
    var near_sum = vec4(0.0);
    var near_largest = vec4(lowest(map));
    var far_sum = vec4(0.0);
    var far_largest = near_largest;
    for (var q = first; q < end; q++) {
        let gate = channel_gate[gates + q];
        let index = texel_index(map, at);
        let near = loaded(input[index]) * gate;
        let far = loaded(input[index + apart]) * gate;
        near_sum += near;
        near_largest = max(near_largest, near);
        far_sum += far;
        far_largest = max(far_largest, far);
        at = next_quad(map, at);
    }
    var found = vec4(
        sum_of(near_sum),
        sum_of(far_sum),
        largest_of(near_largest),
        largest_of(far_largest),
    );
    parts[lane] = found;
    workgroupBarrier();

    if slice != 0u || !inside {
        return;
    }
    for (var i = 1u; i < slices; i++) {
        let part = parts[lane + 8u * i];
        found = vec4(found.xy + part.xy, max(found.zw, part.zw));
    }
    let means = found.xy / f32(map.channels);
    let area = map.height * map.width;
    let to = workgroup.z * params.output_stride + y * map.width + x;
    output[to] = found.z;
    output[to + area] = means.x;
    if x + 8u < map.width {
        output[to + 8u] = found.w;
        output[to + 8u + area] = means.y;
    }
}
