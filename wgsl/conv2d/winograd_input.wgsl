// First of the three passes of Winograd's F(4 × 4, 3 × 3): the inputs of tiles of 4 × 4 outputs to 36
// points (Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", 2016). The second is
// `conv2d/direct`, a convolution of one pixel with a group of channels a point; the third is
// `winograd_output`.
//
// One invocation transforms four channels of a tile: Bᵀ d B, columns, then rows.

// include: bound
// include: quads
// include: texels
// include: input

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(2) var<storage, read_write> points: array<vec4<f32>>;

const WORKGROUP: u32 = 16u;

// The points of each invocation. Of memory of its own, drivers make registers or branches.
var<workgroup> points_of: array<array<vec4<f32>, WORKGROUP>, 36>;

// Bᵀ d, of six points from `first` on, `step` apart.
fn transform(local: u32, first: u32, step: u32) {
    let d0 = points_of[first][local];
    let d1 = points_of[first + step][local];
    let d2 = points_of[first + 2u * step][local];
    let d3 = points_of[first + 3u * step][local];
    let d4 = points_of[first + 4u * step][local];
    let d5 = points_of[first + 5u * step][local];
    let even = d4 - 4.0 * d2;
    let odd = d3 - 4.0 * d1;
    let near = d4 - d2;
    let far = 2.0 * (d3 - d1);
    points_of[first][local] = 4.0 * d0 - 5.0 * d2 + d4;
    points_of[first + step][local] = even + odd;
    points_of[first + 2u * step][local] = even - odd;
    points_of[first + 3u * step][local] = near + far;
    points_of[first + 4u * step][local] = near - far;
    points_of[first + 5u * step][local] = 4.0 * d1 - 5.0 * d3 + d5;
}

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.input;
    let tile = workgroup.x * WORKGROUP + local;
    if tile >= params.points.width {
        return;
    }
    let corner = texel(map, workgroup.z, workgroup.y, 0u, 0u);
    // The padding of one; wraps below zero to a large number, so that one comparison finds both sides.
    let top = tile / params.tile_columns * 4u - 1u;
    let left = tile % params.tile_columns * 4u - 1u;
    // A bound that compilers do not see: unrolled, loads take long to compile.
    let six = bound(6u, map.zero);
    for (var x = 0u; x < six; x++) {
        for (var y = 0u; y < six; y++) {
            let inside = (top + y < map.height) & (left + x < map.width);
            let at = vec2<u32>(min(left + x, map.width - 1u), min(top + y, map.height - 1u));
            let value = input_at(map, corner + at);
            points_of[y * 6u + x][local] = select(vec4<f32>(), value, inside);
        }
        transform(local, x, 6u);
    }
    for (var y = 0u; y < six; y++) {
        transform(local, y * 6u, 1u);
    }
    for (var point = 0u; point < 6u * six; point++) {
        let at = texel(params.points, workgroup.z, point * map.quads + workgroup.y, 0u, tile);
        points[texel_index(params.points, at)] = points_of[point][local];
    }
}
