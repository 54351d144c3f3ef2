// Maximum and mean over the channels of input * channel gate: [C, H, W] to [2, H, W].
//
// A workgroup computes 32 neighbouring pixels; 8 invocations share a pixel's channels, so that the
// deep, small maps keep a GPU busy too.

// include: bound
// include: index
// include: reduce

const WORKGROUP: u32 = 256u;
const PIXELS: u32 = 32u;
const SLICES: u32 = WORKGROUP / PIXELS;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read> channel_gate: array<f32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = linear_index(workgroup, 0u, 1u) * PIXELS + local % PIXELS;
    // Every invocation goes through the tree; those past the end repeat the last pixel.
    let at = min(pixel, params.area - 1u);
    var found = vec2<f32>(0.0, input[at] * channel_gate[0]);
    for (var c = local / PIXELS; c < params.channels; c += SLICES) {
        let x = input[c * params.area + at] * channel_gate[c];
        found = vec2<f32>(found.x + x, max(found.y, x));
    }
    found = tree_sum_max(local, found, PIXELS);
    if local < PIXELS && pixel < params.area {
        output[pixel] = found.y;
        output[params.area + pixel] = found.x / f32(params.channels);
    }
}
