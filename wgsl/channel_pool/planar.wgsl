// Average and maximum of each channel over space: [C, H, W] to [2, C]. A workgroup a channel.

// include: bound
// include: index
// include: reduce

const WORKGROUP: u32 = 64u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let channel = linear_index(workgroup, 0u, 1u);
    if channel >= params.channels {
        return;
    }
    let plane = channel * params.area;
    var found = vec2<f32>(0.0, input[plane]);
    for (var i = local; i < params.area; i += WORKGROUP) {
        let x = input[plane + i];
        found = vec2<f32>(found.x + x, max(found.y, x));
    }
    found = tree_sum_max(local, found, 1u);
    if local == 0u {
        output[channel] = found.x / f32(params.area);
        output[params.channels + channel] = found.y;
    }
}
