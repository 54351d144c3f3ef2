// input * channel gate * spatial gate, on a map with four channels a texel.
//
// A workgroup is eight rows of a quad; an invocation goes along its row in steps of eight pixels.
// The channels are a multiple of four.

// include: quads
// include: texels

struct Params {
    map: Quads,
    channel_gate_stride: u32,
    spatial_gate_stride: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read> channel_gate: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> spatial_gate: array<f32>;
@group(0) @binding(4) var<storage, read_write> output: array<OutputTexel>;

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let map = params.map;
    let quad = workgroup.y;
    let y = workgroup.x * 8u + local.y;
    if y >= map.height {
        return;
    }
    let by_channel = channel_gate[workgroup.z * params.channel_gate_stride / 4u + quad];
    let row = texel_index(map, texel(map, workgroup.z, quad, y, 0u));
    let gate_row = workgroup.z * params.spatial_gate_stride + y * map.width;
    for (var x = local.x; x < map.width; x += 8u) {
        let value = loaded(input[row + x]);
        output[row + x] = stored(value * by_channel * spatial_gate[gate_row + x]);
    }
}
