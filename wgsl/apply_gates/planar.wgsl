// input * channel gate * spatial gate, on [C, H, W].

// include: index

struct Params {
    channels: u32,
    area: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read> channel_gate: array<f32>;
@group(0) @binding(3) var<storage, read> spatial_gate: array<f32>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = linear_index(workgroup, local, 64u);
    if index >= params.channels * params.area {
        return;
    }
    let channel = index / params.area;
    let pixel = index - channel * params.area;
    output[index] = input[index] * channel_gate[channel] * spatial_gate[pixel];
}
