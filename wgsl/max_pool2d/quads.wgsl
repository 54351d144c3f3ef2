// The largest value in each window, or a NaN that is in it, on a map with four channels a texel.
// Windows are cut at the picture's edges, which is the same as padding with minus infinity; none is
// empty as padding is at most half the kernel.
//
// GATED: of input * channel gate * spatial gate, with the same bits as apply_gates gives. A workgroup
// is eight rows of a quad; an invocation goes along its row in steps of eight pixels.

// include: quads

struct Params {
    input: Quads,
    output: Quads,
    kernel: u32,
    stride: u32,
    padding: u32,
    channel_gate_stride: u32,
    spatial_gate_stride: u32,
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> output: array<vec4<f32>>;
#if GATED
@group(0) @binding(3) var<storage, read> channel_gate: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> spatial_gate: array<f32>;
#endif

// The pixels start..end of an axis of `length` pixels that window `i` sees.
fn window(i: u32, length: u32) -> vec2<u32> {
    let start = i * params.stride;
    return vec2(
        max(start, params.padding) - params.padding,
        min(start + params.kernel - params.padding, length),
    );
}

// By its bits: WGSL lets a compiler assume that a comparison sees no NaN.
fn is_nan(x: vec4<f32>) -> vec4<bool> {
    return (bitcast<vec4<u32>>(x) & vec4(0x7fffffffu)) > vec4(0x7f800000u);
}

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let source = params.input;
    let to = params.output;
    let quad = workgroup.y;
    let y = workgroup.x * 8u + local.y;
    if y >= to.height {
        return;
    }
    let rows = window(y, source.height);
    let row_texels = source.columns * source.pitch;
    let first = texel_index(source, texel(source, workgroup.z, quad, rows.x, 0u));
    let out_row = texel_index(to, texel(to, workgroup.z, quad, y, 0u));
#if GATED
    // The gates of channels past the last are undefined, those channels zero.
    let live = vec4(4u * quad) + vec4(0u, 1u, 2u, 3u) < vec4(source.channels);
    let gate = channel_gate[workgroup.z * params.channel_gate_stride / 4u + quad];
    let by_channel = select(vec4(0.0), gate, live);
    let first_gate = workgroup.z * params.spatial_gate_stride + rows.x * source.width;
#endif
    for (var x = local.x; x < to.width; x += 8u) {
        let columns = window(x, source.width);
        var largest = vec4(-0x1.fffffep+127f);
        var row = first;
#if GATED
        var gate_row = first_gate;
#endif
        for (var iy = rows.x; iy < rows.y; iy++) {
            for (var ix = columns.x; ix < columns.y; ix++) {
#if GATED
                let value = input[row + ix] * by_channel * spatial_gate[gate_row + ix];
#else
                let value = input[row + ix];
#endif
                largest = select(largest, value, (value > largest) | is_nan(value));
            }
            row += row_texels;
#if GATED
            gate_row += source.width;
#endif
        }
        output[out_row + x] = largest;
    }
}
