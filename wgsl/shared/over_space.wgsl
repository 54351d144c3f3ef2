// Sum and maximum of four channels over space. A workgroup goes over QUADS of them, ROWS rows at a time by COLUMNS
// pixels. An invocation adds up its pixels of a row, then the rows, so that no sum is long.
//
// Constants: ROWS and QUADS. The including shader declares `map_texel(which, index)`: what lies in the buffer of one
// of its maps.

const COLUMNS: u32 = 8u;
const LANES: u32 = COLUMNS * ROWS * QUADS;
// Invocations of a quad.
const QUAD_LANES: u32 = COLUMNS * ROWS;

// By sum and maximum, channel, invocation.
var<workgroup> of_pixels: array<f32, 8u * LANES>;
var<workgroup> of_rows: array<f32, LANES>;

// For the first four invocations of each quad the sum of a channel each, for the next four its maximum; of none for
// a quad that does not exist. All of a workgroup call it.
fn over_space(map: Quads, which: u32, picture: u32, quad: u32, local: u32) -> f32 {
    let row_texels = map.columns * map.pitch;
    let first_row = local / COLUMNS % ROWS;
    var row = texel_index(map, texel(map, picture, quad, first_row, 0u));
    var sum = vec4(0.0);
    var largest = vec4(lowest(map));
    let height = select(0u, map.height, quad < map.quads);
    for (var y = first_row; y < height; y += ROWS) {
        var row_sum = vec4(0.0);
        for (var x = local % COLUMNS; x < map.width; x += COLUMNS) {
            let value = map_texel(which, row + x);
            row_sum += value;
            largest = max(largest, value);
        }
        sum += row_sum;
        row += ROWS * row_texels;
    }
    for (var i = 0u; i < bound(4u, map.zero); i++) {
        of_pixels[i * LANES + local] = sum[i];
        of_pixels[(4u + i) * LANES + local] = largest[i];
    }
    workgroupBarrier();
    // An invocation brings together what shared its row, then eight of a quad bring together all rows.
    let of_maxima = local % 8u >= 4u;
    let first = local % 8u * LANES + local / COLUMNS * COLUMNS;
    var total = of_pixels[first];
    for (var i = 1u; i < bound(COLUMNS, map.zero); i++) {
        let other = of_pixels[first + i];
        total = select(total + other, max(total, other), of_maxima);
    }
    of_rows[local] = total;
    workgroupBarrier();
    if local % QUAD_LANES < 8u {
        for (var i = 1u; i < bound(ROWS, map.zero); i++) {
            let other = of_rows[local + i * COLUMNS];
            total = select(total + other, max(total, other), of_maxima);
        }
    }
    return total;
}
