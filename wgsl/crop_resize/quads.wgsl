// A part of a picture, resized and normalised, or a window of it, as a map of three
// channels, four a texel. Past the resized part's edge the output repeats it.
//
// The mean is subtracted in two parts: a whole number of levels from each pixel, which is exact, and
// the rest at the end. So a picture near its mean loses no digits to the subtraction.
//
// An invocation computes four pixels of a column, which share the sums of the picture's rows; a
// workgroup is 8 x 8 such columns.

// include: pixels
// include: triangle
// include: quads
// include: texels

@group(0) @binding(0) var<uniform> params: Params;
// Its bytes, four a word.
@group(0) @binding(1) var<storage, read> picture: array<u32>;
// Picture width and height; the part's x, y, columns and rows; the resized width and height; x and y
// of the window; the pixels' format.
@group(0) @binding(2) var<storage, read> crop: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<OutputTexel>;

fn store(at: vec2<u32>, y: u32, value: vec3<f32>) {
    if y < params.map.height {
        let rest = vec3(params.rest_r, params.rest_g, params.rest_b);
        let deviation = vec3(params.std_r, params.std_g, params.std_b);
        output[texel_index(params.map, at)] = stored(vec4((value - rest) / deviation, 0.0));
    }
}

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let map = params.map;
    let x = workgroup.x * 8u + local.x;
    let y = (workgroup.y * 8u + local.y) * 4u;
    if x >= map.width || y >= map.height {
        return;
    }
    let source = pixels();
    let corner = vec2(crop[2], crop[3]);
    // Rows past the last repeat it; nobody stores them.
    let last = map.height - 1u;
    let down = axis(1u);
    let rows0 = taps(down, y);
    let rows1 = taps(down, min(y + 1u, last));
    let rows2 = taps(down, min(y + 2u, last));
    let rows3 = taps(down, min(y + 3u, last));
    let columns = taps(axis(0u), x);
    let shift = vec3(params.shift_r, params.shift_g, params.shift_b);
    // How far the first column is from the centre, and from one to the next: integers in f32.
    let start_distance = f32(i32(columns.centre - (2u * columns.first + 1u) * columns.size));
    let step = f32(2u * columns.size);
    let reach = f32(columns.reach);
    var total0 = vec3(0.0);
    var total1 = vec3(0.0);
    var total2 = vec3(0.0);
    var total3 = vec3(0.0);
    for (var j = rows0.first; j < rows3.end; j++) {
        var row = vec3(0.0);
        var distance = start_distance;
        for (var i = columns.first; i < columns.end; i += 4u) {
            let four = four_colours(source, corner + vec2(i, j));
            // Those past the last column count for nothing.
            let places = vec4(distance) - step * vec4(0.0, 1.0, 2.0, 3.0);
            let inside = vec4(i) + vec4(0u, 1u, 2u, 3u) < vec4(columns.end);
            let weights = select(vec4(0.0), vec4(reach) - abs(places), inside);
            row = fma(vec3(weights.x), vec3<f32>(four.a) - shift, row);
            row = fma(vec3(weights.y), vec3<f32>(four.b) - shift, row);
            row = fma(vec3(weights.z), vec3<f32>(four.c) - shift, row);
            row = fma(vec3(weights.w), vec3<f32>(four.d) - shift, row);
            distance -= 4.0 * step;
        }
        total0 = fma(vec3(weight(rows0, j)), row, total0);
        total1 = fma(vec3(weight(rows1, j)), row, total1);
        total2 = fma(vec3(weight(rows2, j)), row, total2);
        total3 = fma(vec3(weight(rows3, j)), row, total3);
    }
    let scale = total_weight(columns) * 255.0;
    let at = texel(map, 0u, 0u, y, x);
    store(at, y, total0 / (total_weight(rows0) * scale));
    store(at + vec2(0u, 1u), y + 1u, total1 / (total_weight(rows1) * scale));
    store(at + vec2(0u, 2u), y + 2u, total2 / (total_weight(rows2) * scale));
    store(at + vec2(0u, 3u), y + 3u, total3 / (total_weight(rows3) * scale));
}
