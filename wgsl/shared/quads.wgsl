/// Where the channels of maps lie, four a texel.
struct Quads {
    width: u32,
    height: u32,
    /// Texels for all channels of a pixel.
    quads: u32,
    /// Texels of a row of one quad.
    pitch: u32,
    /// Quads that stand side by side.
    columns: u32,
    /// Rows of a picture.
    rows: u32,
    /// Always 0: in a loop's bound it keeps compilers from unrolling.
    zero: u32,
    channels: u32,
}

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
