// A part of a picture, resized and normalised, or a window of it, as
// [3, height, width]. Past the resized part's edge the output repeats it.
//
// The mean is subtracted in two parts: a whole number of levels from each pixel, which is exact, and
// the rest at the end. So a picture near its mean loses no digits to the subtraction.

// include: index
// include: pixels
// include: triangle

@group(0) @binding(0) var<uniform> params: Params;
// Its bytes, four a word.
@group(0) @binding(1) var<storage, read> picture: array<u32>;
// Picture width and height; the part's x, y, columns and rows; the resized width and height; x and y
// of the window; the pixels' format.
@group(0) @binding(2) var<storage, read> crop: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let area = params.width * params.height;
    let pixel = linear_index(workgroup, local, 64u);
    if pixel >= area {
        return;
    }
    let map = pixels();
    let corner = vec2(crop[2], crop[3]);
    let y = pixel / params.width;
    let rows = taps(axis(1u), y);
    let columns = taps(axis(0u), pixel - y * params.width);
    let shift = vec3<f32>(params.shift_r, params.shift_g, params.shift_b);
    var total = vec3<f32>(0.0);
    for (var j = rows.first; j < rows.end; j++) {
        var row = vec3<f32>(0.0);
        for (var i = columns.first; i < columns.end; i++) {
            let rgb = colour(map, corner + vec2(i, j));
            row = fma(vec3<f32>(weight(columns, i)), vec3<f32>(rgb) - shift, row);
        }
        total = fma(vec3<f32>(weight(rows, j)), row, total);
    }
    let value = total / (total_weight(rows) * total_weight(columns) * 255.0);
    let rest = vec3<f32>(params.rest_r, params.rest_g, params.rest_b);
    let deviation = vec3<f32>(params.std_r, params.std_g, params.std_b);
    let normal = (value - rest) / deviation;
    output[pixel] = normal.x;
    output[area + pixel] = normal.y;
    output[2u * area + pixel] = normal.z;
}
