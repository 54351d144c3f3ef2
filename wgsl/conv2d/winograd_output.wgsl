// Last of the three passes of Winograd's F(4 × 4, 3 × 3): 36 points to tiles of 4 × 4 outputs, bias,
// optional residual and ReLU. See `winograd_input`.
//
// One invocation transforms four channels of a tile: Aᵀ m A, columns, then rows.

// include: bound
// include: quads
// include: texels
// include: relu

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> bias: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> residual: array<Texel>;
@group(0) @binding(4) var<storage, read_write> output: array<OutputTexel>;

const WORKGROUP: u32 = 16u;

// The points of each invocation. Of memory of its own, drivers make registers or branches.
var<workgroup> points_of: array<array<vec4<f32>, WORKGROUP>, 36>;

// Aᵀ m, of six points from `first` on, `step` apart, to the first four of them.
fn transform(local: u32, first: u32, step: u32) {
    let m0 = points_of[first][local];
    let m1 = points_of[first + step][local];
    let m2 = points_of[first + 2u * step][local];
    let m3 = points_of[first + 3u * step][local];
    let m4 = points_of[first + 4u * step][local];
    let m5 = points_of[first + 5u * step][local];
    let sum1 = m1 + m2;
    let difference1 = m1 - m2;
    let sum2 = m3 + m4;
    let difference2 = m3 - m4;
    points_of[first][local] = m0 + sum1 + sum2;
    points_of[first + step][local] = difference1 + 2.0 * difference2;
    points_of[first + 2u * step][local] = sum1 + 4.0 * sum2;
    points_of[first + 3u * step][local] = difference1 + 8.0 * difference2 + m5;
}

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.output;
    let tile = workgroup.x * WORKGROUP + local;
    if tile >= params.points.width {
        return;
    }
    let quad = workgroup.y;
    // Bounds that compilers do not see: unrolled, loads take long to compile.
    let six = bound(6u, map.zero);
    let four = bound(4u, map.zero);
    for (var point = 0u; point < 6u * six; point++) {
        let at = texel(params.points, workgroup.z, point * map.quads + quad, 0u, tile);
        points_of[point][local] = points[texel_index(params.points, at)];
    }
    for (var x = 0u; x < six; x++) {
        transform(local, x, 6u);
    }
    for (var y = 0u; y < four; y++) {
        transform(local, y * 6u, 1u);
    }
    let top = tile / params.tile_columns * 4u;
    let left = tile % params.tile_columns * 4u;
    let corner = texel_index(map, texel(map, workgroup.z, quad, top, left));
    for (var y = 0u; y < min(four, map.height - top); y++) {
        for (var x = 0u; x < min(four, map.width - left); x++) {
            let at = corner + y * map.columns * map.pitch + x;
            var value = points_of[y * 6u + x][local] + bias[quad];
            if params.has_residual != 0u {
                value += loaded(residual[at]);
            }
            if params.relu != 0u {
                value = relu(value);
            }
            output[at] = stored(value);
        }
    }
}
