// The largest value in each window, or a NaN that is in it, on [C, H, W]. Windows are cut at the
// picture's edges, which is the same as padding with minus infinity; none is empty as padding is at
// most half the kernel.

// include: index
// include: window

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

// By its bits: WGSL lets a compiler assume that a comparison sees no NaN.
fn is_nan(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) > 0x7f800000u;
}

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
    let rows = window(row - channel * params.out_height, params.in_height);
    let columns = window(index - row * params.out_width, params.in_width);
    let plane = channel * params.in_height * params.in_width;
    var largest = input[plane + rows.x * params.in_width + columns.x];
    for (var y = rows.x; y < rows.y; y++) {
        for (var x = columns.x; x < columns.y; x++) {
            let value = input[plane + y * params.in_width + x];
            largest = select(largest, value, value > largest || is_nan(value));
        }
    }
    output[index] = largest;
}
