// The parts of a convolution's sums, bias, optional residual and ReLU.

// include: quads
// include: texels
// include: relu
// include: index

struct Params {
    output: Quads,
    // Parts of a picture, which lie as pictures of their own.
    splits: u32,
    has_residual: u32,
    relu: u32,
    pictures: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> parts: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> bias: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> residual: array<Texel>;
@group(0) @binding(4) var<storage, read_write> output: array<OutputTexel>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.output;
    let index = linear_index(workgroup, local, 64u);
    let x = index % map.width;
    let y = index / map.width % map.height;
    let quad = index / (map.width * map.height) % map.quads;
    let picture = index / (map.width * map.height * map.quads);
    if picture >= params.pictures {
        return;
    }
    var value = bias[quad];
    for (var i = 0u; i < params.splits; i++) {
        value += parts[texel_index(map, texel(map, picture * params.splits + i, quad, y, x))];
    }
    let at = texel_index(map, texel(map, picture, quad, y, x));
    if params.has_residual != 0u {
        value += loaded(residual[at]);
    }
    if params.relu != 0u {
        value = relu(value);
    }
    let channel = quad * 4u + vec4<u32>(0u, 1u, 2u, 3u);
    output[at] = stored(select(vec4<f32>(), value, channel < vec4<u32>(map.channels)));
}
