// A fully connected layer with bias and optional ReLU, over the rows in use.
//
// `partial`: invocations are outputs. One computes four outputs, WORKGROUP apart, of sixteen rows: it
// reads its own weights; each lane reads a row's inputs and spreads them to all of its subgroup. Slices
// of the inputs give the device enough to do at few rows, and shorter sums are more accurate. `finish`
// adds the slices and the bias.
//
// Constants: WORKGROUP invocations, whole subgroups. With ALIGNED, a row is a whole number of vec4.

struct Params {
    rows: u32,
    inner: u32,
    // vec4 in a row of inputs, padded to whole slices.
    inner_quads: u32,
    outputs: u32,
    slices: u32,
    slice_quads: u32,
    // Columns of `weight`.
    weight_width: u32,
    // Tiles of 4 * WORKGROUP outputs.
    tiles: u32,
    relu: u32,
    // Always 0.
    zero: u32,
}

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
@group(0) @binding(7) var<storage, read> scale: array<f32>;
#else
@group(0) @binding(3) var weight: texture_storage_2d<rgba32float, read>;
#endif
// [slices][rows][outputs of whole tiles]
@group(0) @binding(4) var<storage, read_write> partials: array<f32>;
// Of whole tiles.
@group(0) @binding(5) var<storage, read> bias: array<f32>;
@group(0) @binding(6) var<storage, read_write> output: array<f32>;

// include: bound
// include: index
// include: products
// include: relu

// Four inputs of a row; zero past the end.
fn load(row: u32, quad: u32) -> vec4<f32> {
#if ALIGNED
    return input[row * (params.inner / 4u) + quad];
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

// Four rows each: a column is an output, its elements are rows.
struct Sums {
    a: mat4x4<f32>,
    b: mat4x4<f32>,
    c: mat4x4<f32>,
    d: mat4x4<f32>,
}

const ROWS: u32 = 16u;

@compute @workgroup_size(WORKGROUP)
fn partial(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let rows = min(count[0], params.rows);
    let first_row = linear_index(workgroup, 0u, 1u) * ROWS;
    if first_row >= rows {
        return;
    }
    let tile = workgroup.z / params.slices;
    let slice = workgroup.z % params.slices;
    let tile_width = 4u * WORKGROUP;
    let last_row = rows - 1u;
    let first_quad = slice * params.slice_quads;
    let end = min(first_quad + params.slice_quads, (params.inner + 3u) / 4u);
    let first_texel = (tile * params.inner_quads + first_quad) * tile_width;
    var at = vec2<u32>(first_texel % params.weight_width + local, first_texel / params.weight_width);
    let wrap = params.weight_width + local;
    var sums = Sums();
    for (var quad = first_quad; quad < end; quad++) {
        let w = Four(
            textureLoad(weight, at),
            textureLoad(weight, at + vec2<u32>(WORKGROUP, 0u)),
            textureLoad(weight, at + vec2<u32>(2u * WORKGROUP, 0u)),
            textureLoad(weight, at + vec2<u32>(3u * WORKGROUP, 0u)),
        );
        at.x += tile_width;
        at = select(at, vec2<u32>(local, at.y + 1u), at.x == wrap);
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
    // By output, then row.
    var results = array<vec4<f32>, 16>(
        sums.a[0], sums.b[0], sums.c[0], sums.d[0],
        sums.a[1], sums.b[1], sums.c[1], sums.d[1],
        sums.a[2], sums.b[2], sums.c[2], sums.d[2],
        sums.a[3], sums.b[3], sums.c[3], sums.d[3],
    );
    // Bounds that compilers do not see: unrolled, the stores would take long to compile.
    let used = min(bound(ROWS, params.zero), rows - first_row);
    let row_width = params.tiles * tile_width;
    for (var output_index = 0u; output_index < bound(4u, params.zero); output_index++) {
        var to = (slice * params.rows + first_row) * row_width
            + tile * tile_width + output_index * WORKGROUP + local;
        for (var row = 0u; row < used; row++) {
            partials[to] = results[output_index * (ROWS / 4u) + row / 4u][row % 4u];
            to += row_width;
        }
    }
}

@compute @workgroup_size(64)
fn finish(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = linear_index(workgroup, local, 64u);
    let row = index / params.outputs;
    let column = index % params.outputs;
    if row >= min(count[0], params.rows) {
        return;
    }
    let row_width = params.tiles * 4u * WORKGROUP;
    var at = row * row_width + column;
    var sum = bias[column];
    for (var slice = 0u; slice < params.slices; slice++) {
#if HALF_WEIGHT
        sum += partials[at] * scale[column];
#else
        sum += partials[at];
#endif
        at += params.rows * row_width;
    }
    if params.relu != 0u {
        sum = relu(vec4<f32>(sum)).x;
    }
    output[index] = sum;
}
