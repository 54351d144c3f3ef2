// A part of a picture, resized and normalised, or a window of it, as
// [3, height, width]. Past the resized part's edge the output repeats it.
//
// The mean is subtracted in two parts: a whole number of levels from each pixel, which is exact, and
// the rest at the end. So a picture near its mean loses no digits to the subtraction.
//
// The filter is a triangle, widened where the picture shrinks. Along an axis, a part of `side` pixels
// becomes `size`; distances are counted in 1 / (2 size) of a picture's pixel: pixel j has its centre
// at (2j + 1) size, output i at (2i + 1) side, and the triangle reaches 2 max(side, size). All are
// integers, so that each weight is exact.

// include: index
// include: pixels

struct Params {
    width: u32,
    height: u32,
    capacity: u32,
    shift_r: f32,
    shift_g: f32,
    shift_b: f32,
    rest_r: f32,
    rest_g: f32,
    rest_b: f32,
    std_r: f32,
    std_g: f32,
    std_b: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
// Its bytes, four a word.
@group(0) @binding(1) var<storage, read> picture: array<u32>;
// Picture width and height; the part's x, y, columns and rows; the resized width and height; x and y
// of the window; the pixels' format.
@group(0) @binding(2) var<storage, read> crop: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

// An axis of the part: its pixels, the pixels it is resized to, and where the window begins.
struct Axis {
    side: u32,
    size: u32,
    window: u32,
}

// The crop is data: no side is longer than the picture's, nor than the buffer, and none is nothing.
fn axis(which: u32) -> Axis {
    let side = min(crop[4u + which], min(crop[which], params.capacity));
    return Axis(side, max(crop[6u + which], 1u), crop[8u + which]);
}

// The pixels first..end of the part, along one axis, that one output sees.
struct Taps {
    size: u32,
    centre: u32,
    reach: u32,
    first: u32,
    end: u32,
}

fn taps(along: Axis, output_at: u32) -> Taps {
    let size = along.size;
    let i = min(output_at + along.window, size - 1u);
    let centre = (2u * i + 1u) * along.side;
    let reach = 2u * max(along.side, size);
    var first = 0u;
    if centre >= reach + size {
        first = (centre - reach - size) / (2u * size) + 1u;
    }
    let end = min((centre + reach + size - 1u) / (2u * size), along.side);
    return Taps(size, centre, reach, first, end);
}

fn weight(t: Taps, j: u32) -> f32 {
    let at = (2u * j + 1u) * t.size;
    return f32(t.reach - (max(at, t.centre) - min(at, t.centre)));
}

fn total_weight(t: Taps) -> f32 {
    var total = 0.0;
    for (var j = t.first; j < t.end; j++) {
        total += weight(t, j);
    }
    return total;
}

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
