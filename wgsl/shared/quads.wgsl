// Where the channels of maps lie, four a texel: `Quads` of src/engine/kernels/layout.rs.

/// Column and row of pixel (x, y) of quad q of picture n.
fn texel(map: Quads, n: u32, q: u32, y: u32, x: u32) -> vec2<u32> {
    return vec2(
        x + (q % map.columns) * map.pitch,
        y + (q / map.columns) * map.height + n * map.rows,
    );
}

/// Minus infinity, which no constant of WGSL may be.
fn lowest(map: Quads) -> f32 {
    return bitcast<f32>(0xff800000u | map.zero);
}

/// Place in a buffer of what lies at a column and a row.
fn texel_index(map: Quads, at: vec2<u32>) -> u32 {
    return at.y * (map.columns * map.pitch) + at.x;
}

/// Where the same pixel lies in the next quad; spares the divisions of `texel`.
fn next_quad(map: Quads, at: vec2<u32>) -> vec2<u32> {
    let right = at.x + map.pitch;
    let width = map.columns * map.pitch;
    return select(vec2(right, at.y), vec2(right - width, at.y + map.height), right >= width);
}
