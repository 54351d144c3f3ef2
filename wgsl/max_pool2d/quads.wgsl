// The largest value in each window, or a NaN that is in it, on a map with four channels a texel.
// Windows are cut at the picture's edges, which is the same as padding with minus infinity; none is
// empty as padding is at most half the kernel.
//
// A workgroup is eight rows of two quads; an invocation goes along its row in steps of eight pixels.

// include: quads
// include: texels
// include: window

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read_write> output: array<OutputTexel>;

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
    let y = workgroup.x * 8u + local.y;
    if y >= to.height {
        return;
    }
    // Where there is no second quad, the first is computed twice.
    let quads = vec2(2u * workgroup.y, min(2u * workgroup.y + 1u, to.quads - 1u));
    let rows = window(y, source.height);
    let row_texels = source.columns * source.pitch;
    let first = vec2(
        texel_index(source, texel(source, workgroup.z, quads.x, rows.x, 0u)),
        texel_index(source, texel(source, workgroup.z, quads.y, rows.x, 0u)),
    );
    let out_row = vec2(
        texel_index(to, texel(to, workgroup.z, quads.x, y, 0u)),
        texel_index(to, texel(to, workgroup.z, quads.y, y, 0u)),
    );
    let none = lowest(source);
    for (var x = local.x; x < to.width; x += 8u) {
        let columns = window(x, source.width);
        var largest0 = vec4(none);
        var largest1 = vec4(none);
        var row = first;
        for (var iy = rows.x; iy < rows.y; iy++) {
            for (var ix = columns.x; ix < columns.y; ix++) {
                let value0 = loaded(input[row.x + ix]);
                let value1 = loaded(input[row.y + ix]);
                largest0 = select(largest0, value0, (value0 > largest0) | is_nan(value0));
                largest1 = select(largest1, value1, (value1 > largest1) | is_nan(value1));
            }
            row += row_texels;
        }
        output[out_row.x + x] = stored(largest0);
        output[out_row.y + x] = stored(largest1);
    }
}
