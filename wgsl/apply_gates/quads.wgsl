// input * channel gate * spatial gate, on a map with four channels a texel.
//
// A workgroup computes the spatial gates of its pixels, then goes over some quads of channels. The channels are a
// multiple of four.

// include: bound
// include: quads
// include: texels
// include: sigmoid
// include: gates

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read> channel_gate: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> pooled: array<f32>;
@group(0) @binding(4) var<storage, read> weight: array<f32>;
@group(0) @binding(5) var<storage, read> bias: array<f32>;
@group(0) @binding(6) var<storage, read_write> output: array<OutputTexel>;

@compute @workgroup_size(SPANS)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.map;
    let first = workgroup.z * params.pooled_stride;
    let maps = Pooled(map.width, map.height, first, map.zero);
    let first_span = workgroup.x * SPANS;
    find_gates(maps, first_span + local, local);
    let first_quad = workgroup.y * params.group_quads;
    let end = min(first_quad + params.group_quads, map.quads);
    let channels = workgroup.z * params.channel_gate_stride / 4u;
    // Where each of eight pixels lies in its quad. Unrolled, these are registers.
    var own: array<Pixel, 8>;
    for (var i = 0u; i < 8u; i++) {
        own[i] = pixel(maps, first_span, i * SPANS + local);
    }
    var corner = texel(map, workgroup.z, first_quad, 0u, 0u);
    for (var quad = first_quad; quad < end; quad++) {
        let by_channel = channel_gate[channels + quad];
        for (var i = 0u; i < 8u; i++) {
            if own[i].exists {
                let index = texel_index(map, corner + vec2(own[i].x, own[i].y));
                output[index] = stored(loaded(input[index]) * by_channel * own[i].gate);
            }
        }
        corner = next_quad(map, corner);
    }
}
