// Average of each channel over space: a map, four channels a texel, to C values from `first` on.
//
// A workgroup goes over eight quads, eight invocations to a quad. Each adds up the pixels of a row,
// then the rows, so that no sum is long; then one invocation adds up the eight of a channel.

// include: bound
// include: quads
// include: texels

struct Params {
    map: Quads,
    // Where in a picture of the output the averages go.
    first: u32,
    output_stride: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

var<workgroup> sums: array<vec4<f32>, 64>;

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let map = params.map;
    let quad = workgroup.y * 8u + local.y;
    let height = select(0u, map.height, quad < map.quads);
    let row_texels = map.columns * map.pitch;
    var row = texel_index(map, texel(map, workgroup.z, quad, 0u, 0u));
    var sum = vec4(0.0);
    for (var y = 0u; y < height; y++) {
        var row_sum = vec4(0.0);
        for (var x = local.x; x < map.width; x += 8u) {
            row_sum += loaded(input[row + x]);
        }
        sum += row_sum;
        row += row_texels;
    }
    sums[lane] = sum;
    workgroupBarrier();

    let channel = workgroup.y * 32u + lane;
    if lane >= 32u || channel >= map.channels {
        return;
    }
    let source = lane / 4u * 8u;
    let part = lane % 4u;
    var total = sums[source][part];
    for (var i = 1u; i < bound(8u, map.zero); i++) {
        total += sums[source + i][part];
    }
    output[workgroup.z * params.output_stride + params.first + channel] =
        total / f32(map.width * map.height);
}
