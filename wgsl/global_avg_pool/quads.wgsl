// Average of each channel over space: up to three maps, four channels a texel, to their values side by side.

// include: bound
// include: quads
// include: texels
// include: over_space

@group(0) @binding(0) var<uniform> params: Params;
// Where there are fewer, one is bound again.
@group(0) @binding(1) var<storage, read> map0: array<Texel>;
@group(0) @binding(2) var<storage, read> map1: array<Texel>;
@group(0) @binding(3) var<storage, read> map2: array<Texel>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;

fn map_texel(which: u32, index: u32) -> vec4<f32> {
    switch which {
        case 0u: { return loaded(map0[index]); }
        case 1u: { return loaded(map1[index]); }
        default: { return loaded(map2[index]); }
    }
}

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    // The map of this quad, and the channels of those before it.
    var which = 0u;
    var quad = workgroup.x * QUADS + local / QUAD_LANES;
    var first = 0u;
    while which + 1u < params.used && quad >= params.maps[which].quads {
        quad -= params.maps[which].quads;
        first += params.maps[which].channels;
        which += 1u;
    }
    let map = params.maps[which];
    let total = over_space(map, which, workgroup.z, quad, local);
    let channel = quad * 4u + local % 4u;
    if local % QUAD_LANES >= 4u || channel >= map.channels {
        return;
    }
    output[workgroup.z * params.output_stride + first + channel] =
        total / f32(map.width * map.height);
}
