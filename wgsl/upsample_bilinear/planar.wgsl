// Bilinear interpolation of [C, H, W] to another size, pixel centres at halves, clamped at the edges.
//
// Output i lies at ((2i + 1) in - out) / (2 out) in pixels of the input. That is computed in
// integers, so that only the remainder's division rounds.

// include: index
// include: between

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = linear_index(workgroup, local, 64u);
    if index >= params.channels * params.out_height * params.out_width {
        return;
    }
    let row = index / params.out_width;
    let channel = row / params.out_height;
    let y = between(row - channel * params.out_height, params.in_height, params.out_height);
    let x = between(index - row * params.out_width, params.in_width, params.out_width);
    let top = (channel * params.in_height + y.low) * params.in_width;
    let bottom = (channel * params.in_height + y.high) * params.in_width;
    let left = (1.0 - y.part) * input[top + x.low] + y.part * input[bottom + x.low];
    let right = (1.0 - y.part) * input[top + x.high] + y.part * input[bottom + x.high];
    output[index] = (1.0 - x.part) * left + x.part * right;
}
