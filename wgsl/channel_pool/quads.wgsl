// Average and maximum of each channel over space: a map, four channels a texel, to [2, C].

// include: bound
// include: quads
// include: texels
// include: over_space

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

fn map_texel(which: u32, index: u32) -> vec4<f32> {
    return loaded(input[index]);
}

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.map;
    let quad = workgroup.x * QUADS + local / QUAD_LANES;
    let total = over_space(map, 0u, workgroup.z, quad, local);
    let channel = quad * 4u + local % 4u;
    if local % QUAD_LANES >= 8u || channel >= map.channels {
        return;
    }
    let to = workgroup.z * params.output_stride + channel;
    if local % 8u < 4u {
        output[to] = total / f32(map.width * map.height);
    } else {
        output[to + map.channels] = total;
    }
}
