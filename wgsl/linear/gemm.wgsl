// A fully connected layer with bias and optional ReLU, over the rows in use.
//
// Invocations are outputs. One computes four outputs, WORKGROUP apart, of sixteen rows: it reads its own weights; each
// lane reads a row's inputs and spreads them to all of its subgroup. Slices of the inputs give the device enough to
// do at few rows, and shorter sums are more accurate. With SPLIT, the parts of a workgroup sum some of them each, and
// the first adds them up.
//
// Constants: WORKGROUP invocations, whole subgroups, in each of SLICES. With ALIGNED, a row is a whole number of vec4.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
#if ALIGNED
@group(0) @binding(2) var<storage, read> input: array<vec4<f32>>;
#else
@group(0) @binding(2) var<storage, read> input: array<f32>;
#endif
// A texel is one output's weights of four inputs, zero in the padding. Texels lie as they are read: by
// tile of 4 * WORKGROUP outputs, quad of inputs, output of the tile.
#if HALF_WEIGHT
@group(0) @binding(3) var weight: texture_storage_2d<rgba16float, read>;
// What each output's sum is to be multiplied with: a power of two.
@group(0) @binding(6) var<storage, read> scale: array<f32>;
#else
@group(0) @binding(3) var weight: texture_storage_2d<rgba32float, read>;
#endif
@group(0) @binding(4) var<storage, read> bias: array<f32>;
@group(0) @binding(5) var<storage, read_write> output: array<f32>;

// include: bound
// include: index
// include: products
// include: relu
#if SPLIT
// include: slices
#endif

// Four inputs of a row; zero past the end.
fn load(row: u32, quad: u32) -> vec4<f32> {
#if ALIGNED
    let quads = params.inner / 4u;
    let x = input[row * quads + min(quad, quads - 1u)];
    return select(vec4<f32>(), x, quad < quads);
#else
    let column = 4u * quad + vec4<u32>(0u, 1u, 2u, 3u);
    let at = row * params.inner + min(column, vec4<u32>(params.inner - 1u));
    let x = vec4<f32>(input[at.x], input[at.y], input[at.z], input[at.w]);
    return select(vec4<f32>(), x, column < vec4<u32>(params.inner));
#endif
}

// The inputs of four rows, by column.
fn columns(rows: Four) -> mat4x4<f32> {
    return transpose(mat4x4<f32>(rows.a, rows.b, rows.c, rows.d));
}

const ROWS: u32 = 16u;

@compute @workgroup_size(WORKGROUP * SLICES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let rows = min(count[0], params.rows);
    let first_row = linear_index(workgroup, 0u, 1u) * ROWS;
    if first_row >= rows {
        return;
    }
#if SPLIT
    let place = place_of(local, lane);
    let own = place.own;
    let first_slice = place.slice;
#else
    let own = local;
    let first_slice = 0u;
#endif
    let tile = workgroup.z;
    let tile_width = 4u * WORKGROUP;
    let last_row = rows - 1u;
    let wrap = params.weight_width + own;
    // A column is an output, its elements are rows.
    var total = Sums();
    for (var round = 0u; round < params.rounds; round++) {
        let slice = round * SLICES + first_slice;
        // All slices run in step: one past the last goes over its weights with inputs of zero.
        let first_quad = slice * params.slice_quads;
        let first_weight = min(slice, params.slices - 1u) * params.slice_quads;
        let first_texel = (tile * params.inner_quads + first_weight) * tile_width;
        var at = vec2<u32>(
            first_texel % params.weight_width + own,
            first_texel / params.weight_width,
        );
        var sums = Sums();
        for (var i = 0u; i < params.slice_quads; i++) {
            let quad = first_quad + i;
            let w = Four(
                textureLoad(weight, at),
                textureLoad(weight, at + vec2<u32>(WORKGROUP, 0u)),
                textureLoad(weight, at + vec2<u32>(2u * WORKGROUP, 0u)),
                textureLoad(weight, at + vec2<u32>(3u * WORKGROUP, 0u)),
            );
            at.x += tile_width;
            at = select(at, vec2<u32>(own, at.y + 1u), at.x == wrap);
#if FOUR_LANES
            let row = first_row + lane % 4u;
            let a = first(load(min(row, last_row), quad));
            let b = first(load(min(row + 4u, last_row), quad));
            let c = first(load(min(row + 8u, last_row), quad));
            let d = first(load(min(row + 12u, last_row), quad));
#else
#if EIGHT_LANES
            let row = first_row + lane % 8u;
            let near = load(min(row, last_row), quad);
            let far = load(min(row + 8u, last_row), quad);
            let a = first(near);
            let b = second(near);
            let c = first(far);
            let d = second(far);
#else
            let all = load(min(first_row + lane % 16u, last_row), quad);
            let a = first(all);
            let b = second(all);
            let c = third(all);
            let d = fourth(all);
#endif
#endif
            sums.a = add_products(sums.a, w, columns(a));
            sums.b = add_products(sums.b, w, columns(b));
            sums.c = add_products(sums.c, w, columns(c));
            sums.d = add_products(sums.d, w, columns(d));
        }
        total = join(total, sums);
    }
#if SPLIT
    total = over_slices(place, total, params.zero);
    if place.slice > 0u {
        return;
    }
#endif
    // By output, then row.
    var results = array<vec4<f32>, 16>(
        total.a[0], total.b[0], total.c[0], total.d[0],
        total.a[1], total.b[1], total.c[1], total.d[1],
        total.a[2], total.b[2], total.c[2], total.d[2],
        total.a[3], total.b[3], total.c[3], total.d[3],
    );
    // Bounds that compilers do not see: unrolled, the stores would take long to compile.
    let used = min(bound(ROWS, params.zero), rows - first_row);
    for (var i = 0u; i < bound(4u, params.zero); i++) {
        let column = tile * tile_width + i * WORKGROUP + own;
        if column >= params.outputs {
            break;
        }
#if HALF_WEIGHT
        let factor = scale[column];
#else
        let factor = 1.0;
#endif
        var to = first_row * params.outputs + column;
        for (var row = 0u; row < used; row++) {
            let sum = results[i * (ROWS / 4u) + row / 4u][row % 4u] * factor + bias[column];
            output[to] = select(sum, relu(vec4<f32>(sum)).x, params.relu != 0u);
            to += params.outputs;
        }
    }
}
