// Average and maximum of each channel over space: a map, four channels a texel, to [2, C].
//
// `main`: a workgroup goes over the rows of a chunk for eight quads, eight invocations to a quad.
// Each adds up the pixels of a row, then the rows, so that no sum is long; then one invocation adds
// up the eight of a channel. `finish` brings the chunks together where there are several.

// include: bound
// include: quads
// include: texels

struct Params {
    map: Quads,
    // Rows of a chunk, and how many chunks there are.
    chunk_rows: u32,
    chunks: u32,
    // What the sums are divided by: 1 in `main` where `finish` follows, else the pixels of the map.
    divisor: f32,
    // Elements of a picture of `partials`, and of `output`.
    partial_stride: u32,
    output_stride: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
// [chunks][2][C]
@group(0) @binding(2) var<storage, read_write> partials: array<f32>;
@group(0) @binding(3) var<storage, read> partials_in: array<f32>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;

var<workgroup> sums: array<vec4<f32>, 64>;
var<workgroup> maxima: array<vec4<f32>, 64>;

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let map = params.map;
    let quad = workgroup.y * 8u + local.y;
    let first = workgroup.x * params.chunk_rows;
    let end = select(0u, min(first + params.chunk_rows, map.height), quad < map.quads);
    let row_texels = map.columns * map.pitch;
    var row = texel_index(map, texel(map, workgroup.z, quad, first, 0u));
    var sum = vec4(0.0);
    var largest = vec4(lowest(map));
    for (var y = first; y < end; y++) {
        var row_sum = vec4(0.0);
        for (var x = local.x; x < map.width; x += 8u) {
            let value = loaded(input[row + x]);
            row_sum += value;
            largest = max(largest, value);
        }
        sum += row_sum;
        row += row_texels;
    }
    sums[lane] = sum;
    maxima[lane] = largest;
    workgroupBarrier();

    // The lower 32 invocations bring together the sums of 32 channels, the upper their maxima.
    let offset = lane % 32u;
    let channel = workgroup.y * 32u + offset;
    if channel >= map.channels {
        return;
    }
    let source = offset / 4u * 8u;
    let part = offset % 4u;
    let of_maxima = lane >= 32u;
    var total = select(sums[source][part], maxima[source][part], of_maxima);
    for (var i = 1u; i < bound(8u, map.zero); i++) {
        let a = sums[source + i][part];
        let b = maxima[source + i][part];
        total = select(total + a, max(total, b), of_maxima);
    }
    let to = workgroup.z * params.partial_stride + 2u * workgroup.x * map.channels + channel;
    if of_maxima {
        partials[to + map.channels] = total;
    } else {
        partials[to] = total / params.divisor;
    }
}

@compute @workgroup_size(64)
fn finish(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let channels = params.map.channels;
    let at = workgroup.x * 64u + lane;
    if at >= 2u * channels {
        return;
    }
    let of_maxima = at >= channels;
    var source = workgroup.z * params.partial_stride + at;
    var total = partials_in[source];
    for (var chunk = 1u; chunk < params.chunks; chunk++) {
        source += 2u * channels;
        let value = partials_in[source];
        total = select(total + value, max(total, value), of_maxima);
    }
    output[workgroup.z * params.output_stride + at] =
        select(total / params.divisor, total, of_maxima);
}
