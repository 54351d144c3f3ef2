// Bilinear interpolation to another size, pixel centres at halves, clamped at the edges, on maps with
// four channels a texel.
//
// Output i lies at ((2i + 1) in - out) / (2 out) in pixels of the input. That is computed in
// integers, so that only the remainder's division rounds. A workgroup is 8 x 8 pixels of a block of
// quads, which share where they lie.

// include: quads
// include: texels
// include: between

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<Texel>;
@group(0) @binding(2) var<storage, read_write> output: array<OutputTexel>;

@compute @workgroup_size(8, 8)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let source = params.input;
    let target_map = params.output;
    let pixel = workgroup.xy * 8u + local.xy;
    if pixel.x >= target_map.width || pixel.y >= target_map.height {
        return;
    }
    let y = between(pixel.y, source.height, target_map.height);
    let x = between(pixel.x, source.width, target_map.width);
    let below = (y.high - y.low) * source.columns * source.pitch;
    let right = x.high - x.low;
    let picture = workgroup.z / params.blocks;
    let first = (workgroup.z - picture * params.blocks) * params.block;
    var at = texel(source, picture, first, y.low, x.low);
    var to = texel(target_map, picture, first, pixel.y, pixel.x);
    for (var q = first; q < min(first + params.block, source.quads); q++) {
        let top = texel_index(source, at);
        let bottom = top + below;
        let near = (1.0 - y.part) * loaded(input[top]) + y.part * loaded(input[bottom]);
        let far = (1.0 - y.part) * loaded(input[top + right]) + y.part * loaded(input[bottom + right]);
        output[texel_index(target_map, to)] =
            stored((1.0 - x.part) * near + x.part * far);
        at = next_quad(source, at);
        to = next_quad(target_map, to);
    }
}
