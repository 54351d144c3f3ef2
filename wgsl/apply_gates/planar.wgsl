// input * channel gate * spatial gate, on [C, H, W].
//
// A workgroup computes the spatial gates of its pixels, then goes over the channels.

// include: bound
// include: index
// include: sigmoid
// include: gates

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read> channel_gate: array<f32>;
@group(0) @binding(3) var<storage, read> pooled: array<f32>;
@group(0) @binding(4) var<storage, read> weight: array<f32>;
@group(0) @binding(5) var<storage, read> bias: array<f32>;
@group(0) @binding(6) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(SPANS)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let maps = Pooled(params.width, params.height, 0u, params.zero);
    let first_span = linear_index(workgroup, 0u, SPANS);
    find_gates(maps, first_span + local, local);
    for (var i = 0u; i < bound(8u, params.zero); i++) {
        let own = pixel(maps, first_span, i * SPANS + local);
        if !own.exists {
            continue;
        }
        var at = own.y * params.width + own.x;
        for (var channel = 0u; channel < params.channels; channel++) {
            output[at] = input[at] * channel_gate[channel] * own.gate;
            at += params.height * params.width;
        }
    }
}
